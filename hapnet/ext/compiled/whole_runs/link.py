"""Copies a link, its draws and the messages on it to and from the kernel."""

from __future__ import annotations

from heapq import heapify
from typing import Any

import numpy as np

from hapnet.errors import BadMessage
from hapnet.ext.compiled import link as links
from hapnet.ext.compiled.endpoint import MOTION, PORT, POSITION, WAVE
from hapnet.ext.compiled.link import AHEAD, ENERGY, LOST, STREAM, MessageSlot
from hapnet.ext.compiled.memory import fill, plain
from hapnet.ext.compiled.whole_runs.coverage import OUT_OF_RANGE
from hapnet.ext.compiled.whole_runs.wire import put_proxy
from hapnet.mechanics.curvature import Bends
from hapnet.mechanics.plane import Plane
from hapnet.records.machine_code import NotCompiledError
from hapnet.records.record import fields
from hapnet.side.link_port import Packet
from hapnet.wire.fields import CURVATURES, FRICTION, INTEGRAL, LEVEL, REACH
from hapnet.wire.messages import Energy, Motion, Port, Position, Proxy, Wave, decode, encode
from hapnet.wire.session import Session
from netem import Link
from netem.draws import Fates
from netem.line import RateLine

LONG_AGO = -(2**62)
COUNTERS = tuple(fields(links.LinkCounters))
STATE = ("limit", "gap", "transparent", "is_up", "lined", "acts", "beside", "since_reorder")


class CompiledLink:
    """One direction of the link in the kernel. record : the kernel's. link : the reference's."""

    def __init__(self, record: links.LinkRecord, link: Link[Packet]) -> None:
        self._link, self._record = link, record
        nothing = np.zeros(0)
        self._unused = Fates(nothing.astype(np.bool_), nothing.astype(np.bool_), nothing.astype(np.int64), nothing)
        profile = link.profile
        for name in STATE:
            setattr(record, name, getattr(link, name))
        if isinstance(link.line, RateLine):
            for name in RateLine.__slots__:
                setattr(record.line, name, getattr(link.line, name))
            record.line.free_ns = max(link.line.free_ns, LONG_AGO)
        resends = link.resends
        record.resends.times, record.resends.after_ns = resends.times, resends.after_ns
        record.resends.ordered = resends.ordered
        fill(record.resends.ascending, list(resends.ascending))
        record.in_order_ns = max(link.in_order_ns, LONG_AGO)
        record.last_due_ns = max(link.last_due_ns, LONG_AGO)
        for name in COUNTERS:
            setattr(record.counters, name, getattr(link.counters, name))
        record.begun = record.counters.offered
        record.capacity = min(profile.limit, links.MOST_IN_FLIGHT)
        self._load()

    def refill(self) -> None:
        """Draw for further messages if few draws are left, and count the delays so far."""
        record = self._record
        used = int(record.counters.offered - record.begun)
        if record.drawn - used >= 2:
            return
        self._count()
        left = _from(self._unused, used)
        fresh = self._link.streams.many(int(record.begun + record.drawn), links.DRAWS - len(left.lost))
        parts: Any = zip(left, fresh, strict=True)
        self._unused = Fates._make(map(np.concatenate, parts))
        lost, ahead, delay_ns, luck = self._unused
        record.begun, record.drawn = record.counters.offered, len(lost)
        record.fates[: len(lost)] = LOST * lost.astype(np.int64) + AHEAD * ahead.astype(np.int64)
        record.delays_ns[: len(lost)], record.luck[: len(lost)] = delay_ns, luck

    def write_back(self, sender: Session, kind: int) -> None:
        """Copy the state back to the reference's link; `sender` has sent the messages on it, which are of this kind."""
        self._count()
        link, record = self._link, self._record
        used = int(record.counters.offered - record.begun)
        link.streams.put_back(_from(self._unused, used))
        for name in COUNTERS:
            setattr(link.counters, name, getattr(record.counters, name))
        if isinstance(link.line, RateLine) and record.line.free_ns > LONG_AGO:
            link.line.free_ns = int(record.line.free_ns)
        if record.in_order_ns > LONG_AGO:
            link.in_order_ns, link.last_due_ns = int(record.in_order_ns), int(record.last_due_ns)
        link.since_reorder = int(record.since_reorder)
        link.queue.clear()
        for at in range(int(record.queued)):
            message = record.messages[record.slots[at]]
            entry: tuple[int, int, Packet, int, int] = (
                int(record.due_ns[at]), int(message.order), _packet(message, sender, kind), int(message.offered_ns),
                int(message.octets),
            )  # fmt: skip
            link.queue.append(entry)
        heapify(link.queue)

    def _count(self) -> None:
        """Count the delays of the delivered messages."""
        record, delays = self._record, self._link.counters.delays
        delays.pending.extend(plain(record.delivered_ns[: int(record.delivered)]))
        delays.fold()
        record.delivered = 0

    def _load(self) -> None:
        """Copy the messages on the link to the kernel."""
        record = self._record
        if len(self._link.queue) > record.capacity:
            raise NotCompiledError(OUT_OF_RANGE)
        for slot, (due_ns, order, packet, offered_ns, size) in enumerate(sorted(self._link.queue, reverse=True)):
            message = record.messages[slot]
            try:
                content: Any = decode(packet.data)
            except BadMessage as error:
                raise NotCompiledError(OUT_OF_RANGE) from error
            message.order, message.offered_ns, message.octets = order, offered_ns, size
            if isinstance(content, Energy):
                message.kind, message.total_nJ, message.acked_nJ = ENERGY, content.total_nJ, content.acked_nJ
            else:
                message.kind, message.sequence, message.stamp_ns = STREAM, content.sequence, content.sent_ns
                message.echo_ns, message.came_ns = content.echo_ns, content.came_ns
                fill(message.position, content.vector)
                more = content.more or {}
                message.level = more.get(LEVEL, -1.0)
                match content:
                    case Proxy():
                        planes = Plane.all_of(content.planes, more.get(CURVATURES), more.get(FRICTION))
                        put_proxy(message, content.aimed_ns, content.force, planes, more.get(REACH))
                    case Motion():
                        fill(message.more, content.velocity)
                    case Port():
                        message.amount = content.energy_nJ
                    case Wave():
                        total, message.elapsed_ns = more[INTEGRAL]
                        message.amount = content.span_ns
                        fill(message.more, total)
            record.due_ns[slot], record.slots[slot] = due_ns, slot
        record.queued = len(self._link.queue)
        record.unused = record.capacity - record.queued
        record.free_slots[: record.unused] = np.arange(record.queued, record.capacity)


