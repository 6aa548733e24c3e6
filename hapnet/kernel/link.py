"""One direction of the link: `netem.link`, with its `line` and its `resend`, and the messages that it carries."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from hapnet.records.equation import equation
from hapnet.records.record import AXES, PLANES, Floats, OfAxes, Record, VectorsOfPlanes, Wholes
from netem.effects import MOST_RESENDS

STREAM, ENERGY = 0, 1
"""The kinds of messages."""

LOST, AHEAD = 1, 2
"""What the draws decide about a message, added up."""

MOST_IN_FLIGHT, DRAWS = 2048, 512
"""There is room for so many messages on a link, and for so many draws."""

SPARE = 2
"""The last slots of a link are for messages that are being made."""


class Message(Record):
    """A message, and where it is on the link.

    kind : `STREAM` or `ENERGY`. order : its number on the link. offered_ns : when it was offered. octets : its size.
    sequence, stamp_ns, position, echo_ns, came_ns : of a stream's message; of a proxy besides aimed_ns, force, planes;
    of a law's `more` (a motion's velocity, a wave's integral), `amount` (a port's energy [nJ], a wave's span [ns]), and
    elapsed_ns (of the integral).
    total_nJ, acked_nJ : of an energy message. level : how full its sender's reservoir is; below 0: not sent. reach_m :
    of a proxy; below 0: not sent.
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
    total_nJ: int
    acked_nJ: int
    level: float
    reach_m: float


class Link(Record):
    """`Link` with the counts of its `Counters`, its messages in slots, its queue, and the draws of each message.

    queued : number of messages in the queue. capacity : of the queue, at most `limit`. due_ns, slots : the queue,
    latest first. unused, free_slots : the slots without a message.
    drawn, begun : number of draws, and how many messages were offered before the first. fates : `LOST` and `AHEAD`.
    delivered, delivered_ns : the delays of the delivered messages. overflow : the queue is too small.
    """

    limit: int
    gap: int
    transparent: int
    rate_bit_s: int
    overhead: int
    cell_size: int
    cell_bytes: int
    free_ns: int
    resends: int
    resend_times: int
    resend_after_ns: int
    resend_ordered: int
    resend_chances: Annotated[Floats, (MOST_RESENDS,)]
    in_order_ns: int
    last_due_ns: int
    since_reorder: int
    offered: int
    begun: int
    drawn: int
    queued: int
    capacity: int
    unused: int
    overflow: int
    delivered: int
    newest: int
    lost: int
    loss_bursts: int
    last_lost: int
    reordered: int
    sent_ahead: int
    resent: int
    recovered: int
    dropped_limit: int
    late_max_ns: int
    due_ns: Annotated[Wholes, (MOST_IN_FLIGHT,)]
    slots: Annotated[Wholes, (MOST_IN_FLIGHT,)]
    free_slots: Annotated[Wholes, (MOST_IN_FLIGHT,)]
    fates: Annotated[Wholes, (DRAWS,)]
    delays_ns: Annotated[Wholes, (DRAWS,)]
    luck: Annotated[Floats, (DRAWS,)]
    delivered_ns: Annotated[Wholes, (DRAWS + MOST_IN_FLIGHT,)]
    messages: Annotated[Sequence[Message], (MOST_IN_FLIGHT + SPARE,)]


NEVER = 2**63 - 1


@equation
def spare(link: Link, which: int) -> Message:
    """The slot in which a message is made."""
    return link.messages[MOST_IN_FLIGHT + which]


@equation
def next_due_ns(link: Link) -> int:
    """`Link.next_due_ns`."""
    return link.due_ns[link.queued - 1] if link.queued else NEVER


@equation
def passes(link: Link) -> bool:
    """`Link.passes`."""
    if not link.transparent or link.queued:
        return False
    link.offered = link.newest = link.offered + 1
    link.delivered_ns[link.delivered] = 0
    link.delivered += 1
    return True


@equation
def send(link: Link, now_ns: int, message: Message) -> None:
    """`Link.send`: offer a message."""
    at = link.offered - link.begun
    link.offered = order = link.offered + 1
    fate, delay_ns = link.fates[at], link.delays_ns[at]
    lost, offered_ns = fate & LOST != 0, now_ns
    if link.resends:
        if lost:
            lost, offered_ns = _resend(link, now_ns, link.luck[at])
        if link.resend_ordered:
            link.in_order_ns = offered_ns = max(offered_ns, link.in_order_ns)
    if lost:
        link.lost += 1
        if link.last_lost != order - 1:
            link.loss_bursts += 1
        link.last_lost = order
        return
    if link.queued >= link.limit:
        link.dropped_limit += 1
        return
    link.since_reorder += 1
    message.order, message.offered_ns = order, now_ns
    if fate & AHEAD and link.since_reorder >= link.gap and offered_ns == now_ns:
        link.since_reorder = 0
        link.sent_ahead += 1
        message.offered_ns = now_ns
        _queue(link, now_ns, message)
        return
    due_ns = offered_ns + delay_ns
    if link.resends and link.resend_ordered:
        link.last_due_ns = due_ns = max(due_ns, link.last_due_ns)
    if link.rate_bit_s:
        due_ns = link.free_ns = max(due_ns, link.free_ns) + _takes_ns(link, message.octets)
    _queue(link, due_ns, message)


@equation
def _resend(link: Link, now_ns: int, luck: float) -> tuple[bool, int]:
    """`Link._resend` of a lost message, with `Resends.taken`."""
    below = 0
    while below < link.resend_times and link.resend_chances[below] <= luck:
        below += 1
    failed = link.resend_times - below
    taken = min(failed + 1, link.resend_times)
    lost = failed == link.resend_times
    link.resent += taken
    if not lost:
        link.recovered += 1
    return lost, now_ns + taken * link.resend_after_ns


@equation
def _takes_ns(link: Link, size: int) -> int:
    """`netem.models.transmission_ns`."""
    length = max(0, size + link.overhead)
    if link.cell_size:
        length = -(-length // link.cell_size) * link.cell_bytes
    return length * 8_000_000_000 // link.rate_bit_s


@equation
def _queue(link: Link, due_ns: int, message: Message) -> None:
    """Put a copy of the message into the queue, by its due time and its number."""
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
def take(link: Link, now_ns: int) -> int:
    """`Link.poll` of one message: its slot, which is then free; -1 if none is due."""
    if link.queued == 0 or link.due_ns[link.queued - 1] > now_ns:
        return -1
    link.queued -= 1
    due_ns, slot = link.due_ns[link.queued], link.slots[link.queued]
    link.free_slots[link.unused] = slot
    link.unused += 1
    message = link.messages[slot]
    if message.order > link.newest:
        link.newest = message.order
    else:
        link.reordered += 1
    link.delivered_ns[link.delivered] = due_ns - message.offered_ns
    link.delivered += 1
    link.late_max_ns = max(link.late_max_ns, now_ns - due_ns)
    return int(slot)


@equation
def copy_message(source: Message, target: Message) -> None:
    """Copy a message."""
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
