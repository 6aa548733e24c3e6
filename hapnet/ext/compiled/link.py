"""One direction of the link, with the effects of `netem.offering`: its queue, and the messages in the queue."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any

from hapnet.mechanics.curvature import Bends
from hapnet.records.record import AXES, NEVER, PLANES, Floats, OfAxes, Record, VectorsOfPlanes, Wholes, equation
from netem import line, models, offering, resend
from netem.effects import MOST_RESENDS

STREAM, ENERGY, NOTHING = 0, 1, 2
"""The kinds of messages."""

LOST, AHEAD = 1, 2
"""Bits for the outcome of a message's draws; `fates` has their sum."""

MOST_IN_FLIGHT, DRAWS = 2048, 512
"""The room for messages on a link, and for draws."""

SPARE = 2
"""The last slots of a link are for messages that are being made."""


class MessageSlot(Record):
    """A message, and its place on the link.

    kind : `STREAM` or `ENERGY`; `NOTHING`: no message was made. order : its number on the link. offered_ns : the time
    of the offer. octets : its size.
    sequence, stamp_ns, position, echo_ns, came_ns : of a stream's message; a proxy adds aimed_ns, force, planes;
    a law's message adds `more` (a motion's velocity, a wave's integral), `amount` (a port's energy [nJ], a wave's span
    [ns]), and elapsed_ns (of the integral).
    total_nJ, acked_nJ : of an energy message. level : the fill level of the sender's reservoir; below 0: not sent.
    reach_m : of a proxy; below 0: not sent.
    """

    kind: int
    order: int
    offered_ns: int
    octets: int
    sequence: int
    stamp_ns: int
    echo_ns: int
    came_ns: int
    position: OfAxes
    more: OfAxes
    amount: int
    elapsed_ns: int
    aimed_ns: int
    force: OfAxes
    planes: int
    normal: VectorsOfPlanes
    offset: Annotated[Floats, (PLANES,)]
    stiffness: Annotated[Floats, (PLANES,)]
    velocity: Annotated[Floats, (PLANES,)]
    bends: Annotated[Sequence[Bends], (PLANES,)]
    friction: Annotated[Floats, (PLANES,)]
    total_nJ: int
    acked_nJ: int
    level: float
    reach_m: float


class LinkCounters(Record):
    """The link's counters of messages, as in `netem.stats.Counters`."""

    offered: int
    lost: int
    lost_down: int
    dropped_limit: int
    loss_bursts: int
    last_lost: int
    reordered: int
    sent_ahead: int
    resent: int
    recovered: int
    newest: int
    late_max_ns: int


class ResendsRecord(Record):
    """The link's resends, as in `netem.resend.Resends`."""

    times: int
    after_ns: int
    ordered: int
    ascending: Annotated[Floats, (MOST_RESENDS,)]


class RateLineRecord(Record):
    """A line with a bit rate, as `netem.line.RateLine`."""

    rate_bit_s: int
    overhead: int
    cell_size: int
    cell_overhead: int
    free_ns: int
    size: int
    takes_ns: int


class LinkRecord(Record):
    """The state of a `netem.Link`: its messages in slots, its queue, and the draws of each message.

    queued : number of messages in the queue. capacity : of the queue, at most `limit`. due_ns, slots : the queue,
    latest first. unused, free_slots : the slots without a message.
    drawn, begun : number of draws, and of messages offered before the first draw. fates : `LOST` and `AHEAD`.
    delivered, delivered_ns : the delays of the delivered messages. overflow : the queue is too small.
    """

    counters: LinkCounters
    resends: ResendsRecord
    line: RateLineRecord
    limit: int
    gap: int
    transparent: int
    is_up: int
    lined: int
    acts: int
    beside: int
    in_order_ns: int
    last_due_ns: int
    since_reorder: int
    begun: int
    drawn: int
    queued: int
    capacity: int
    unused: int
    overflow: int
    delivered: int
    due_ns: Annotated[Wholes, (MOST_IN_FLIGHT,)]
    slots: Annotated[Wholes, (MOST_IN_FLIGHT,)]
    free_slots: Annotated[Wholes, (MOST_IN_FLIGHT,)]
    fates: Annotated[Wholes, (DRAWS,)]
    delays_ns: Annotated[Wholes, (DRAWS,)]
    luck: Annotated[Floats, (DRAWS,)]
    delivered_ns: Annotated[Wholes, (DRAWS + MOST_IN_FLIGHT,)]
    messages: Annotated[Sequence[MessageSlot], (MOST_IN_FLIGHT + SPARE,)]


@equation
def spare(link: LinkRecord, which: int) -> MessageSlot:
    """The spare slot with this number, in which a message is made."""
    return link.messages[MOST_IN_FLIGHT + which]


@equation
def next_due_ns(link: LinkRecord) -> int:
    """The time at which the next message is due [ns]; `NEVER`: the queue is empty."""
    return link.due_ns[link.queued - 1] if link.queued else NEVER


for function in (
    offering.offer, offering.passes, offering.leave, offering.lose, offering.arrive, resend.taken, line.release_ns,
    models.transmission_ns,
):  # fmt: skip
    equation(function)


@equation
def passes(link: LinkRecord) -> bool:
    """Offer and deliver a message at once if the link has no effect now, as `netem.offering.passes` does."""
    of_records: Any = link
    return offering.passes(of_records)


