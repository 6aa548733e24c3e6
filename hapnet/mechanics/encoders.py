"""The rounding of positions to whole encoder counts."""

from __future__ import annotations

import math


def rounding(resolution: float, axes: int) -> float:
    """The largest excess of a measured travel over the true travel [m]; each axis is rounded to counts [m].

    Both ends of the travel are off by at most half a count per axis, so the travel by a count times sqrt(axes).
    """
    return resolution * math.sqrt(axes)
