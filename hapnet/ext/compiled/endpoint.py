"""One side's compiled endpoint: `hapnet.side.endpoint`, and the parts of `hapnet.wire.session` after the handshake."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from hapnet.ext.compiled import link as links
from hapnet.ext.compiled.link import ENERGY, STREAM, LinkRecord, MessageSlot
from hapnet.records.record import Reals, Record, Wholes, equation
from hapnet.side.content import energy_nJ, span_ns
from hapnet.wire import energy_channel as channels
from hapnet.wire.energy_channel import EnergyChannel
from hapnet.wire.fields import MAX_COORDINATE
from hapnet.wire.numbering import DOUBTFUL
from hapnet.wire.path import InUse, Path, arrive, is_used
from hapnet.wire.peer_monitor import PeerMonitor, on_any_message
from hapnet.wire.replay_window import ReplayWindow
from hapnet.wire.stream import BACKLOG, Integral, integrate

_MAX_COORDINATE = MAX_COORDINATE

POSITION, PROXY, MOTION, PORT, WAVE = range(5)
"""The kinds of messages in a side's stream."""

MOST_AMOUNT = 1e6
"""The highest energy of a port [J], and span of a wave [s]."""

CREDITS = 256
"""The number of credits that may wait for the next tick."""


class Endpoint(Record):
    """The state of one endpoint besides its channel and its path.

    first, waiting, backlog : the ring of samples that wait for the next tick. credits : the number of waiting credits.
    used : the newest sample in use.
    kind : of the messages that it sends. waves : 1 if it receives waves. accepts_stale : 1 if it uses stale messages.
    stream_bytes, energy_bytes : the smallest sizes of its messages. plane_bytes, level_bytes : the bytes that each
    plane and the level add. stale, leaps : the numbers of dropped messages; last_stale, stale_place : number and place
    of the last stale message. impossible : not 0 if it would send a message that no receiver accepts.
    """

    n: int
    first: int
    waiting: int
    backlog: int
    credits: int
    next_sequence: int
    used: InUse
    kind: int
    waves: int
    accepts_stale: int
    stream_bytes: int
    plane_bytes: int
    level_bytes: int
    bends_bytes: int
    bend_bytes: int
    friction_bytes: int
    energy_bytes: int
    stale: int
    last_stale: int
    stale_place: int
    leaps: int
    impossible: int


class Wire(Record):
    """An endpoint with its channel, peer monitor and path, the window of received waves, the integral of sent waves,
    the waiting samples, their arrivals and durations [ns], and the waiting credits [nJ]."""

    endpoint: Endpoint
    channel: EnergyChannel
    monitor: PeerMonitor
    path: Path
    window: ReplayWindow
    integral: Integral
    samples: Annotated[Sequence[MessageSlot], (BACKLOG,)]
    came_ns: Annotated[Wholes, (BACKLOG,)]
    took_ns: Annotated[Wholes, (BACKLOG,)]
    credits_nJ: Annotated[Wholes, (CREDITS,)]


class PortRecord(Record):
    """A side's protocol, and the link for all that it sends, in place of a `LinkPort`."""

    wire: Wire
    link: LinkRecord


@equation
def receive(wire: Wire, message: MessageSlot, now_ns: int) -> None:
    """Process a message that arrives from the peer, as `WireHalf.receive` does."""
    if message.kind == STREAM:
        _on_stream(wire, message, now_ns)
        return
    on_any_message(wire.monitor, now_ns)
    credit(wire, channels.receive(wire.channel, message.total_nJ, message.acked_nJ, now_ns))


@equation
def credit(wire: Wire, credited_nJ: int) -> None:
    """Add a credit for the next tick, as `ControlHalf.credit` does."""
    if credited_nJ:
        endpoint = wire.endpoint
        if endpoint.credits == CREDITS:
            endpoint.impossible = 1
            return
        wire.credits_nJ[endpoint.credits] = credited_nJ
        endpoint.credits += 1


