"""Skipped deadlines are judged beside the bare loop's, and a rate that is not kept is named."""

from __future__ import annotations

import pytest

from hapnet.ext.bench import servo
from hapnet.ext.bench.row import Row


def row_of(skipped: int, bare_skipped: int) -> Row:
    """A row of a servo and a bare loop at 5 kHz, each with 1,000 deadlines of which it skipped so many."""
    ours, theirs = (
        servo.Lateness(((5, 1000 - n), (300_000, n)), n, period_ns=200_000) for n in (skipped, bare_skipped)
    )
    return servo.late_row("servo_traffic_5khz", "", [ours], "", [theirs])


@pytest.mark.parametrize(("skipped", "bare", "met", "kept"), [
    (505, 82, False, "did not keep its rate: 2475 of 5000 Hz, the bare loop 4590 Hz"),
    (38, 5, False, ""),
    (505, 500, True, "did not keep its rate: 2475 of 5000 Hz, the bare loop 2500 Hz"),
    (9, 0, True, ""),
])  # fmt: skip
def test_skipped_deadlines_are_judged_beside_the_bare_loops(skipped: int, bare: int, met: bool, kept: str) -> None:
    row = row_of(skipped, bare)
    assert [(limit.figure, one) for limit, one in row.verdicts()] == [("skipped_excess", met)]
    assert row.note == kept
