"""Copies an endpoint's half of the protocol after the handshake to and from the kernel."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from hapnet.control.coupling import MotionSample, PortSample, ProxySample, WaveSample, level_of, vector_of
from hapnet.ext.compiled import endpoint as endpoints
from hapnet.ext.compiled.endpoint import MOTION, PORT, POSITION, PROXY, WAVE
from hapnet.ext.compiled.link import MessageSlot
from hapnet.ext.compiled.memory import fill, load, store
from hapnet.ext.compiled.solids import FLOAT_BYTES
from hapnet.mechanics.curvature import Bends
from hapnet.mechanics.plane import Plane
from hapnet.records.record import Record
from hapnet.side.endpoint import NANO, DeviceEndpoint, WorldEndpoint
from hapnet.side.link_port import FRAME_OVERHEAD
from hapnet.wire import messages
from hapnet.wire.fields import CURVATURES, FRICTION, INTEGRAL, LEVEL, REACH
from hapnet.wire.messages import encode
from hapnet.wire.replay_window import stale_detail
from hapnet.wire.session import Session

Endpoint = DeviceEndpoint | WorldEndpoint


KINDS: dict[type[messages.Stream], int] = {
    messages.Position: POSITION, messages.Proxy: PROXY, messages.Motion: MOTION, messages.Port: PORT,
    messages.Wave: WAVE,
}  # fmt: skip
"""The kernel's numbers for the kinds of stream messages."""


def read_wire(wire: endpoints.Wire, endpoint: Endpoint, sends: type[messages.Stream]) -> None:
    """Copy an endpoint to the kernel. `sends`: the messages of this side's stream."""
    session, record, arrived = endpoint.session, wire.endpoint, endpoint.waiting
    expects = session.settings.expects
    record.n, record.backlog, record.kind = session.identity.dof, arrived.maxlen or 0, KINDS[sends]
    record.next_sequence = session.positions.next_sequence
    store(record.used, endpoint.in_use)
    record.accepts_stale = int(session.settings.accept_stale and expects is messages.Position)
    record.waves = int(expects is messages.Wave)
    _sizes(record, session)
    for k, (sample, sent_ns, came_ns, took_ns, _) in enumerate(arrived):
        message = wire.samples[k]
        message.stamp_ns, wire.came_ns[k], wire.took_ns[k] = sent_ns, came_ns, took_ns
        fill(message.position, vector_of(sample))
        message.level = _or_none(level_of(sample))
        match sample:
            case ProxySample():
                put_proxy(message, round(sample.aimed_s / NANO), sample.force, sample.planes, sample.reach_m)
            case MotionSample(_, velocity):
                fill(message.more, velocity)
            case PortSample(_, energy):
                message.amount = round(energy / NANO)
            case WaveSample(_, span, total, total_s):
                fill(message.more, total)
                message.amount, message.elapsed_ns = round(span / NANO), round(total_s / NANO)
    record.waiting = len(arrived)
    waiting = list(endpoint.credits)
    fill(wire.credits_nJ, waiting)
    record.credits = len(waiting)
    for part, own in _parts(wire, session):
        store(part, own)


def _parts(wire: endpoints.Wire, session: Session) -> list[tuple[Record, Record]]:
    """The kernel's records of a side's wire, each with the session's own record."""
    return [
        (wire.channel, session.channel), (wire.monitor, session.monitor), (wire.path, session.path),
        (wire.window, session.replay_window), (wire.integral, session.positions.integral),
    ]  # fmt: skip


def _or_none(value: float | None) -> float:
    """A value that may be missing, in the kernel's form: -1 if it is."""
    return -1.0 if value is None else value


def put_proxy(
    message: MessageSlot, aimed_ns: int, force: tuple[float, ...], planes: Any, reach_m: float | None
) -> None:
    """Put a proxy's content besides position and level into a message; planes : each a `Plane`, or its first fields."""
    message.reach_m = _or_none(reach_m)
    message.aimed_ns = aimed_ns
    fill(message.force, force)
    message.planes = len(planes)
    for k, plane in enumerate(planes):
        normal, offset, stiffness, _, velocity, bends, message.friction[k], _ = Plane(*plane)
        store(message.bends[k], Bends(bends))
        message.normal[k][: len(normal)] = normal
        message.offset[k], message.stiffness[k], message.velocity[k] = offset, stiffness, velocity


def write_wire(record: endpoints.Wire, endpoint: Endpoint) -> None:
    session, side = endpoint.session, record.endpoint
    session.positions.next_sequence = int(side.next_sequence)
    endpoint.echo(int(record.path.echo_ns), int(record.path.came_ns))
    load(endpoint.in_use, side.used)
    for kind, count in (("stale", int(side.stale)), ("leap", int(side.leaps))):
        if count:
            session.dropped[kind] += count
    if side.stale:
        name = session.settings.expects.__name__.lower()
        session.dropped_for["stale"] = stale_detail(name, int(side.last_stale), int(side.stale_place))
    for part, own in _parts(record, session):
        load(own, part)


def _sizes(record: endpoints.Endpoint, session: Session) -> None:
    """The smallest sizes of the messages, with all headers [bytes]."""
    assert session.peer is not None
    me, peer = session.identity.incarnation, session.peer.incarnation
    sizes = _min_sizes(me.bit_length(), peer.bit_length(), session.identity.dof, record.kind)
    record.stream_bytes, record.level_bytes, record.plane_bytes, record.energy_bytes = sizes[:4]
    record.bends_bytes, record.bend_bytes, record.friction_bytes = sizes[4:]


@lru_cache
def _min_sizes(my_bits: int, peer_bits: int, dof: int, kind: int) -> tuple[int, int, int, int, int, int, int]:
    """The sizes of a message of the stream, of the level and of each plane in it, and of a message of the energy
    channel [bytes]; and the bytes that curvature, each bend, and friction add to a proxy.

    A number takes as many bytes as its bits need; whole numbers except the incarnations add at least one byte.
    """
    me, peer, still = 1 << my_bits - 1, 1 << peer_bits - 1, (0.0,) * dof

    def size(more: dict[str, Any], planes: Any = ()) -> int:
        if kind == PROXY:
            return len(encode(messages.Proxy(me, 0, 0, still, 0, still, planes, more={REACH: 0.0, **more}))) - 1
        if kind == MOTION:
            return len(encode(messages.Motion(me, 0, 0, still, still)))
        if kind == PORT:
            return len(encode(messages.Port(me, 0, 0, still, 0))) - 1
        if kind == WAVE:
            return len(encode(messages.Wave(me, 0, 0, still, 1, more={INTEGRAL: (still, 0)}))) - 2
        return len(encode(messages.Position(me, 0, 0, still, more=more or None)))

    bare, energy = size({}), len(encode(messages.Energy(me, peer, 0, 0)))
    flat = ((still, 0.0, 1.0, 0.0, 0.0),)
    plane, level = size({}, flat) - bare, size({LEVEL: 0.0}) - bare
    bent, once = size({CURVATURES: ((),)}, flat), size({CURVATURES: (((still, 0.0),),)}, flat)
    bends, friction = bent - plane - bare - 1, size({FRICTION: (0.0,)}, flat) - plane - bare - FLOAT_BYTES
    bend = once - bent
    return FRAME_OVERHEAD + bare, level, plane, FRAME_OVERHEAD + energy - 2, bends, bend, friction
