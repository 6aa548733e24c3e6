from __future__ import annotations

from typing import Any

import pytest

from hapnet.summary.verdict import judge


def said_of(servo: dict[str, Any], duration_s: float) -> list[str]:
    """What the verdict says of a run whose device had this servo."""
    return judge({"device": {"servo": servo}, "duration_s": duration_s})["reason"].split("; ")


def test_stalls_are_counted_with_all_time_without_force() -> None:
    servo = {"overruns": 402, "longest_ms": 22_000.0, "without_force_s": 42.031, "ticks": 552, "skipped": 41_500}
    said = said_of(servo, 42.18)
    assert "the servo stalled for longer than watchdog_s 402 times, for up to 22000 ms" in said
    assert "42 s without force in all" in said
    assert "the servo did not keep its rate: 13 of 997 ticks a second" in said


@pytest.mark.parametrize(("skipped", "slow"), [(0, False), (52, False), (53, True)])
def test_a_rate_is_kept_with_95_of_100_ticks(skipped: int, slow: bool) -> None:
    said = said_of({"ticks": 1000, "skipped": skipped}, 1.05)
    assert any("did not keep its rate" in line for line in said) == slow


def test_what_an_older_summary_does_not_have_is_not_said() -> None:
    said = said_of({"ticks": 1000, "overruns": 1, "longest_ms": 30.0}, 1.0)
    assert "the servo stalled for longer than watchdog_s 1 time, for up to 30 ms" in said
    assert not [line for line in said if "without force" in line or "rate" in line]
