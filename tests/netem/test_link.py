"""The link: laws that hold for any profile, tc-netem's order of effects, and the kernel's recorded order and rate."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import stats

from netem import Link, LinkProfile, NetemError
from tests.netem.support import MS, drive, link_of, recorded, release_times, traced_profiles

short_times = st.one_of(st.just(0), st.integers(0, 50 * MS), st.integers(0, 50).map(lambda n: n * MS))
gaps = st.lists(st.one_of(st.just(0), st.integers(0, 20 * MS)), max_size=60)


@settings(max_examples=200, deadline=None)
@given(traced_profiles(short_times), gaps, st.integers(0, 2**32), st.data())
@pytest.mark.long
def test_laws_of_any_link(profile: LinkProfile, pauses: list[int], seed: int, data: st.DataObject) -> None:
    """Nothing comes out twice, early, out of order, or lost uncounted; when one polls is no matter."""
    watched, left_alone = Link[int](profile, seed), Link[int](profile, seed)
    now, sent, out = 0, [], []
    for number, pause in enumerate(pauses):
        now += pause
        for link in (watched, left_alone):
            link.send(now, number, size=number)
        sent.append(now)
        until = now + data.draw(st.sampled_from([0, pause]))
        released = watched.poll(until)
        assert all(due <= until for due, _ in released)
        out += released
        now = until
        assert watched.next_due_ns is None or watched.next_due_ns >= now or profile.slot
    while (due_ns := watched.next_due_ns) is not None:
        now = max(now, due_ns)
        out += watched.poll(now)
    assert left_alone.poll(now) == out
    assert all(earlier <= later for (earlier, _), (later, _) in pairwise(out))
    assert all(due >= sent[number] for due, number in out)
    assert len({number for _, number in out}) == len(out)
    for stats_of in (watched.stats, left_alone.stats):
        assert stats_of.offered == len(pauses)
        assert stats_of.delivered == len(out)
        assert stats_of.in_flight == 0
        assert len(out) + stats_of.lost + stats_of.dropped_limit == len(pauses)
        assert stats_of.lost == 0 or profile.loss is not None or profile.csv is not None
        assert (stats_of.loss_bursts > 0) == (stats_of.lost > 0)
        assert stats_of.lost_down == 0


@settings(max_examples=50, deadline=None)
@given(traced_profiles(short_times), traced_profiles(short_times), st.integers(0, 100))
@pytest.mark.long
def test_a_change_loses_and_repeats_nothing(first: LinkProfile, second: LinkProfile, when: int) -> None:
    link: Link[int] = Link(first, 3)
    out = []
    for number in range(100):
        now = number * MS
        if number == when:
            before = link.stats
            link.change(second, now)
            assert link.stats.in_flight == before.in_flight
        link.send(now, number, 50)
        out += link.poll(now)
    while (due_ns := link.next_due_ns) is not None:
        out += link.poll(due_ns)
    assert len({number for _, number in out}) == len(out)
    assert all(due >= number * MS for due, number in out)
    assert all(earlier <= later for (earlier, _), (later, _) in pairwise(out))
    assert len(out) + link.stats.lost + link.stats.dropped_limit == 100


def test_an_ideal_link_passes_everything_at_once() -> None:
    link = link_of("")
    link.send(5, 1)
    assert link.next_due_ns == 5
    assert link.poll(4) == []
    assert link.poll(5) == [(5, 1)]
    assert link.next_due_ns is None


def test_jitter_reorders_and_a_rate_keeps_the_order() -> None:
    loose = [number for _, number in drive(link_of("delay 40ms 10ms"), 500, MS)]
    kept = [number for _, number in drive(link_of("delay 40ms 10ms rate 100mbit"), 500, MS)]
    assert loose != sorted(loose)
    assert kept == sorted(kept)


def test_a_rate_releases_at_the_later_of_delay_and_line_plus_transmission() -> None:
    words, size = "delay 10ms 9ms rate 1mbit 42", 200
    link = link_of(words)
    plain = release_times(link_of("delay 10ms 9ms"), 300)
    line_free = 0
    for due_ns, number in drive(link, 300, MS, size):
        line_free = max(plain[number], line_free) + (size + 42) * 8000
        assert due_ns == line_free


def test_reordered_messages_go_at_once_ahead_of_the_queue() -> None:
    out = drive(link_of("delay 10ms reorder 30%"), 20_000, MS)
    ahead = [number for due, number in out if due == number * MS]
    assert {due - number * MS for due, number in out} == {0, 10 * MS}
    assert stats.binomtest(len(ahead), len(out), 0.3).pvalue > 1e-3


def test_what_is_due_at_the_same_instant_leaves_before_what_is_sent_ahead_then() -> None:
    link = link_of("delay 10ms gap 2")
    for number, now in enumerate((0, 5 * MS, 6 * MS, 10 * MS)):
        link.send(now, number)
    assert [number for _, number in link.poll(10 * MS)] == [1, 0, 3]


def test_a_gap_alone_sends_every_nth_message_ahead() -> None:
    out = drive(link_of("delay 10ms gap 5"), 100, 100 * MS)
    assert [number for due, number in out if due == number * 100 * MS] == list(range(4, 100, 5))


@pytest.mark.long
def test_a_gap_with_chance_waits_and_then_tries() -> None:
    """Mean distance of two messages sent ahead: gap - 1 that cannot, then 1/P tries."""
    link = link_of("delay 10ms reorder 25% gap 4")
    drive(link, 50_000, 20 * MS)
    distances = 3 + 1 / 0.25
    deviation = np.sqrt(0.75) / 0.25
    error = deviation * np.sqrt(50_000 / distances) / distances
    assert link.stats.sent_ahead == pytest.approx(50_000 / distances, abs=5 * error)


@pytest.mark.long
def test_correlated_reordering_reorders_as_often_as_asked() -> None:
    """`reorder 25% 50%` sends 7 % ahead in the kernel, which collapses there."""
    link = link_of("delay 10ms reorder 25% 50%")
    drive(link, 50_000, MS)
    error = np.sqrt(0.25 * 0.75 * (1.5 / 0.5) / 50_000)
    assert link.stats.sent_ahead / 50_000 == pytest.approx(0.25, abs=5 * error)


def test_a_link_that_is_down_loses_what_is_offered_only() -> None:
    link = link_of("delay 10ms")
    link.send(0, 0)
    link.down()
    assert not link.is_up
    link.send(MS, 1)
    link.up()
    link.send(2 * MS, 2)
    assert link.poll(10**9) == [(10 * MS, 0), (12 * MS, 2)]
    assert (link.stats.lost, link.stats.lost_down, link.stats.offered) == (0, 1, 3)


def test_corruption_flips_one_bit_of_bytes() -> None:
    link: Link[object] = Link(LinkProfile.parse("corrupt 10%"), 5)
    for _ in range(5000):
        link.send(0, bytes(20))
    flipped = [int.from_bytes(item, "big").bit_count() for _, item in link.poll(0) if isinstance(item, bytes)]
    assert set(flipped) == {0, 1}
    assert sum(flipped) == link.stats.corrupted
    assert stats.binomtest(sum(flipped), 5000, 0.1).pvalue > 1e-3
    link.send(0, "text")
    assert link.poll(0) == [(0, "text")]


def test_size_is_the_items_length_unless_given() -> None:
    link: Link[object] = Link(LinkProfile.parse("rate 8kbit"))
    link.send(0, b"abc")
    link.send(0, "ab", size=5)
    assert [due // MS for due, _ in link.poll(10**12)] == [3, 8]
    with pytest.raises(NetemError, match="size of int"):
        link.send(0, 5)
    with pytest.raises(NetemError, match="size: -1"):
        link.send(0, b"abc", size=-1)
    assert link.stats.offered == 2


def test_reordered_counts_late_arrivals() -> None:
    """RFC 4737: a message is reordered if one that was sent later came before it."""
    link = link_of("delay 10ms")
    link.send(0, 0)
    link.send(0, 1)
    link.change(LinkProfile.parse("delay 1ms"), 1)
    link.send(1, 2)
    assert [number for _, number in link.poll(10**9)] == [2, 0, 1]
    assert link.stats.reordered == 2


def test_statistics_of_a_known_link() -> None:
    link = link_of("delay 40ms loss 20%")
    assert link.stats.delay_p50_ms is None
    drive(link, 5000, MS)
    found = link.stats.as_dict()
    assert found["delay_p50_ms"] == found["delay_p99_ms"] == pytest.approx(40.0)
    assert found["profile"] == "delay 40ms loss 20%"
    (low, _), (high, count) = found["delay_histogram_ms"]
    assert low <= 40.0 <= high
    assert count == found["delivered"]
    assert {"offered", "delivered", "lost", "reordered", "in_flight"} <= set(found)


def test_any_item_travels_and_ties_are_never_compared() -> None:
    link: Link[object] = Link(LinkProfile.parse("delay 1ms"))
    items = [object(), {}, None]
    for item in items:
        link.send(0, item)
    assert [item for _, item in link.poll(MS)] == items


def test_rate_is_the_kernels() -> None:
    """972 bytes and 42 of headers every 5 ms into 1 mbit/s, up to the first packet that the kernel's queue lost."""
    kernel = recorded("rate1m")
    arrived = int(np.argmax(kernel[:, 1] < 0))
    ours = drive(link_of("rate 1mbit 42"), arrived, 5 * MS, 972)
    delays = np.array([due - number * 5 * MS for due, number in ours])
    # the recording's own noise: its sender and receiver are up to some ms late
    assert np.median(np.abs(kernel[:arrived, 2] - delays)) < 0.5 * MS
    assert np.abs(kernel[:arrived, 2] - delays).max() < 0.02 * delays.max()