def _from(fates: Fates, first: int) -> Fates:
    """The draws from number `first` on."""
    return Fates(fates.lost[first:], fates.ahead[first:], fates.delay_ns[first:], fates.luck[first:])


def _packet(message: MessageSlot, sender: Session, kind: int) -> Packet:
    """The message as a packet of the reference's link."""
    me, peer, n = sender.identity.incarnation, sender.peer, sender.identity.dof
    assert peer is not None
    if message.kind == ENERGY:
        return Packet("energy", encode(Energy(me, peer.incarnation, int(message.total_nJ), int(message.acked_nJ))))
    start = me, int(message.sequence), int(message.stamp_ns), tuple(plain(message.position[:n]))
    echo = int(message.echo_ns), int(message.came_ns)
    more = {name: float(value) for name, value in ((REACH, message.reach_m), (LEVEL, message.level)) if value >= 0.0}
    if kind == MOTION:
        return Packet("position", encode(Motion(*start, tuple(plain(message.more[:n])), *echo)))
    if kind == PORT:
        return Packet("position", encode(Port(*start, int(message.amount), *echo)))
    if kind == WAVE:
        integral = {INTEGRAL: (tuple(plain(message.more[:n])), int(message.elapsed_ns))}
        return Packet("position", encode(Wave(*start, int(message.amount), *echo, integral)))
    if kind == POSITION:
        return Packet("position", encode(Position(*start, *echo, more or None)))
    count = int(message.planes)
    planes = tuple(
        (tuple(plain(message.normal[k][:n])), float(message.offset[k]), float(message.stiffness[k]), 0.0,
         float(message.velocity[k]))
        for k in range(count)
    )  # fmt: skip
    bends = tuple(_bends(message.bends[k], n) for k in range(count))
    friction = tuple(plain(message.friction[:count]))
    surfaces = {name: each for name, each in ((CURVATURES, bends), (FRICTION, friction)) if any(each)}
    aimed_ns, force = int(message.aimed_ns), tuple(plain(message.force[:n]))
    return Packet("position", encode(Proxy(*start, aimed_ns, force, planes, *echo, {**surfaces, **more})))


def _bends(bends: Bends, n: int) -> tuple[Any, ...]:
    return tuple((tuple(plain(bends.directions[j][:n])), float(bends.per_m[j])) for j in range(int(bends.count)))
