"""Whose numbers go on: whatever the network does to an honest sender nothing changes, and no forger blinds a side."""

import random
from collections.abc import Iterator

import pytest

from hapnet.wire.numbering import AGAIN, DOUBTFUL, LATE, MOST_AT_ONCE, NEW, RUN, Numbering
from netem import Link, LinkProfile

MS = 1_000_000
CLOCK = 77_000_000_000
"""What the sender's clock is behind the receiver's [ns]."""

Heard = tuple[int, int, int]
"""When a message came, its number and its stamp."""


def honest(count: int, period_ns: int, words: str = "", seed: int = 0) -> list[Heard]:
    """Messages of a sender with this period over a link, in the order in which they come."""
    link: Link[tuple[int, int]] = Link(LinkProfile.parse(words), seed=seed)
    for number in range(count):
        now_ns = number * period_ns
        link.send(now_ns, (number, now_ns))
    return [(due_ns + CLOCK, number, sent_ns) for due_ns, (number, sent_ns) in link.poll(10**15)]


def places(numbering: Numbering, heard: list[Heard]) -> Iterator[tuple[Heard, int]]:
    for message in heard:
        yield message, numbering.place(*message)


@pytest.mark.parametrize(
    "words",
    [
        "", "loss 30%", "delay 40ms 10ms distribution normal loss 2%", "delay 200ms 150ms distribution normal loss 20%",
        "delay 15ms 15ms distribution pareto loss gemodel 5% 20%", "delay 40ms reorder 20% 30% gap 3",
        "delay 300ms 100ms distribution paretonormal", "delay 1s 500ms distribution normal",
    ],
)  # fmt: skip
@pytest.mark.parametrize("period_ns", [MS, 5 * MS, 30 * MS])
@pytest.mark.long
def test_of_an_honest_sender_the_newest_wins_whatever_the_link_does(words: str, period_ns: int) -> None:
    for seed in range(3):
        newest = -1
        for (_, number, _), place in places(Numbering(), honest(2000, period_ns, words, seed)):
            assert place == (NEW if number > newest else LATE)
            newest = max(newest, number)


def test_copies_of_old_messages_turn_nothing_over() -> None:
    """A thousand of them, in order, while the sender is silent: unlike a copy's, a run's stamps rise."""
    numbering, heard = Numbering(), honest(1000, 5 * MS, "delay 20ms 5ms loss 5%")
    assert {place for _, place in places(numbering, heard)} <= {NEW, LATE}
    end_ns = heard[-1][0]
    again = [(end_ns + 200 * MS + k * MS, number, sent_ns) for k, (_, number, sent_ns) in enumerate(heard)]
    assert {place for _, place in places(numbering, again)} == {LATE}
    assert numbering.newest == max(number for _, number, _ in heard)


FORGED = {
    "1000 ahead, stamped now": (1000, lambda now, sent: sent),
    "1000 ahead, with a stamp to fit": (1000, lambda now, sent: sent + 1000 * 5 * MS),
    "1000 ahead, stamped 0": (1000, lambda now, sent: 0),
    "1000 ahead, stamped at the end of time": (1000, lambda now, sent: 2**64 - 1),
    "as far as goes, a little early": (MOST_AT_ONCE, lambda now, sent: sent + 30 * MS),
    "beyond all": (2**63, lambda now, sent: sent),
    "the next, stamped far ahead": (1, lambda now, sent: sent + 10**12),
    "long ago, stamped now": (-500, lambda now, sent: sent + 1),
}


@pytest.mark.parametrize("copies", [1, 2, 5])
@pytest.mark.parametrize("what", FORGED)
@pytest.mark.parametrize(("period_ns", "words"), [(5 * MS, "delay 20ms 3ms"), (50 * MS, "delay 40ms 10ms loss 2%")])
def test_a_forger_in_the_peers_name_blinds_nobody_for_longer_than_02_s(
    period_ns: int, words: str, what: str, copies: int
) -> None:
    """`copies` of one forged run in a row; from then on a position counts again within 0.2 s, and all do after 2 s."""
    ahead, stamp = FORGED[what]
    numbering, heard = Numbering(), honest(1000, period_ns, words)
    for message in heard[:500]:
        numbering.place(*message)
    now_ns, number, sent_ns = heard[499][0], numbering.newest + ahead, stamp(0, heard[499][2])
    for k in range(copies):
        numbering.place(now_ns + k, number + k, min(2**64 - 1, sent_ns + k * MS))
    known = [at_ns for (at_ns, _, _), place in places(numbering, heard[500:]) if place in (NEW, AGAIN)]
    lost = 2 * period_ns  # of two that are needed one may be lost or late
    assert known[0] - now_ns <= 200 * MS + lost * ("loss" in words)
    late = [at_ns for at_ns in known if at_ns > now_ns + 2000 * MS]
    others = [at_ns for at_ns, _, _ in heard[500:] if at_ns > now_ns + 2000 * MS]
    assert len(late) > 0.8 * len(others)


