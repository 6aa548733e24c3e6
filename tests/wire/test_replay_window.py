"""The once-only window, against a plain set that forgets nothing."""

import random

import pytest
from hypothesis import given, settings, strategies as st

from hapnet.wire.numbering import LATE, SEEN
from hapnet.wire.replay_window import WINDOW, ReplayWindow, stale_detail


def answers(numbers: list[int]) -> list[bool]:
    seen = ReplayWindow()
    return [seen.accept(number) for number in numbers]


def by_a_set(numbers: list[int]) -> list[bool]:
    """The same from what it means: seen is what came before, or lies `WINDOW` or more behind the newest."""
    came: set[int] = set()
    first = []
    for number in numbers:
        first.append(number not in came and number > max(came, default=-1) - WINDOW)
        came.add(number)
    return first


near = st.integers(0, 3 * WINDOW)
far = st.integers(0, 2**64 - 1)
around_the_edge = st.builds(lambda base, offset: max(0, base + offset), st.just(5000), st.integers(-1030, 1030))


@settings(deadline=None)
@given(st.lists(near | far | around_the_edge, max_size=80))
@pytest.mark.long
def test_a_number_is_new_once_as_a_set_says(numbers: list[int]) -> None:
    assert answers(numbers) == by_a_set(numbers)


@pytest.mark.long
def test_a_jittered_repeated_stream_is_taken_once_each() -> None:
    """Reordered by less than the window and each twice: all numbers come through, once."""
    rng = random.Random(1)
    sent = [number for number in range(5000) for _ in range(2)]
    order = sorted(sent, key=lambda number: number + rng.uniform(0.0, WINDOW - 1))
    seen = ReplayWindow()
    taken = [number for number in order if seen.accept(number)]
    assert sorted(taken) == list(range(5000))
    assert answers(order) == by_a_set(order)


def test_the_window_ends_where_it_says() -> None:
    assert answers([WINDOW, 1, 1, 0]) == [True, True, False, False]
    assert answers([WINDOW - 1, 0]) == [True, True]


def test_what_it_remembers_is_bounded() -> None:
    seen = ReplayWindow()
    for number in (0, 1, 2**64 - 1, 2**64 - WINDOW, 5):
        seen.accept(number)
    assert len(seen.seen) == WINDOW


def test_from_another_run_far_behind_numbers_are_seen_anew() -> None:
    """What is within the window stays known: a number that was used is not used again."""
    for behind, known in ((WINDOW - 1, True), (WINDOW, False)):
        seen = ReplayWindow()
        newest = 5000
        assert seen.accept(newest)
        assert seen.accept(newest - 10)
        seen.restart(newest - behind)
        assert seen.accept(newest - behind)
        assert not seen.accept(newest - behind)
        assert seen.accept(newest - behind + 1)
        assert seen.accept(newest - behind - 1) is False  # behind the window, or before the run
        assert seen.accept(newest - 10) is not known


def test_why_a_message_is_stale() -> None:
    assert stale_detail("position", 7, LATE) == "position 7 comes after a later one"
    assert stale_detail("wave", 7, SEEN) == "wave 7 came before, or comes long after later ones"
