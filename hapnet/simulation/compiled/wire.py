"""An endpoint's half of the protocol after the handshake, to and from the kernel."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from hapnet.control.coupling import Proxy, level_of, vector_of
from hapnet.kernel import endpoint as endpoints
from hapnet.kernel.link import Message
from hapnet.kernel.memory import fill, load, store
from hapnet.side.endpoint import NANO, DeviceEndpoint, WorldEndpoint
from hapnet.side.packet import FRAME_OVERHEAD
from hapnet.wire.fields import LEVEL, REACH
from hapnet.wire.messages import Energy, Position, encode
from hapnet.wire.messages import Proxy as ProxyMessage
from hapnet.wire.session import Session

Endpoint = DeviceEndpoint | WorldEndpoint


def read_wire(wire: endpoints.Wire, endpoint: Endpoint, *, proxies: bool) -> None:
    """`proxies`: does this side send proxies, and not bare positions?"""
    session, record, arrived = endpoint.session, wire.endpoint, endpoint.waiting
    record.n, record.backlog, record.proxies = session.identity.dof, arrived.maxlen or 0, int(proxies)
    record.next_sequence = session.positions.next_sequence
    store(record.used, endpoint.in_use)
    record.accepts_stale = int(session.settings.accept_stale and session.settings.expects is Position)
    _sizes(record, session)
    for k, (sample, sent_ns, came_ns, took_ns, _) in enumerate(arrived):
        message = wire.samples[k]
        message.stamp_ns, wire.came_ns[k], wire.took_ns[k] = sent_ns, came_ns, took_ns
        fill(message.position, vector_of(sample))
        message.level = _or_none(level_of(sample))
        if isinstance(sample, Proxy):
            put_proxy(message, round(sample.aimed_s / NANO), sample.force, sample.planes, sample.reach_m)
    record.waiting = len(arrived)
    waiting = list(endpoint.credits)
    fill(wire.credits_nJ, waiting)
    record.credits = len(waiting)
    store(wire.channel, session.channel)
    store(wire.monitor, session.monitor)
    store(wire.path, session.path)


def _or_none(told: float | None) -> float:
    """As the kernel has what may not be told."""
    return -1.0 if told is None else told


def put_proxy(message: Message, aimed_ns: int, force: tuple[float, ...], planes: Any, reach_m: float | None) -> None:
    """A proxy's content besides position and level. The kernel's walls have neither curvature nor friction."""
    message.reach_m = _or_none(reach_m)
    message.aimed_ns = aimed_ns
    fill(message.force, force)
    message.planes = len(planes)
    for k, (normal, offset, stiffness, _, velocity, *_) in enumerate(planes):
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
        word = session.settings.expects.__name__.lower()
        session.dropped_for["stale"] = f"{word} {side.last_stale} comes after a later one"
    load(session.channel, record.channel)
    load(session.monitor, record.monitor)
    load(session.path, record.path)


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