@pytest.mark.parametrize(("period_ns", "within_ns"), [(5 * MS, 150 * MS), (30 * MS, 350 * MS)])
def test_a_forged_first_message_blinds_nobody_either(period_ns: int, within_ns: int) -> None:
    for number, sent_ns in ((2**64 - 1, 2**64 - 1), (1000, 10**15), (1000, 0), (0, 10**15)):
        numbering, heard = Numbering(), honest(500, period_ns, "delay 40ms 2ms")
        numbering.place(heard[0][0] - MS, number, sent_ns)
        known = [at_ns for (at_ns, _, _), place in places(numbering, heard) if place in (NEW, AGAIN)]
        assert known[0] <= heard[0][0] + within_ns
        assert len(known) >= 470


def test_a_sender_that_jumps_for_good_is_believed_with_its_second_message() -> None:
    numbering = Numbering()
    for message in honest(100, 5 * MS):
        numbering.place(*message)
    leap = [(CLOCK + 500 * MS + 5 * MS * k, 10**9 + k, 495 * MS + 5 * MS * k) for k in range(5)]
    found = [place for _, place in places(numbering, leap)]
    assert found == [DOUBTFUL] * (RUN - 1) + [AGAIN] + [NEW] * (5 - RUN)


def test_a_path_that_became_shorter_is_followed_at_once() -> None:
    """A second less of delay, and what was sent before still comes, late, between: nothing of that is taken for new."""
    numbering = Numbering()
    slow = [(CLOCK + 1000 * MS + 5 * MS * k, k, 5 * MS * k) for k in range(400)]
    fast = [(CLOCK + 10 * MS + 5 * MS * k + 1, k, 5 * MS * k) for k in range(400, 800)]
    news = [number for (_, number, _), place in places(numbering, sorted(slow + fast)) if place != LATE]
    switched = [number for number in news if number >= 400]
    assert switched == list(range(400, 800))
    assert [number for number in news if number < 400] == list(range(203))  # the first fast one came after 2.01 s


def test_the_run_that_was_displaced_takes_its_place_back() -> None:
    numbering = Numbering()
    for message in honest(100, 5 * MS):
        numbering.place(*message)
    at_ns = CLOCK + 500 * MS
    forged = [(at_ns + k, 10**6 + k, 10**15 + k) for k in range(3)]
    assert [place for _, place in places(numbering, forged)] == [DOUBTFUL, AGAIN, NEW]
    true = [(at_ns + 5 * MS * k, 100 + k, 500 * MS + 5 * MS * k) for k in range(1, 5)]
    assert [place for _, place in places(numbering, true)] == [LATE, AGAIN, NEW, NEW]


def test_numbers_and_stamps_rise_together_or_not_at_all() -> None:
    for number, sent_ns, place in (
        (101, 499 * MS, DOUBTFUL),
        (101, 500 * MS, NEW),  # two in one moment
        (100, 500 * MS, LATE),
        (100, 500 * MS + 1, DOUBTFUL),
        (99, 500 * MS, LATE),
        (99, 501 * MS, DOUBTFUL),
    ):
        numbering = Numbering()
        for message in honest(101, 5 * MS):
            numbering.place(*message)
        assert numbering.place(CLOCK + 505 * MS, number, sent_ns) is place


def test_numbers_may_rise_as_fast_as_any_servo_and_no_faster() -> None:
    for waited_ns, reach in ((0, 2000), (50_000, 2001), (99_999, 2001), (1000 * MS, 22_000)):
        for number, place in ((reach, NEW), (reach + 1, DOUBTFUL)):
            numbering = Numbering()
            numbering.place(0, 0, 0)
            assert numbering.place(waited_ns, number, waited_ns) is place


def test_noise_in_the_peers_name_never_stops_an_honest_sender_for_good() -> None:
    rng = random.Random(1)
    numbering, newest = Numbering(), -1
    for now_ns, number, sent_ns in honest(2000, 5 * MS, "delay 20ms 2ms"):
        if number > 50 and rng.random() < 0.2:
            numbering.place(now_ns, rng.getrandbits(rng.choice((8, 12, 64))), rng.getrandbits(rng.choice((32, 40, 64))))
        if numbering.place(now_ns, number, sent_ns) in (NEW, AGAIN):
            newest = number
        assert number - newest <= 100  # 0.5 s
