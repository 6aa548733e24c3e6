"""The path of a message that is offered to a link: the effects in their order, as functions of the link's state.

They use only a link's attributes, numbers and one another. So hapnet compiles them unchanged, for links whose messages
are records, where it simulates thousands of runs. The functions at the end call methods of a link of any items;
compiled code has other functions in their place.
"""

from __future__ import annotations

from heapq import heappush
from typing import TYPE_CHECKING, Any

from netem.resend import Resends, taken
from netem.stats import Counters

if TYPE_CHECKING:
    from netem.link import Link


def offer(link: Link[Any], now_ns: int, item: Any, size: int) -> None:
    """Offer an item of `size` bytes at `now_ns`."""
    counters, resends = link.counters, link.resends
    counters.offered = order = counters.offered + 1
    lost, corrupt, ahead, delay_ns, luck = draw(link, now_ns)
    if not link.is_up:
        counters.lost_down += 1
        return
    offered_ns = now_ns
    if lost and resends.times:
        times, lost = again(link, resends, now_ns, luck)
        counters.resent += times
        counters.recovered += 0 if lost else 1
        offered_ns += times * resends.after_ns
    if resends.ordered:
        link.in_order_ns = offered_ns = max(offered_ns, link.in_order_ns)
    if link.acts:
        lost, delay_ns = act(link, now_ns, size, lost, delay_ns)
    if lost:
        lose(counters, order)
        return
    if corrupt:
        item = corrupted(link, item)
    if is_full(link, now_ns, size):
        counters.dropped_limit += 1
        return
    link.since_reorder += 1
    if ahead and link.since_reorder >= link.gap and offered_ns == now_ns:
        link.since_reorder = 0
        counters.sent_ahead += 1
        put_ahead(link, now_ns, order, item)
        return
    if link.beside and offered_ns > now_ns:
        put_beside(link, offered_ns, order, item, now_ns, size, delay_ns)
        return
    due_ns = offered_ns + delay_ns
    if resends.ordered:
        link.last_due_ns = due_ns = max(due_ns, link.last_due_ns)
    if link.lined:
        due_ns = cross(link, due_ns, size)
    put(link, due_ns, order, item, now_ns, size)


def passes(link: Link[Any]) -> bool:
    """Offer and deliver a message at once, if the link has no effect and nothing is in flight. False: nothing was
    counted."""
    if not (link.transparent and link.is_up) or is_under_way(link):
        return False
    link.counters.offered = link.counters.newest = link.counters.offered + 1
    count_delay(link, 0)
    return True


def leave(link: Link[Any], due_ns: int, order: int, offered_ns: int) -> None:
    """Let the message with the number `order` leave the link."""
    arrive(link.counters, order)
    count_delay(link, due_ns - offered_ns)


def lose(counters: Counters, order: int) -> None:
    """Count the message with this number as lost by the loss model or a trace."""
    counters.lost += 1
    if counters.last_lost != order - 1:
        counters.loss_bursts += 1
    counters.last_lost = order


def arrive(counters: Counters, order: int) -> None:
    """Count the message with this number as delivered."""
    if order > counters.newest:
        counters.newest = order
    else:
        counters.reordered += 1


# -- functions that compiled code replaces ----------------------------------------------------------------------------


def is_under_way(link: Link[Any]) -> bool:
    """Whether anything is in flight."""
    return bool(link.queue or link.ready or link.later)


def count_delay(link: Link[Any], delay_ns: int) -> None:
    """Count the delay of a delivered message."""
    link.counters.delays.pending.append(delay_ns)


def draw(link: Link[Any], now_ns: int) -> tuple[bool, bool, bool, int, float]:
    """The message's draws: whether it is lost, corrupted, and may be sent ahead, its delay [ns], its luck."""
    drawn = link.streams.next()
    return link.under_conditions(now_ns, *drawn) if link.has_traces else drawn


def again(link: Link[Any], resends: Resends, now_ns: int, luck: float) -> tuple[int, bool]:
    """The number of resends of a lost message, and whether it is lost for good."""
    return link.taken_under_conditions(now_ns, luck) if link.has_traces else taken(resends, luck)


def act(link: Link[Any], now_ns: int, size: int, lost: bool, delay_ns: int) -> tuple[bool, int]:
    """Apply further impairments; return whether the message is lost, and its delay [ns]."""
    for acting in link.streams.others:
        more = None if lost else acting(now_ns, size)
        lost, delay_ns = more is None, delay_ns + (more or 0)
    return lost, delay_ns


def corrupted(link: Link[Any], item: Any) -> Any:
    """The item with a bit flipped."""
    return link.corrupted(item)


def is_full(link: Link[Any], now_ns: int, size: int) -> bool:
    """Whether a message of `size` bytes is beyond the limit of what is in flight."""
    at_limit = link.gate is not None or len(link.queue) >= link.limit or bool(link.later) or link.limit_bytes > 0
    return at_limit and link.is_full(now_ns, size)


def cross(link: Link[Any], ready_ns: int, size: int) -> int:
    """The time at which a message has crossed the line [ns]."""
    line = link.line
    assert line is not None, "a link that has a line"
    return line.release_ns(ready_ns, size)


def put(link: Link[Any], due_ns: int, order: int, item: Any, now_ns: int, size: int) -> None:
    """Put a message in flight until `due_ns`."""
    heappush(link.queue, (due_ns, order, item, now_ns, size))
    link.bytes_in_flight += size
    if link.gate is not None:
        link.gate.look(link.queue, now_ns)


def put_ahead(link: Link[Any], now_ns: int, order: int, item: Any) -> None:
    """Let a message leave at once, ahead of all others."""
    entry = (now_ns, order, item, now_ns, 0)
    if link.gate is not None:
        link.ready.append(entry)
    else:
        heappush(link.queue, entry)


def put_beside(link: Link[Any], offered_ns: int, order: int, item: Any, now_ns: int, size: int, delay_ns: int) -> None:
    """Store a message that reaches the line later than it was offered."""
    heappush(link.later, (offered_ns, order, item, now_ns, size, delay_ns))
    link.bytes_in_flight += size