@equation
def _is_under_way(link: LinkRecord) -> bool:
    return link.queued > 0


@equation
def _count_delay(link: LinkRecord, delay_ns: int) -> None:
    link.delivered_ns[link.delivered] = delay_ns
    link.delivered += 1


@equation
def send(link: LinkRecord, now_ns: int, message: MessageSlot) -> None:
    """Offer a message to the link, as `netem.Link.send` does."""
    of_records: Any = link
    offering.offer(of_records, now_ns, message, message.octets)


@equation
def _draw(link: LinkRecord, now_ns: int) -> tuple[bool, bool, bool, int, float]:
    """Return the draws of the message: lost, corrupted (never), ahead, delay [ns], luck. There are no traces."""
    at = link.counters.offered - 1 - link.begun
    return link.fates[at] & LOST != 0, False, link.fates[at] & AHEAD != 0, link.delays_ns[at], link.luck[at]


@equation
def _again(link: LinkRecord, resends: ResendsRecord, now_ns: int, luck: float) -> tuple[int, bool]:
    return resend.taken(resends, luck)  # type: ignore[arg-type]


@equation
def _act(link: LinkRecord, now_ns: int, size: int, lost: bool, delay_ns: int) -> tuple[bool, int]:
    return lost, delay_ns


@equation
def _corrupted(link: LinkRecord, message: MessageSlot) -> MessageSlot:
    return message


@equation
def _is_full(link: LinkRecord, now_ns: int, size: int) -> bool:
    return link.queued >= link.limit


@equation
def _cross(link: LinkRecord, ready_ns: int, size: int) -> int:
    return line.release_ns(link.line, ready_ns, size)  # type: ignore[arg-type]


@equation
def _put_ahead(link: LinkRecord, now_ns: int, order: int, message: MessageSlot) -> None:
    _put(link, now_ns, order, message, now_ns, 0)


@equation
def _put_beside(
    link: LinkRecord, offered_ns: int, order: int, message: MessageSlot, now_ns: int, size: int, delay_ns: int
) -> None:
    """Do nothing: on a compiled link no message reaches the line later than it was offered."""


@equation
def _put(link: LinkRecord, due_ns: int, order: int, message: MessageSlot, now_ns: int, size: int) -> None:
    """Put a copy of the message into the queue, sorted by due time and number."""
    message.order, message.offered_ns = order, now_ns
    if link.queued == link.capacity:
        link.overflow = 1
        return
    link.unused -= 1
    slot = link.free_slots[link.unused]
    copy_message(message, link.messages[slot])
    at = link.queued
    while at and link.due_ns[at - 1] <= due_ns:  # its number is the highest
        link.due_ns[at], link.slots[at] = link.due_ns[at - 1], link.slots[at - 1]
        at -= 1
    link.due_ns[at], link.slots[at] = due_ns, slot
    link.queued += 1


@equation
def take(link: LinkRecord, now_ns: int) -> int:
    """Remove the next due message from the queue, as `netem.Link.poll` does, and return its slot; -1: none is due."""
    if link.queued == 0 or link.due_ns[link.queued - 1] > now_ns:
        return -1
    link.queued -= 1
    due_ns, slot = link.due_ns[link.queued], link.slots[link.queued]
    link.free_slots[link.unused] = slot
    link.unused += 1
    message = link.messages[slot]
    of_records: Any = link
    offering.leave(of_records, due_ns, message.order, message.offered_ns)
    counters = link.counters
    counters.late_max_ns = max(counters.late_max_ns, now_ns - due_ns)
    return int(slot)


@equation
def copy_surfaces(source: MessageSlot, target: MessageSlot) -> None:
    """Do nothing: walls have no curvature and no friction. solids.py replaces this function."""


@equation
def copy_message(source: MessageSlot, target: MessageSlot) -> None:
    """Copy a message from one slot to another."""
    target.kind, target.order, target.offered_ns, target.octets = (
        source.kind, source.order, source.offered_ns, source.octets,
    )  # fmt: skip
    target.sequence, target.stamp_ns = source.sequence, source.stamp_ns
    target.echo_ns, target.came_ns = source.echo_ns, source.came_ns
    target.amount, target.elapsed_ns = source.amount, source.elapsed_ns
    target.aimed_ns, target.planes = source.aimed_ns, source.planes
    target.total_nJ, target.acked_nJ = source.total_nJ, source.acked_nJ
    target.level, target.reach_m = source.level, source.reach_m
    for i in range(AXES):
        target.position[i], target.more[i], target.force[i] = source.position[i], source.more[i], source.force[i]
    for k in range(source.planes):
        target.offset[k], target.stiffness[k] = source.offset[k], source.stiffness[k]
        target.velocity[k] = source.velocity[k]
        for i in range(AXES):
            target.normal[k][i] = source.normal[k][i]
    copy_surfaces(source, target)


CHOICES: dict[Callable[..., Any], Callable[..., Any]] = {
    offering.draw: _draw, offering.again: _again, offering.act: _act, offering.corrupted: _corrupted,
    offering.is_full: _is_full, offering.cross: _cross, offering.put: _put, offering.put_ahead: _put_ahead,
    offering.put_beside: _put_beside, offering.is_under_way: _is_under_way, offering.count_delay: _count_delay,
}  # fmt: skip
"""The functions that are compiled in place of functions of `netem.offering`."""
