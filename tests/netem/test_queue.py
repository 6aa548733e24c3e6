"""A link's queue: its limit, its line, and the slots in which it releases."""

import gc
import sys
import tracemalloc

import pytest

from netem import Link, LinkProfile
from tests.conftest import mostly_slow
from tests.netem.support import MS, drive, link_of


def test_the_limit_counts_what_is_in_flight() -> None:
    link = link_of("delay 10ms limit 3")
    for number in range(5):
        link.send(number, number)
    assert link.stats.dropped_limit == 2
    link.send(10 * MS, 5)  # the first is due, so there is room, whether or not somebody polled
    assert link.stats.dropped_limit == 2
    assert [number for _, number in link.poll(10**9)] == [0, 1, 2, 5]


def test_the_limit_comes_after_corruption_and_before_reordering() -> None:
    link: Link[bytes] = Link(LinkProfile.parse("delay 10ms gap 2 limit 1 corrupt 100%"))
    for now in range(4):
        link.send(now, b"abc")
    assert (link.stats.corrupted, link.stats.dropped_limit, link.stats.sent_ahead) == (4, 3, 0)
    link.send(20 * MS, b"abc")  # what the limit dropped does not count for the gap, so this one is the second
    assert link.stats.sent_ahead == 1


def test_messages_sent_ahead_do_not_wait_for_the_line() -> None:
    out = drive(link_of("delay 1ms reorder 100% rate 8bit"), 10, MS)
    assert out == [(number * MS, number) for number in range(10)]


def test_a_smaller_limit_loses_nothing_in_flight() -> None:
    link = link_of("delay 10ms")
    for number in range(5):
        link.send(0, number)
    link.change(LinkProfile.parse("delay 10ms limit 2"), 1)
    link.send(1, 5)
    assert [number for _, number in link.poll(10**9)] == [0, 1, 2, 3, 4]
    assert link.stats.dropped_limit == 1


@pytest.mark.parametrize("count", mostly_slow([50_000, 1_000_000], 0, 1))
def test_a_million_messages_in_flight_cost_their_own_memory_only(count: int) -> None:
    """One tuple of five, three numbers and a place in a list each; all of it given back when they have left."""
    link: Link[None] = Link(LinkProfile.parse(f"delay 10s 1s loss 1% rate 1tbit limit {count}"))
    entry = sys.getsizeof((0,) * 5) + 3 * sys.getsizeof(10**12) + 2 * 8  # a list has up to 1/8 to spare
    gc.collect()
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        for number in range(count):
            link.send(1000 * number, None, 64)
        in_flight = link.stats.in_flight
        during, _ = tracemalloc.get_traced_memory()
        delivered = 0
        while (due_ns := link.next_due_ns) is not None:
            delivered += len(link.poll(due_ns + MS))
        after, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert 0.98 * count < in_flight == delivered
    assert during - before < in_flight * (entry + 8)
    assert peak < during + in_flight * 16
    assert after - before < 1_000_000


def test_losses_do_not_count_for_the_limit() -> None:
    link = link_of("delay 10ms limit 3 loss 100%")
    drive(link, 10, 1)
    assert (link.stats.lost, link.stats.dropped_limit) == (10, 0)


def test_slots_gather_what_became_ready() -> None:
    """Every 10 ms from the first arrival on, while there is something to wait for."""
    out = drive(link_of("slot 10ms"), 35, MS)
    assert sorted({due // MS for due, _ in out}) == [10, 21, 32, 43]
    assert [number for _, number in out] == list(range(35))


def test_a_slot_lets_out_its_packets_and_bytes_only() -> None:
    link = link_of("slot 10ms packets 2")
    for number in range(5):
        link.send(0, number)
    assert [(due // MS, number) for due, number in link.poll(10**9)] == [(10, 0), (10, 1), (20, 2), (20, 3), (30, 4)]
    link = link_of("slot 10ms bytes 150")
    for number in range(5):
        link.send(0, number, 100)
    assert [due // MS for due, _ in link.poll(10**9)] == [10, 10, 20, 20, 30]


def test_reordered_messages_do_not_wait_for_slots() -> None:
    link = link_of("delay 1ms reorder 100% slot 50ms")
    link.send(7, 0)
    assert link.poll(7) == [(7, 0)]


def test_what_a_slot_held_back_leaves_when_slots_are_switched_off() -> None:
    link = link_of("slot 50ms")
    link.send(0, 0)
    link.change(LinkProfile(), 10 * MS)
    assert link.poll(10 * MS) == [(10 * MS, 0)]