@pytest.mark.long
def test_reordering_puts_messages_where_the_kernel_puts_them() -> None:
    """Given the kernel's choice of messages to send ahead, their places in the order of arrival follow."""
    kernel = recorded("reo")
    delayed, ahead = LinkProfile.parse("delay 10ms"), LinkProfile.parse("delay 10ms reorder 100%")
    link: Link[int] = Link(delayed)
    order = []
    for number, delay_ns in enumerate(kernel[:, 2].tolist()):
        now = number * MS // 2
        link.change(ahead if delay_ns < 5 * MS else delayed, now)
        link.send(now, number)
        order += link.poll(now)
    order += link.poll(10**12)
    moved = np.abs(np.argsort([number for _, number in order]) - kernel[:, 1])
    # one sent ahead meets one that is due just then (10 ms are 20 messages), and the recording's noise decides
    assert np.mean(moved <= 1) > 0.998
    assert moved.max() <= 5


def test_what_is_taken_out_late_shows_as_lateness_not_as_delay() -> None:
    link: Link[int] = Link(LinkProfile.parse("delay 10ms"))
    link.send(0, 1)
    link.send(5_000_000, 2)
    assert link.poll(12_500_000) == [(10_000_000, 1)]
    link.poll(15_000_000)
    assert link.stats.late_max_ms == 2.5
    assert link.stats.delay_mean_ms == 10.0


