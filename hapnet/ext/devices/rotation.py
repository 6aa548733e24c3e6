"""Rotations: from a matrix to the quaternion that goes to the world."""

from __future__ import annotations

import math
from collections.abc import Sequence

from hapnet.checks import Vector


def quaternion(rows: Sequence[Sequence[float]]) -> Vector:
    """The unit quaternion w, x, y, z of a rotation matrix: the largest component first, so that nothing cancels."""
    (a, b, c), (d, e, f), (g, h, i) = rows
    squares = (1.0 + a + e + i, 1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i)
    table = (
        (squares[0], h - f, c - g, d - b),
        (h - f, squares[1], b + d, c + g),
        (c - g, b + d, squares[2], f + h),
        (d - b, c + g, f + h, squares[3]),
    )
    row = table[max(range(4), key=squares.__getitem__)]
    length = math.hypot(*row)
    return tuple([part / length for part in row])
