"""Actions that are due every few ticks of a servo."""

from __future__ import annotations

TICK_SLACK_S = 1e-9
"""A clock in whole nanoseconds may measure a period one nanosecond short [s]."""


def ticks_before(due: float, elapsed: float, dt: float) -> int:
    """How many ticks, `dt` seconds apart, come before the one in which `due` seconds have passed; `elapsed` have."""
    ticks, elapsed = 0, elapsed + dt
    while elapsed < due:
        ticks += 1
        elapsed += dt
    return ticks
