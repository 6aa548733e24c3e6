"""An endpoint's half of the protocol after the handshake, to and from the kernel."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from hapnet.control.coupling import Proxy, level_of, vector_of
from hapnet.histogram import Histogram
from hapnet.kernel import endpoint as endpoints
from hapnet.kernel import path as paths
from hapnet.kernel.link import Message
from hapnet.kernel.memory import load, plain, store
from hapnet.side.endpoint import NANO, DeviceEndpoint, WorldEndpoint
from hapnet.side.packet import FRAME_OVERHEAD
from hapnet.simulation.compiled.mirror import number, optional, put, read, replace, value, write
from hapnet.wire.fields import LEVEL, REACH
from hapnet.wire.messages import Energy, Position, encode
from hapnet.wire.messages import Proxy as ProxyMessage
from hapnet.wire.session import Session

_NUMBERING = {
    "least_ns": "least_ns", "newest": "newest", "run_heard_ns": "heard_ns", "mean_ns": "mean_ns",
    "before_ns": "before_ns", "lately_ns": "lately_ns", "roll_ns": "roll_ns", "count": "count",
    "others": "others", "others_ns": "others_ns", "proof": "proof",
}  # fmt: skip
_MONITOR = {
    "heard_ns": "heard_ns", "silences": "count", "longest_ns": "longest_ns", "total_ns": "total_ns",
    "recovery_max_ns": "recovery_max_ns", "received": "received", "missing": "missing",
}  # fmt: skip
_COUNTS = {
    "messages": "sent", "came": "came", "overtaken": "late", "stalls": "stalls", "longest_stall_ns": "longest_stall_ns",
}  # fmt: skip
_HISTOGRAMS = ("trips", "jitter", "ages")

Endpoint = DeviceEndpoint | WorldEndpoint


def read_wire(wire: endpoints.Wire, endpoint: Endpoint, *, proxies: bool) -> None:
    """`proxies`: does this side send proxies, and not bare positions?"""
    session, record, arrived = endpoint.session, wire.endpoint, value(endpoint, "arrived")
    record.n, record.backlog, record.proxies = session.identity.dof, arrived.maxlen, int(proxies)
    record.next_sequence = session.positions.next_sequence
    record.echo_ns, record.came_ns = value(endpoint, "echo")
    used = value(endpoint, "used")
    record.used_ns, record.used_came_ns, record.took_ns = (0, 0, -1) if used is None else used
    record.accepts_stale = int(session.settings.accept_stale and session.settings.expects is Position)
    _sizes(record, session)
    for k, (sample, sent_ns, came_ns, took_ns, _) in enumerate(arrived):
        message = wire.samples[k]
        message.stamp_ns, wire.came_ns[k], wire.took_ns[k] = sent_ns, came_ns, took_ns
        put(message, "position", vector_of(sample))
        message.level = _or_none(level_of(sample))
        if isinstance(sample, Proxy):
            put_proxy(message, round(sample.aimed_s / NANO), sample.force, sample.planes, sample.reach_m)
    record.waiting = len(arrived)
    waiting = list(value(endpoint, "credits"))
    put(wire, "credits_nJ", waiting)
    record.credits = len(waiting)
    store(wire.channel, session.channel)
    _path(wire.path, session)


def _or_none(told: float | None) -> float:
    """As the kernel has what may not be told."""
    return -1.0 if told is None else told


def put_proxy(message: Message, aimed_ns: int, force: tuple[float, ...], planes: Any, reach_m: float | None) -> None:
    """A proxy's content besides position and level. The kernel's walls have neither curvature nor friction."""
    message.reach_m = _or_none(reach_m)
    message.aimed_ns = aimed_ns
    put(message, "force", force)
    message.planes = len(planes)
    for k, (normal, offset, stiffness, _, velocity, *_) in enumerate(planes):
        message.normal[k][: len(normal)] = normal
        message.offset[k], message.stiffness[k], message.velocity[k] = offset, stiffness, velocity


def write_wire(record: endpoints.Wire, endpoint: Endpoint) -> None:
    session, side = endpoint.session, record.endpoint
    session.positions.next_sequence = int(side.next_sequence)
    replace(endpoint, "echo", (int(side.echo_ns), int(side.came_ns)))
    if side.took_ns >= 0:
        replace(endpoint, "used", (int(side.used_ns), int(side.used_came_ns), int(side.took_ns)))
    for kind, count in (("stale", int(side.stale)), ("leap", int(side.leaps))):
        if count:
            session.dropped[kind] += count
    if side.stale:
        word = session.settings.expects.__name__.lower()
        session.dropped_for["stale"] = f"{word} {side.last_stale} comes after a later one"
    load(session.channel, record.channel)
    _write_path(record.path, session)


def _sizes(record: endpoints.Endpoint, session: Session) -> None:
    """The least sizes of the messages, with all headers [bytes]."""
    assert session.peer is not None
    me, peer = session.identity.incarnation, session.peer.incarnation
    sizes = _least_sizes(me.bit_length(), peer.bit_length(), session.identity.dof, bool(record.proxies))
    record.stream_bytes, record.level_bytes, record.plane_bytes, record.energy_bytes = sizes


@lru_cache
def _least_sizes(my_bits: int, peer_bits: int, dof: int, proxies: bool) -> tuple[int, int, int, int]:
    """The sizes of a message of the stream, of the level and of each plane in it, and of a message of the energy
    channel [bytes].

    A number takes as many bytes as its bits need; other whole numbers than the incarnations take a byte more at least.
    """
    me, peer, still = 1 << my_bits - 1, 1 << peer_bits - 1, (0.0,) * dof

    def size(more: dict[str, float], planes: Any = ()) -> int:
        if proxies:
            return len(encode(ProxyMessage(me, 0, 0, still, 0, still, planes, more={REACH: 0.0, **more}))) - 1
        return len(encode(Position(me, 0, 0, still, more=more or None)))

    bare, energy = size({}), len(encode(Energy(me, peer, 0, 0)))
    plane = size({}, ((still, 0.0, 1.0, 0.0, 0.0),)) - bare
    return FRAME_OVERHEAD + bare, size({LEVEL: 0.0}) - bare, plane, FRAME_OVERHEAD + energy - 2


def _path(record: paths.Path, session: Session) -> None:
    monitor, path = session.monitor, session.path
    numbers, counts = monitor.numbers, value(path, "all")
    read(record, numbers, "", **_NUMBERING)
    optional(record, "stamp_ns", "has_stamp", value(numbers, "stamp_ns"))
    optional(record, "displaced", "has_displaced", value(numbers, "displaced"))
    if (other := value(numbers, "other")) is not None:
        record.has_other, (record.other_number, record.other_stamp_ns, record.other_came_ns) = 1, other
    read(record, monitor, "silence_ns", **_MONITOR)
    optional(record, "sign_ns", "has_sign", value(monitor, "sign_ns"))
    read(record, counts, "", **_COUNTS)
    for k, name in enumerate(_HISTOGRAMS):
        histogram = getattr(counts, name)
        record.counts[k][:], record.highest[k] = histogram.counts, histogram.max
    read(record, path, "since_ns")
    optional(record, "least_trip_ns", "has_trip", value(path, "least_trip_ns"))
    if (last := value(path, "last")) is not None:
        record.has_last, (record.last_came_ns, record.last_stamp_ns) = 1, last


def _write_path(record: paths.Path, session: Session) -> None:
    monitor, path = session.monitor, session.path
    numbers, counts = monitor.numbers, value(path, "all")
    write(record, numbers, "", **_NUMBERING)
    replace(numbers, "stamp_ns", number(record.stamp_ns) if record.has_stamp else None)
    replace(numbers, "displaced", number(record.displaced) if record.has_displaced else None)
    other = (int(record.other_number), int(record.other_stamp_ns), int(record.other_came_ns))
    replace(numbers, "other", other if record.has_other else None)
    write(record, monitor, "", **_MONITOR)
    replace(monitor, "life_ns", number(record.heard_ns))
    replace(monitor, "sign_ns", number(record.sign_ns) if record.has_sign else None)
    write(record, counts, "", **_COUNTS)
    for k, name in enumerate(_HISTOGRAMS):
        replace(counts, name, Histogram(plain(record.counts[k]), int(record.highest[k])))
    replace(path, "least_trip_ns", number(record.least_trip_ns) if record.has_trip else None)
    last = int(record.last_came_ns), int(record.last_stamp_ns)
    replace(path, "last", last if record.has_last else None)
