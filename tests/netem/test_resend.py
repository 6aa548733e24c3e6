"""Resends: what is lost is offered again, at most N times, and arrives once; losses and delays as derived."""

from collections.abc import Callable
from itertools import islice, pairwise

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import stats

from netem import ConditionTrace, Link, LinkProfile, Timeline, TimelinePlayer, expect, models
from netem.effects import RandomLoss, Resend
from netem.loss_chain import lost_again
from tests.conftest import mostly_slow
from tests.netem.support import drive, loss_models

MS = 1_000_000
PLAIN = "delay 20ms loss 30%"


def fates(words: str, count: int, seed: int = 1, interval_ns: int = MS) -> dict[int, int]:
    """What arrives of `count` messages, and each one's delay."""
    link: Link[int] = Link(LinkProfile.parse(words), seed)
    out = drive(link, count, interval_ns)
    assert len({number for _, number in out}) == len(out)
    return {number: due - number * interval_ns for due, number in out}


def likely(hits: int, tries: int, chance: float) -> bool:
    return float(stats.binomtest(hits, tries, chance).pvalue) > 1e-4


@pytest.mark.parametrize(("percent", "times"), [(10, 1), (30, 2), (50, 3), (90, 7), (100, 5)])
def test_independent_losses_of_p_become_p_to_the_n_plus_1(percent: int, times: int) -> None:
    count, p = 10_000, percent / 100
    link: Link[int] = Link(LinkProfile.parse(f"loss {percent}% resend {times} 5ms unordered"), 3)
    arrived = {number: due for due, number in drive(link, count, MS)}
    found = link.stats
    assert (found.delivered, found.lost) == (len(arrived), count - len(arrived))
    assert likely(found.lost, count, p ** (times + 1))
    taken = [(due - number * MS) // (5 * MS) for number, due in arrived.items()]
    for k in range(times + 1):  # each of these delays and no other, each with its chance
        assert likely(taken.count(k), count, p**k * (1 - p))
    assert all((due - number * MS) % (5 * MS) == 0 for number, due in arrived.items())
    assert found.recovered == len(arrived) - taken.count(0)
    assert found.resent == sum(taken) + times * found.lost
    assert expect(link.profile).loss == pytest.approx(p ** (times + 1))


def arrived_of(first: str, second: str, count: int) -> set[int]:
    """The messages that arrive of so many; the second profile counts from the middle on."""
    link: Link[int] = Link(LinkProfile.parse(first), 5)
    for number in range(count):
        if number == count // 2:
            link.change(LinkProfile.parse(second), number * MS)
        link.send(number * MS, number, 100)
    return {number for _, number in link.poll(10 * count * MS)}


def test_resends_begin_in_the_middle_and_go_on_where_something_else_changes() -> None:
    """Half are lost, and with a resend a quarter. A change of the delay leaves the draws of all others as they were."""
    count, once = 8_000, "loss 50% resend 1 5ms unordered"
    late = [number for number in arrived_of("loss 50%", once, count) if number >= count // 2]
    assert likely(len(late), count // 2, 0.75)
    assert arrived_of(once, f"delay 3ms {once}", count) == arrived_of(once, once, count)


@pytest.mark.parametrize(
    "loss", mostly_slow(["gemodel 2% 20%", "gemodel 5% 30% 80% 1%", "state 3% 25% 15% 30% 2%", "10% 60%"], 1)
)
@pytest.mark.long
def test_a_burst_takes_the_resends_with_it(loss: str) -> None:
    """All N resends are lost as often as N more losses follow one in a plain link, the first of the burst or not."""
    count, times = 30_000, 2
    link: Link[int] = Link(LinkProfile.parse(f"loss {loss} resend {times} 3ms"), 9)
    lost = np.concatenate(list(islice(models.losses(np.random.default_rng(8), link.profile.loss), 2000)))
    in_a_row = lost[:-2] & lost[1:-1] & lost[2:]
    drive(link, count, MS)
    # a run of losses counts once for each of its messages, so the error is that of far fewer bursts
    burst = 4.0 / (1.0 - lost_again(link.profile.loss, 1)[0])
    error = (in_a_row.mean() * burst / count) ** 0.5
    assert link.stats.lost / count == pytest.approx(in_a_row.mean(), abs=5 * error)
    assert expect(link.profile).loss == pytest.approx(in_a_row.mean(), abs=5 * error)


@given(loss_models, st.integers(1, 12))
@pytest.mark.long
def test_the_chances_that_losses_go_on_only_fall(loss: RandomLoss, most: int) -> None:
    chances = lost_again(loss, most)
    assert len(chances) == most
    assert all(0.0 <= later <= earlier <= 1.0 for earlier, later in pairwise((1.0, *chances)))
    assert lost_again(loss, most + 3)[:most] == pytest.approx(chances)


def test_what_is_lost_first_and_all_other_draws_stay_as_they_are_without() -> None:
    """The same messages are lost when first offered, all others have the same delays; N more resends save more."""
    words = "delay 20ms 5ms loss gemodel 10% 40%"
    plain = fates(words, 3000)
    few, more = (fates(f"{words} resend {n} 7ms unordered", 3000) for n in (1, 3))
    assert all(few[number] == more[number] == delay for number, delay in plain.items())
    assert plain.keys() < few.keys() < more.keys()
    assert all(more[number] == delay for number, delay in few.items())
    assert all(delay >= 7 * MS + 15 * MS for number, delay in few.items() if number not in plain)


waits = st.integers(0, 12 * MS)


@settings(max_examples=60, deadline=None)
@given(st.lists(waits, min_size=1, max_size=40), st.integers(1, 5), waits, st.floats(0, 0.95), st.integers(0, 99))
def test_in_order_each_waits_for_all_before_it(
    pauses: list[int], times: int, after_ns: int, loss: float, seed: int
) -> None:
    """In order a message leaves when it and all before it have come through or were given up, N resends after."""
    profile = LinkProfile(delay_ns=3 * MS, loss=RandomLoss(loss), resend=Resend(times, after_ns, ordered=False))
    loose: Link[int] = Link(profile, seed)
    ordered: Link[int] = Link(profile.replace(resend=Resend(times, after_ns)), seed)
    sent = np.cumsum(pauses).tolist()
    for number, now in enumerate(sent):
        loose.send(now, number)
        ordered.send(now, number)
    alone = {number: due for due, number in loose.poll(10**15)}
    expected, through = [], 0
    for number, now in enumerate(sent):
        through = max(through, alone.get(number, now + times * after_ns + 3 * MS))
        if number in alone:
            expected.append((through, number))
    assert ordered.poll(10**15) == expected
    assert [number for _, number in expected] == sorted(alone)


@pytest.mark.parametrize("more", ["", " rate 1mbit", " distribution pareto", " slot 3ms 9ms"])
def test_in_order_is_in_order_whatever_the_jitter(more: str) -> None:
    """None leaves before it would alone, or before one that was sent earlier; jitter is uniform, 55 ms at most."""
    words = f"delay 40ms 15ms{more} loss 10%"
    plain: Link[int] = Link(LinkProfile.parse(f"{words} resend 3 8ms unordered"), 5)
    ordered: Link[int] = Link(LinkProfile.parse(f"{words} resend 3 8ms"), 5)
    for number in range(3000):
        for link in (plain, ordered):
            link.send(5 * MS * number, number, 100)
    loose, kept = plain.poll(10**15), ordered.poll(10**15)
    numbers = [number for _, number in kept]
    assert numbers == sorted(number for _, number in loose)
    assert ordered.stats.reordered == 0
    assert plain.stats.reordered > 200 or "slot" in more
    if not more:
        through, alone = 0, {number: due for due, number in loose}
        for due, number in kept:
            through = max(through, alone[number])
            assert through <= due <= (5 * number + 3 * 8 + 55) * MS


@settings(max_examples=60, deadline=None)
@given(st.lists(waits, min_size=1, max_size=40), st.integers(1, 5), waits, st.booleans(), st.integers(0, 99), st.data())
@pytest.mark.long
def test_over_a_line_each_message_takes_its_turn_when_it_is_offered_for_the_last_time(
    pauses: list[int], times: int, after_ns: int, in_order: bool, seed: int, data: st.DataObject
) -> None:
    """A line serves who comes first: in order that is who was sent first, unordered who was resent last comes last."""
    words = LinkProfile(delay_ns=2 * MS, loss=RandomLoss(0.4), resend=Resend(times, after_ns, ordered=in_order))
    link: Link[int] = Link(words.replace(rate_bit_s=10**6), seed)  # 250 bytes take 2 ms
    sent = np.cumsum(pauses).tolist()
    alone: Link[int] = Link(words, seed)
    out = []
    for number, now in enumerate(sent):
        link.send(now, number, 250)
        alone.send(now, number)
        if data.draw(st.booleans()):
            out += link.poll(now)
    out += link.poll(10**15)
    line_free, expected = 0, []
    for due, number in sorted(alone.poll(10**15)):
        line_free = max(due, line_free) + 2 * MS
        expected.append((line_free, number))
    assert out == expected


@settings(max_examples=60, deadline=None)
@given(st.lists(waits, min_size=5, max_size=40), waits, st.integers(0, 99))
def test_slots_after_a_line_open_alike_whenever_one_polls(pauses: list[int], after_ns: int, seed: int) -> None:
    profile = LinkProfile.parse("loss 40% rate 2mbit slot 3ms 4ms packets 2")
    profile = profile.replace(resend=Resend(3, after_ns, ordered=False))
    watched, left_alone = Link[int](profile, seed), Link[int](profile, seed)
    out = []
    for number, now in enumerate(np.cumsum(pauses).tolist()):
        watched.send(now, number, 100)
        left_alone.send(now, number, 100)
        out += watched.poll(now)
        for later in range(now, now + 60 * MS, MS // 2) if number == len(pauses) - 1 else ():
            out += watched.poll(later)
    end = 10**12
    assert left_alone.poll(end) == out + watched.poll(end)


def test_by_hand_in_order_and_not() -> None:
    """The first of three is lost once, the others not: 5 ms later it comes through, or it is given up with N = 1."""
    for seed in range(1000):
        lost = [number not in fates("loss 50%", 3, seed) for number in range(3)]
        if lost == [True, False, False] and len(fates("loss 50% resend 1 5ms", 3, seed)) == 3:
            break
    assert fates("loss 50% resend 1 5ms unordered", 3, seed) == {0: 5 * MS, 1: 0, 2: 0}
    assert fates("loss 50% resend 1 5ms", 3, seed) == {0: 5 * MS, 1: 4 * MS, 2: 3 * MS}
    # 100 bytes at 1 mbit/s take 0.8 ms: unordered the two others cross before it
    assert fates("loss 50% resend 1 5ms unordered rate 1mbit", 3, seed) == {0: 5_800_000, 1: 800_000, 2: 800_000}
    assert fates("loss 50% resend 1 5ms rate 1mbit", 3, seed) == {0: 5_800_000, 1: 5_600_000, 2: 5_400_000}
    link: Link[int] = Link(LinkProfile.parse("loss 50% resend 1 5ms unordered rate 1mbit"), seed)
    link.send(0, 0, 100)
    link.change(LinkProfile(), MS)
    assert link.next_due_ns == 5 * MS
    assert not link.passes()  # what would, would overtake it
    assert link.poll(10 * MS) == [(5 * MS, 0)]
    assert link.passes()
    # what waits for a resend when a slow line is changed comes through before what is on that line
    link = Link(LinkProfile.parse("loss 50% resend 1 5ms unordered rate 8kbit"), seed)
    link.send(0, 0, 100)
    link.send(0, 1, 100)
    link.change(LinkProfile(), MS)
    assert link.next_due_ns == 5 * MS
    assert link.poll(5 * MS) == [(5 * MS, 0)]
    assert link.next_due_ns == 100 * MS
    # the slot is drawn when the message comes to the line, 10 ms from then
    assert fates("loss 50% resend 1 5ms unordered rate 1mbit slot 10ms", 1, seed) == {0: 15 * MS}


def test_each_resend_meets_the_trace_of_its_own_time() -> None:
    """Everything is lost up to 10 ms, or 7: of messages every 4 ms that is resent after 4, 8 and 12 ms."""
    trace = ConditionTrace("memory", (0, 10 * MS), (0, 0), (1.0, 0.0))
    for start_ms, times, delays in ((0, 2, [None, 8, 4]), (0, 3, [12, 8, 4]), (-3, 1, [None, 4, 0])):
        profile = LinkProfile(csv=trace, resend=Resend(times, 4 * MS, ordered=False))
        link: Link[int] = Link(profile, 1, start_ns=start_ms * MS)
        found = {number: due - 4 * MS * number for due, number in drive(link, 3, 4 * MS)}
        assert [found.get(number) for number in range(3)] == [None if d is None else d * MS for d in delays]


def test_a_trace_and_a_loss_model_together_are_what_is_expected() -> None:
    trace = ConditionTrace("memory", (0, 10**9), (0, 0), (0.3, 0.0))
    profile = LinkProfile(csv=trace, loss=RandomLoss(0.2), resend=Resend(2, 0))
    assert expect(profile).loss == pytest.approx((0.44**3 + 0.2**3) / 2)
    link: Link[int] = Link(profile, 1, start_ns=0)
    drive(link, 20_000, MS)
    assert likely(link.stats.lost, 20_000, (0.44**3 + 0.2**3) / 2)
    assert expect(profile).resent == pytest.approx((0.44 + 0.44**2 + 0.2 + 0.2**2) / 2)


@pytest.mark.parametrize("words", ["delay 20ms 5ms loss 20% resend 3 7ms unordered", "loss 30% 20% resend 2 0ms"])
def test_links_with_resends_achieve_what_is_expected(words: str) -> None:
    count = 20_000
    link: Link[int] = Link(LinkProfile.parse(words), 4)
    drive(link, count, MS)
    found, asked = link.stats, expect(link.profile)
    assert found.lost / count == pytest.approx(asked.loss, abs=5 * (3 * asked.loss / count) ** 0.5)
    assert found.recovered / count == pytest.approx(asked.recovered, abs=5 * (asked.recovered * 3 / count) ** 0.5)
    assert found.resent / count == pytest.approx(asked.resent, rel=0.05)
    assert found.delay_mean_ms == pytest.approx(asked.delay_mean_ms, abs=0.04 * asked.delay_std_ms + 1e-9)
    assert found.delay_std_ms == pytest.approx(asked.delay_std_ms, rel=0.03, abs=1e-9)


def test_of_the_expected_delay_a_resend_is_its_time() -> None:
    """Half arrives at once, a quarter after 10 ms: a third of what arrives; its deviation that of a coin."""
    found = expect(LinkProfile.parse("delay 5ms loss 50% resend 1 10ms"))
    assert (found.loss, found.recovered, found.resent) == pytest.approx((0.25, 0.25, 0.5))
    assert found.delay_mean_ms == pytest.approx(5.0 + 10.0 / 3.0)
    assert found.delay_std_ms == pytest.approx(10.0 * (2.0 / 9.0) ** 0.5)
    assert found.delay_correlation is None


def test_when_a_link_goes_down_what_waits_for_a_resend_arrives_and_what_is_offered_is_not_resent() -> None:
    link: Link[int] = Link(LinkProfile.parse("loss 50% resend 20 1ms unordered rate 1gbit"), 1)
    for number in range(20):
        link.send(0, number, 100)
    out = [number for _, number in link.poll(MS - 1)]
    assert 0 < len(out) < 20
    assert (link.stats.delivered, link.stats.in_flight) == (len(out), 20 - len(out))
    link.down()
    link.send(MS - 1, 20, 100)
    out += [number for _, number in link.poll(10**12)]
    assert sorted(out) == list(range(20))
    assert (link.stats.lost_down, link.stats.lost, link.stats.in_flight) == (1, 0, 0)


@pytest.mark.parametrize(
    "then", ["", "delay 1ms", "rate 1mbit", "slot 3ms", "loss 20% resend 1 1ms unordered rate 1mbit"]
)
def test_a_change_lets_what_waits_for_a_resend_arrive_once(then: str) -> None:
    link: Link[int] = Link(LinkProfile.parse("delay 1ms loss 50% resend 30 4ms unordered rate 1mbit"), 1)
    player = TimelinePlayer(link, Timeline.parse(f"at 50ms: {then or 'ideal'}"), 0)
    out = []
    for number in range(50):
        link.send(number * MS, number, 10)
        out += link.poll(number * MS)
    assert link.stats.in_flight
    player.advance(50 * MS)
    while (due := link.next_due_ns) is not None:
        out += link.poll(due)
    assert sorted(number for _, number in out) == list(range(50))
    assert all(earlier <= later for (earlier, _), (later, _) in pairwise(out))
    assert link.stats.in_flight == 0


def test_what_is_resent_or_waits_is_not_sent_ahead() -> None:
    """All others are, without a delay."""
    loose = fates("delay 10ms reorder 100% loss 50% resend 2 3ms unordered", 500)
    assert set(loose.values()) == {0, 13 * MS, 16 * MS}
    ordered = fates("delay 10ms reorder 100% loss 50% resend 2 3ms", 500)
    assert set(ordered.values()) == {0, *(k * MS for k in range(11, 17))}


def test_what_waits_for_a_resend_counts_for_the_limit() -> None:
    link: Link[int] = Link(LinkProfile.parse("loss 99% resend 100 1ms unordered rate 1gbit limit 5"), 2)
    for number in range(50):
        link.send(number, number, 10)
        assert link.stats.in_flight <= 5
    found = link.stats
    assert found.dropped_limit > 0
    assert found.offered == found.lost + found.dropped_limit + found.in_flight + found.delivered


def test_resends_without_losses_change_nothing() -> None:
    assert fates("delay 9ms 5ms rate 5mbit", 500) == fates("delay 9ms 5ms rate 5mbit resend 7 3ms", 500)


@pytest.mark.parametrize("name", ["wifi", "4g", "5g"])
def test_named_profiles_that_resend_lose_what_their_comments_say(name: str) -> None:
    stays = {"wifi": 0.001, "4g": 0.002, "5g": 0.001}[name]
    profile = LinkProfile.preset(name)
    assert isinstance(profile.loss, RandomLoss)
    assert profile.loss.probability == 0.1
    assert profile.resend.ordered
    assert expect(profile).loss == pytest.approx(stays, rel=0.1)
    out = drive(Link(profile, 1), 5000, MS)
    assert [number for _, number in out] == sorted(number for _, number in out)


@pytest.fixture(params=["", " unordered", " unordered rate 5mbit", " rate 5mbit"])
def words(request: pytest.FixtureRequest) -> str:
    return f"delay 3ms 2ms loss 30% 20% resend 2 4ms{request.param}"


def test_one_seed_one_fate(words: str) -> None:
    assert fates(words, 800, 1) == fates(words, 800, 1) != fates(words, 800, 2)


def test_words_are_read_and_written() -> None:
    read: Callable[[str], LinkProfile] = LinkProfile.parse
    assert read("resend 3 8ms").resend == Resend(3, 8 * MS)
    assert read("resend 3 8ms unordered loss 2%").resend == Resend(3, 8 * MS, ordered=False)
    assert read("resend 0") == read("resend 0 loss 0%").replace(loss=None) == LinkProfile()
    assert str(read("loss 2% resend 3 8ms unordered rate 1mbit")) == "loss 2% resend 3 8ms unordered rate 1mbit"