def test_corruption_reaches_the_bytes_inside_an_item() -> None:
    link: Link[tuple[str, bytes]] = Link(
        LinkProfile.parse("corrupt 100%"), flip=lambda item, corrupted: (item[0], corrupted(item[1]))
    )
    link.send(0, ("key", b"\0" * 100))
    ((_, (key, data)),) = link.poll(0)
    assert key == "key"
    assert sum(byte.bit_count() for byte in data) == 1
    assert link.stats.corrupted == 1


# The short way


@given(st.lists(st.sampled_from(["send", "passes", "down", "up", "delay", "nothing"]), max_size=60))
@pytest.mark.long
def test_what_passes_is_what_send_and_poll_would_have_let_out(steps: list[str]) -> None:
    """Two links live through the same; one asks first whether the message passes. Both deliver and count the same."""
    straight: Link[int] = Link(LinkProfile(), seed=1)
    plain: Link[int] = Link(LinkProfile(), seed=1)
    out: tuple[list[int], list[int]] = ([], [])
    for now, step in enumerate(steps):
        match step:
            case "down" | "up":
                getattr(straight, step)()
                getattr(plain, step)()
            case "delay" | "nothing":
                profile = LinkProfile(delay_ns=3) if step == "delay" else LinkProfile()
                straight.change(profile, now)
                plain.change(profile, now)
            case _:
                if step == "passes" and straight.passes():
                    out[0].append(now)
                else:
                    straight.send(now, now)
                plain.send(now, now)
        out[0].extend(item for _, item in straight.poll(now))
        out[1].extend(item for _, item in plain.poll(now))
        assert out[0] == out[1]
        assert straight.stats == plain.stats


def test_nothing_passes_a_link_that_does_something() -> None:
    for words in ("delay 1us", "loss 1%", "rate 1gbit", "slot 1ms", "reorder 5% delay 1ms"):
        assert not Link[int](LinkProfile.parse(words)).passes()
