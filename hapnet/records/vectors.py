"""Sums and distances of short vectors; n is the number of axes.

Equations add their terms with these functions, never with Python's `sum`: since Python 3.12 `sum` compensates its
rounding, so results would depend on Python's version.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from hapnet.records.record import FloatRows, Floats, Reals, compiled_as, equation


@equation
def dot(n: int, one: Reals, other: Reals) -> float:
    """The scalar product."""
    total = 0.0
    for i in range(n):
        total += one[i] * other[i]
    return total


def inner(one: Iterable[float], other: Iterable[float]) -> float:
    """The scalar product of two vectors, up to the length of the shorter vector."""
    total = 0.0
    for a, b in zip(one, other):  # noqa: B905  (as fast as can be)
        total += a * b
    return total


def added(terms: Iterable[float]) -> float:
    """The sum of `terms`, added one after the other; 0 if there are none."""
    total = 0.0
    for term in terms:
        total += term
    return total


def _length(n: int, one: Reals) -> float:
    if n == 1:
        return float(abs(one[0]))
    total = rest = 0.0
    for i in range(n):
        total, rest = _add_square(total, rest, one[i])
    return _root(total, rest)


@compiled_as(_length)
def length(n: int, one: Reals) -> float:
    """The Euclidean norm."""
    return abs(one[0]) if n == 1 else math.hypot(*one[:n])


def _distance(n: int, one: Reals, other: Reals) -> float:
    if n == 1:
        return float(abs(one[0] - other[0]))
    total = rest = 0.0
    for i in range(n):
        total, rest = _add_square(total, rest, one[i] - other[i])
    return _root(total, rest)


@compiled_as(_distance)
def distance(n: int, one: Reals, other: Reals) -> float:
    """The Euclidean distance."""
    return abs(one[0] - other[0]) if n == 1 else math.dist(one[:n], other[:n])


@equation
def _add_square(total: float, rest: float, x: float) -> tuple[float, float]:
    """Add the square of x to a sum in two floats, total + rest (Dekker, Numerische Mathematik 18, 1971)."""
    square, error = _square(x)
    after = total + square
    back = after - total
    return after, rest + (((total - (after - back)) + (square - back)) + error)


@equation
def _root(total: float, rest: float) -> float:
    """The square root of total + rest, with an error of one ulp in very rare cases, as in Python's own norms.

    A Newton step with the exact residual follows `math.sqrt`.
    """
    if total == 0.0:
        return 0.0
    root = math.sqrt(total)
    square, error = _square(root)
    return root + (((total - square) - error) + rest) / (2.0 * root)


@equation
def _square(x: float) -> tuple[float, float]:
    """The square of x, and its rounding error."""
    square = x * x
    part = 134217729.0 * x
    high = part - (part - x)
    low = x - high
    return square, ((high * high - square) + 2.0 * high * low) + low * low


@equation
def copy(n: int, source: Reals, target: Floats) -> None:
    """Copy a vector."""
    for i in range(n):
        target[i] = source[i]


@equation
def times(n: int, rows: FloatRows, vector: Reals, out: Floats) -> None:
    """A matrix times a vector, into `out`, which must not be `vector` itself."""
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += rows[i][j] * vector[j]
        out[i] = total


@equation
def equal(n: int, one: Reals, other: Reals) -> bool:
    """Whether all elements are equal."""
    same = True
    for i in range(n):
        same = same and bool(one[i] == other[i])
    return same
