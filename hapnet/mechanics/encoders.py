"""The resolution of encoders, whose counts are whole numbers."""

from __future__ import annotations

import math


def rounding(resolution: float, axes: int) -> float:
    """How much longer than the true travel a measured one can be [m], each axis rounded to counts of `resolution` [m].

    Both ends of the travel are off by at most half a count an axis, so all axes together by a count times sqrt(axes).
    """
    return resolution * math.sqrt(axes)