@equation
def _on_stream(wire: Wire, message: MessageSlot, now_ns: int) -> None:
    """Process a message of the peer's stream: use it, or count it as dropped."""
    endpoint, path, sequence = wire.endpoint, wire.path, message.sequence
    once = endpoint.waves != 0
    place = arrive(
        path, wire.monitor, wire.window, once, now_ns, sequence, message.stamp_ns, message.echo_ns, message.came_ns
    )
    if is_used(place, once, endpoint.accepts_stale != 0):
        _put(wire, message, now_ns, path.under_way_ns)
    elif place == DOUBTFUL:
        endpoint.leaps += 1
    else:
        endpoint.stale += 1
        endpoint.last_stale, endpoint.stale_place = sequence, place


@equation
def _put(wire: Wire, message: MessageSlot, now_ns: int, took_ns: int) -> None:
    """Add a sample for the next tick, as `ControlHalf.on_sample` does; a full ring drops the oldest sample."""
    endpoint = wire.endpoint
    if endpoint.waiting == endpoint.backlog:
        endpoint.first = (endpoint.first + 1) % endpoint.backlog
        endpoint.waiting -= 1
    at = (endpoint.first + endpoint.waiting) % endpoint.backlog
    links.copy_message(message, wire.samples[at])
    wire.came_ns[at], wire.took_ns[at] = now_ns, took_ns
    endpoint.waiting += 1


@equation
def send_due(wire: Wire, link: LinkRecord, now_ns: int) -> None:
    """Offer the energy message that is due to the link, as `LinkPort.send_due` does."""
    credit(wire, channels.admit(wire.channel, now_ns))
    total_nJ = channels.poll(wire.channel, now_ns)
    if total_nJ >= 0:
        message = links.spare(link, 1)
        message.kind, message.planes = ENERGY, 0
        message.total_nJ, message.acked_nJ = total_nJ, wire.channel.credited_nJ
        message.octets = wire.endpoint.energy_bytes + _width(message.total_nJ) + _width(message.acked_nJ)
        links.send(link, now_ns, message)


@equation
def surface_bytes(endpoint: Endpoint, message: MessageSlot) -> int:
    """Return 0, the bytes for curvature and friction of walls. solids.py replaces this function."""
    return 0


@equation
def finish(wire: Wire, message: MessageSlot, now_ns: int, amount: float) -> None:
    """Number and stamp a message of the stream, as `PositionStream` does; vectors and a proxy's content are in it.

    amount : a port's energy [J], or a wave's span [s].
    """
    endpoint = wire.endpoint
    kind = endpoint.kind
    message.kind = STREAM
    message.sequence, message.stamp_ns = endpoint.next_sequence, now_ns
    message.echo_ns, message.came_ns = wire.path.echo_ns, wire.path.came_ns
    endpoint.next_sequence += 1
    message.octets = endpoint.stream_bytes
    if message.level >= 0.0:
        message.octets += endpoint.level_bytes
    if not _within(endpoint.n, message.position) or not amount <= MOST_AMOUNT:
        endpoint.impossible = 1
        return
    if kind == PROXY:
        message.octets += _width(message.aimed_ns) + message.planes * endpoint.plane_bytes
        message.octets += surface_bytes(endpoint, message)
        if not _within(endpoint.n, message.force):
            endpoint.impossible = 1
    elif kind == PORT:
        message.amount = energy_nJ(amount)
        message.octets += _width(message.amount)
    elif kind == WAVE:
        message.amount = span_ns(amount)
        integrate(wire.integral, endpoint.n, message.position, message.amount)
        message.elapsed_ns = wire.integral.elapsed_ns
        for i in range(endpoint.n):
            message.more[i] = wire.integral.total[i]
        message.octets += _width(message.amount) + _width(message.elapsed_ns)
    if kind >= MOTION and not _within(endpoint.n, message.more):
        endpoint.impossible = 1


@equation
def _within(n: int, vector: Reals) -> bool:
    """Whether a message may carry these coordinates."""
    fits = True
    for i in range(n):
        fits = fits and bool(abs(vector[i]) <= _MAX_COORDINATE)
    return fits


@equation
def _width(value: int) -> int:
    """The number of bytes that msgpack takes for a whole number."""
    if value < 1 << 7:
        return 1
    if value < 1 << 8:
        return 2
    if value < 1 << 16:
        return 3
    return 5 if value < 1 << 32 else 9


@equation
def has_room(link: LinkRecord) -> bool:
    """Whether there are enough draws for all messages that one event may send."""
    return link.drawn - (link.counters.offered - link.begun) >= 2
