"""One side's endpoint: `hapnet.side.endpoint`, and what of `hapnet.wire.session` a pair needs after its handshake."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from hapnet.kernel import link as links
from hapnet.kernel import path as paths
from hapnet.kernel.link import ENERGY, STREAM, Link, Message
from hapnet.kernel.path import DOUBTFUL, LATE, NEW, Path
from hapnet.records.equation import equation
from hapnet.records.record import Record, Wholes
from hapnet.wire import energy_channel as channels
from hapnet.wire.energy_channel import EnergyChannel
from hapnet.wire.fields import MAX_COORDINATE

_MAX_COORDINATE = MAX_COORDINATE

BACKLOG, CREDITS = 128, 256
"""How many samples may wait for the next tick, as in `hapnet.side.endpoint`, and how many credits."""


class Endpoint(Record):
    """What one endpoint keeps besides its channel and its path.

    first, waiting, backlog : the samples that wait for the next tick are a ring. credits_J : shuffled energy that waits
    for it, a sum. has_credit : is there any?
    echo_ns, came_ns : the stamps that its messages echo: of the message that came last.
    used_ns, used_came_ns, took_ns : of the newest sample in use; took_ns below 0: there is none.
    proxies, accepts_stale : does it send, and accept, such messages?
    stream_bytes, energy_bytes : the least size of its messages. plane_bytes, level_bytes : what each plane, and the
    level, add. stale, leaps : messages that were dropped, and the number of the last stale one. impossible : it would
    send what no receiver accepts.
    """

    n: int
    first: int
    waiting: int
    backlog: int
    credits: int
    next_sequence: int
    echo_ns: int
    came_ns: int
    used_ns: int
    used_came_ns: int
    took_ns: int
    proxies: int
    accepts_stale: int
    stream_bytes: int
    plane_bytes: int
    level_bytes: int
    energy_bytes: int
    stale: int
    last_stale: int
    leaps: int
    impossible: int


class Wire(Record):
    """An endpoint with its channel, what it knows of the path, the samples that wait, when they came and how long they
    took [ns], and the credits that wait [nJ]."""

    endpoint: Endpoint
    channel: EnergyChannel
    path: Path
    samples: Annotated[Sequence[Message], (BACKLOG,)]
    came_ns: Annotated[Wholes, (BACKLOG,)]
    took_ns: Annotated[Wholes, (BACKLOG,)]
    credits_nJ: Annotated[Wholes, (CREDITS,)]


@equation
def receive(wire: Wire, message: Message, now_ns: int) -> None:
    """`WireHalf.receive`: a message of the peer arrives."""
    if message.kind == STREAM:
        _on_stream(wire, message, now_ns)
        return
    paths.on_any_message(wire.path, now_ns)
    credit(wire, channels.receive(wire.channel, message.total_nJ, message.acked_nJ, now_ns))


@equation
def credit(wire: Wire, credited_nJ: int) -> None:
    """`ControlHalf.credit`."""
    if credited_nJ:
        endpoint = wire.endpoint
        if endpoint.credits == CREDITS:
            endpoint.impossible = 1
            return
        wire.credits_nJ[endpoint.credits] = credited_nJ
        endpoint.credits += 1


@equation
def _on_stream(wire: Wire, message: Message, now_ns: int) -> None:
    """`Session._on_stream`."""
    endpoint, path = wire.endpoint, wire.path
    newest, sequence, stamp_ns = path.newest, message.sequence, message.stamp_ns
    place = paths.place(path, now_ns, sequence, stamp_ns)
    if place == DOUBTFUL:
        endpoint.leaps += 1
        return
    since = 1 if newest < 0 else sequence - newest
    late = place == LATE
    if not late:
        paths.age(path, now_ns, stamp_ns, since, place == NEW)
    took_ns = paths.measure(path, now_ns, stamp_ns, since, late, message.echo_ns, message.came_ns)
    endpoint.echo_ns, endpoint.came_ns = stamp_ns, now_ns
    if late:
        paths.on_any_message(path, now_ns)
        if not endpoint.accepts_stale:
            endpoint.stale += 1
            endpoint.last_stale = sequence
            return
    else:
        paths.on_new(path, now_ns, since)
    _put(wire, message, now_ns, took_ns)


@equation
def _put(wire: Wire, message: Message, now_ns: int, took_ns: int) -> None:
    """`ControlHalf.on_sample`: of too many samples the oldest is forgotten."""
    endpoint = wire.endpoint
    if endpoint.waiting == endpoint.backlog:
        endpoint.first = (endpoint.first + 1) % endpoint.backlog
        endpoint.waiting -= 1
    at = (endpoint.first + endpoint.waiting) % endpoint.backlog
    links.copy_message(message, wire.samples[at])
    wire.came_ns[at], wire.took_ns[at] = now_ns, took_ns
    endpoint.waiting += 1


@equation
def poll(wire: Wire, link: Link, now_ns: int) -> None:
    """`WireHalf.poll`, into the link: the energy that is due."""
    credit(wire, channels.admit(wire.channel, now_ns))
    total_nJ = channels.poll(wire.channel, now_ns)
    if total_nJ >= 0:
        message = links.spare(link, 1)
        message.kind, message.planes = ENERGY, 0
        message.total_nJ, message.acked_nJ = total_nJ, wire.channel.credited_nJ
        message.octets = wire.endpoint.energy_bytes + _width(message.total_nJ) + _width(message.acked_nJ)
        links.send(link, now_ns, message)


@equation
def finish(endpoint: Endpoint, message: Message, now_ns: int) -> None:
    """`PositionStream`: number and stamp a message of the stream; position, and a proxy's content, are there."""
    message.kind = STREAM
    message.sequence, message.stamp_ns = endpoint.next_sequence, now_ns
    message.echo_ns, message.came_ns = endpoint.echo_ns, endpoint.came_ns
    endpoint.next_sequence += 1
    message.octets = endpoint.stream_bytes
    if message.level >= 0.0:
        message.octets += endpoint.level_bytes
    for i in range(endpoint.n):
        if not abs(message.position[i]) <= _MAX_COORDINATE:
            endpoint.impossible = 1
    if endpoint.proxies:
        message.octets += _width(message.aimed_ns) + message.planes * endpoint.plane_bytes
        for i in range(endpoint.n):
            if not abs(message.force[i]) <= _MAX_COORDINATE:
                endpoint.impossible = 1


@equation
def _width(value: int) -> int:
    """How many bytes msgpack takes for a whole number."""
    if value < 1 << 7:
        return 1
    if value < 1 << 8:
        return 2
    if value < 1 << 16:
        return 3
    return 5 if value < 1 << 32 else 9


@equation
def has_room(link: Link) -> bool:
    """Are there draws for what one event may send?"""
    return link.drawn - (link.offered - link.begun) >= 2
