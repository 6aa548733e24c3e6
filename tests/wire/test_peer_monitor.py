"""The time and the numbers of what is heard, against a plain recount of the whole history."""

import random

import pytest

from hapnet.wire.events import PeerHeard
from hapnet.wire.peer_monitor import Outages, PeerMonitor

MS = 1_000_000
SILENCE = 100 * MS


def recount(history: list[tuple[int, int | None]], now: int) -> Outages:
    """From (time, number, None for another word) of one pair that began at time 0."""
    heard = [(0, -1)]
    received = missing = 0
    silences, recoveries = [], [0]
    for k, (t, number) in enumerate(history):
        last_t, newest = heard[-1]
        if number is None or number <= newest:
            continue
        received += 1
        missing += number - newest - 1 if len(heard) > 1 else 0
        if t - last_t > SILENCE:
            words = [w for w, _ in history[: k + 1] if w > last_t + SILENCE]
            silences.append(t - last_t)
            recoveries.append(t - words[0])
        heard.append((t, number))
    if now - heard[-1][0] > SILENCE:
        silences.append(now - heard[-1][0])
    return Outages(len(silences), max(silences, default=0), sum(silences), max(recoveries), received, missing)


@pytest.mark.parametrize("seed", range(50))
def test_the_account_is_that_of_a_recount(seed: int) -> None:
    rng = random.Random(seed)
    live = PeerMonitor(SILENCE, SILENCE)
    live.begin(0)
    history: list[tuple[int, int | None]] = []
    now = number = 0
    newest, last = -1, 0
    for _ in range(200):
        now += rng.choice([1, 10, 99, 100, 101, 150, 400]) * MS
        number += rng.choice([0, 1, 1, 1, 3, -2])
        position = rng.random() < 0.7
        history.append((now, number if position else None))
        living = live.living(now)
        assert living == (now - last <= SILENCE)
        if position and number > newest:
            since = number - newest if newest >= 0 else 1
            newest, last = number, now
            heard = live.on_position(now, since)
            assert (heard is None) == living
        else:
            live.on_any_message(now)
    end = now + rng.choice([0, 50, 300]) * MS
    assert live.outages(end) == recount(history, end)


def test_a_silence_that_a_restart_ends_lasts_until_the_first_position() -> None:
    live = PeerMonitor(SILENCE, SILENCE)
    assert not live.living(0)
    assert live.watch(10**12) is None  # nobody was there yet
    live.begin(0)
    live.on_position(10 * MS, 1)
    live.begin(1000 * MS)  # a process in its place
    assert live.living(1050 * MS)
    assert live.watch(1050 * MS) is not None
    assert live.on_position(1080 * MS, 1) == PeerHeard(1070 * MS, 80 * MS, missing=0)
    assert live.outages(1080 * MS) == Outages(1, 1070 * MS, 1070 * MS, 80 * MS, received=2, missing=0)


def test_a_silence_begins_after_its_time_and_not_at_it() -> None:
    """Exactly as long as is allowed is no silence, one nanosecond more is: for all that is reported of it."""
    for wait_ns, silent in ((SILENCE, False), (SILENCE + 1, True)):
        live = PeerMonitor(SILENCE, SILENCE)
        live.begin(0)
        assert live.living(wait_ns) is not silent
        assert (live.watch(wait_ns) is not None) is silent
        assert live.watch(wait_ns) is None, "reported once"
        assert live.outages(wait_ns).count == silent
        assert live.outages(wait_ns).max_ns == (wait_ns if silent else 0)
        heard = live.on_position(wait_ns, 1)
        assert heard == (PeerHeard(wait_ns, 0, 0) if silent else None)
        assert live.outages(wait_ns).count == silent


def test_the_first_word_after_a_silence_is_counted_from_once_it_is_one() -> None:
    live = PeerMonitor(SILENCE, SILENCE)
    live.begin(0)
    live.on_any_message(SILENCE)  # not silent yet: no word that ends a silence
    live.on_any_message(SILENCE + 5 * MS)
    live.on_any_message(SILENCE + 9 * MS)
    assert live.on_position(SILENCE + 10 * MS, 1) == PeerHeard(SILENCE + 10 * MS, 5 * MS, 0)


def test_what_another_run_of_numbers_takes_back_was_not_missing() -> None:
    live = PeerMonitor(SILENCE, SILENCE)
    live.begin(0)
    for since, missing in ((1, 0), (1000, 999), (-997, 2), (1, 2), (-5, 0)):
        live.on_position(MS, since)
        assert live.outages(MS).missing == missing


def test_a_silence_after_this_side_began_to_end_is_no_outage() -> None:
    """Both sides are ended together: the other one sends nothing more. One that was silent before still is."""
    for silent_since, outages in ((0, 1), (SILENCE, 0)):
        live = PeerMonitor(SILENCE, SILENCE)
        live.begin(0)
        live.on_position(silent_since, 1)
        live.leave(SILENCE + 1)
        account = live.outages(10 * SILENCE)
        assert account.count == outages
        assert account.total_ns == outages * (SILENCE + 1)
