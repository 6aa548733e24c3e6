from __future__ import annotations

import itertools
from collections.abc import Iterable

import pytest

from hapnet.recording.samples import Event
from hapnet.side.punctuality import Punctuality

MS = 1_000_000
SECOND = 1000 * MS


def seen(steps_ms: Iterable[float], *, watchdog_ms: int | None = 20) -> tuple[Punctuality, list[Event]]:
    """A servo of 1 kHz whose ticks come so long after one another, and what was reported."""
    punctuality = Punctuality(MS, None if watchdog_ms is None else watchdog_ms * MS)
    now_ns, events = 0, list[Event]()
    for step_ms in steps_ms:
        since_ns = round(step_ms * MS)
        now_ns += since_ns
        events += punctuality.see(now_ns, since_ns, released=punctuality.is_late(since_ns))
    return punctuality, events


def stalls(events: list[Event]) -> list[Event]:
    return [event for event in events if event.kind == "overrun"]


def test_each_late_tick_of_a_row_counts_and_so_does_all_its_time() -> None:
    """30 ms, 22 s and 400 times 50 ms: 42.03 s, and 1 ms more until the force is back."""
    punctuality, _ = seen([*[1.0] * 100, 30.0, 22_000.0, *[50.0] * 400, *[1.0] * 50])
    assert punctuality.late == 402
    assert punctuality.max_ns == 22 * SECOND
    assert punctuality.without_force_ns == (30 + 22_000 + 400 * 50 + 1) * MS


def test_a_stall_that_goes_on_is_reported_every_second_with_its_whole_time() -> None:
    _, events = seen([1.0, *[50.0] * 200, *[1.0] * 5])
    told = stalls(events)
    assert told[0].text == "the servo stalled for 50.0 ms (machine too busy): no force until it is on time again"
    late = "the servo stalled for 1.05 s, late at each of 21 ticks "
    assert told[1].text == f"{late}(machine too busy): no force until it is on time again"
    assert told[-1].text.startswith("the servo stalled for 10 s, late at each of 200 ticks")
    gaps = [(b.time_ns - a.time_ns) / SECOND for a, b in itertools.pairwise(told)]
    assert max(gaps) <= 1.05
    assert len(told) == 11


def test_the_end_of_a_row_is_reported_if_its_last_ticks_were_not() -> None:
    _, events = seen([1.0, 30.0, 30.0, 30.0, 1.0, 1.0])
    assert [event.text for event in stalls(events)] == [
        "the servo stalled for 30.0 ms (machine too busy): no force until it is on time again",
        "the servo stalled for 0.09 s, late at each of 3 ticks (machine too busy): no force until it is on time again",
    ]


def test_a_later_stall_says_how_many_there_were() -> None:
    _, events = seen([1.0, 30.0, 1.0, 40.0, 1.0])
    assert stalls(events)[-1].text == (
        "the servo stalled for 40.0 ms (machine too busy): no force until it is on time again "
        "(2 late ticks so far, 0.071 s without force)"
    )


@pytest.mark.parametrize(("step_ms", "late"), [(21.0, 0), (21.000001, 1)])
def test_a_tick_is_late_beyond_the_watchdog_only(step_ms: float, late: int) -> None:
    assert seen([1.0, step_ms, 1.0])[0].late == late
    assert seen([1.0, step_ms, 1.0], watchdog_ms=None)[0].late == 0


def test_a_tick_after_a_silence_of_the_device_is_no_stall_but_its_time_has_no_force() -> None:
    punctuality = Punctuality(MS, 20 * MS)
    assert not stalls(list(punctuality.see(4 * SECOND, 4 * SECOND, released=True, excused=True)))
    assert (punctuality.late, punctuality.without_force_ns) == (0, 4 * SECOND)


def test_a_withheld_force_counts_until_the_next_tick_with_one() -> None:
    punctuality = Punctuality(MS, 20 * MS)
    for k, released in enumerate([False, True, True, False, False], 1):
        punctuality.see(k * MS, MS, released=released)
    assert punctuality.without_force_ns == 2 * MS


def test_a_rate_that_is_not_kept_is_reported_with_the_one_that_is() -> None:
    """For 30 s every third deadline is met, then all are: reported once, not again while it stays, and at its end."""
    _, events = seen([*[3.0] * 10_000, *[1.0] * 30_000])
    told = [event for event in events if event.kind == "rate"]
    assert [event.level for event in told] == ["warning", "info"]
    assert told[0].text == "the servo made 333 of 1000 ticks a second over the last 10 s"
    assert told[1].text == "the servo made 1000 of 1000 ticks a second over the last 10 s"
    assert told[0].time_ns == pytest.approx(10 * SECOND, rel=1e-3)


def test_a_rate_that_stays_too_low_is_reported_again_every_minute() -> None:
    _, events = seen([2.0] * 100_000)  # 200 s
    told = [event.time_ns / SECOND for event in events if event.kind == "rate"]
    assert told == pytest.approx([10.0, 70.0, 130.0, 190.0], abs=0.1)


def test_ticks_made_elsewhere_keep_the_rate() -> None:
    punctuality = Punctuality(MS, 20 * MS)
    events = list[Event]()
    for second in range(40):
        punctuality.made(999)
        events += punctuality.see(second * SECOND, MS, released=False)
    assert not events
