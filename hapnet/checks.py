"""Checks of a user's values: each returns the checked value, or raises `InvalidParameter` with its name."""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import mul
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hapnet.errors import InvalidParameter

Vector = tuple[float, ...]
"""A point or a force, one float per axis. Hot loops use these: for one to six axes they are faster than arrays."""

Array = NDArray[np.float64]

Scalar = str | int | float | bool | None
Signal = Scalar | tuple[int | float, ...]
"""A value that two sides can send each other beside the stream."""

MAX_DOF = 64
"""The most axes: a message contains one number per axis, and a side refuses longer messages."""

MOST_PLANES, MOST_TOOL_PLANES = 4, 8
"""The most planes that a world sends for one place: a room's corner has three. A tool with six degrees of freedom needs
six to hold it."""

MOST_CURVATURES = 2
"""The most principal curvatures that are sent with a plane: a surface in three dimensions has two."""

MOST_CURVATURE_PER_M = 1e4
"""The largest curvature, of either sign: a radius of 0.1 mm."""

MOST_FRICTION = 10.0
"""The largest Coulomb coefficient that is sent with a plane; dry rubber has about 1."""

MOST_VISCOSITY, MOST_SNAP_N, MOST_SNAP_M, MOST_HEIGHT_M, MOST_WAVES_PER_M = 1e3, 100.0, 0.1, 0.1, 1e5
"""Limits of a surface's effects."""

GRAIN_FULL, MOST_GRAIN = 127, 256
"""A grain's highest sample as a byte; the most samples of a grain."""

UNIT_TOLERANCE = 1e-6
"""The largest error of a unit normal's squared length, and the largest cosine between perpendicular directions."""


def positive(name: str, value: float) -> float:
    """`value` if it is a finite number above zero."""
    if not (_is_number(value) and math.isfinite(value) and value > 0.0):
        raise InvalidParameter(name, value, "a finite number above 0")
    return float(value)


def non_negative(name: str, value: float) -> float:
    """`value` if it is a finite number, zero or above."""
    if not (_is_number(value) and math.isfinite(value) and value >= 0.0):
        raise InvalidParameter(name, value, "a finite number, 0 or above")
    return float(value)


def whole(name: str, value: int, *, at_least: int) -> int:
    """`value` if it is a whole number, `at_least` or above."""
    if not _is_number(value) or value != int(value) or value < at_least:
        raise InvalidParameter(name, value, f"a whole number, {at_least} or above")
    return int(value)


def one_of(name: str, value: str, allowed: Sequence[str]) -> str:
    """`value` if it is one of the `allowed` texts."""
    if value not in allowed:
        raise InvalidParameter(name, value, "one of " + ", ".join(allowed), allowed)
    return value


def vector(name: str, value: ArrayLike, n: int | None = None) -> Vector:
    """`value` as `n` finite floats (if `n` is None: one or more)."""
    try:
        array = np.atleast_1d(np.asarray(value, dtype=np.float64))
    except (TypeError, ValueError):
        raise InvalidParameter(name, value, "a list of finite numbers") from None
    if array.ndim != 1 or (n is not None and array.size != n) or array.size == 0:
        raise InvalidParameter(name, value, f"{'some' if n is None else n} finite numbers, one per axis")
    if not np.all(np.isfinite(array)):
        raise InvalidParameter(name, value, "finite numbers")
    return tuple(array.tolist())


def diagonal(name: str, value: ArrayLike, n: int, *, zero_allowed: bool = False) -> Vector:
    """The diagonal of a positive diagonal n x n matrix, given as a scalar, a vector or the matrix."""
    matrix = _square(name, value, n)
    entries = np.diagonal(matrix)
    words = f"a {'non-negative' if zero_allowed else 'positive'} number, {n} of them, or a diagonal matrix of them"
    if np.any(matrix != np.diag(entries)) or np.any(entries < 0.0) or (not zero_allowed and np.any(entries <= 0.0)):
        raise InvalidParameter(name, value, words)
    return tuple(entries.tolist())


def spd(name: str, value: ArrayLike, n: int) -> Array:
    """A symmetric positive definite n x n matrix, given as a scalar, a vector (its diagonal) or the matrix."""
    matrix = _square(name, value, n)
    if not np.allclose(matrix, matrix.T, rtol=1e-12, atol=0.0):
        raise InvalidParameter(name, value, "a symmetric positive definite matrix (this one is not symmetric)")
    matrix = (matrix + matrix.T) / 2.0
    eigenvalues = np.linalg.eigvalsh(matrix)
    if not eigenvalues[0] > 1e-12 * eigenvalues[-1]:  # with less, v' M v could round to a negative number
        raise InvalidParameter(
            name, value, f"a symmetric positive definite matrix (this one has the eigenvalue {eigenvalues[0]:.3g})"
        )
    return matrix


def _square(name: str, value: ArrayLike, n: int) -> Array:
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidParameter(name, value, f"a number, {n} numbers or a {n} x {n} matrix") from None
    if not np.all(np.isfinite(array)):
        raise InvalidParameter(name, value, "finite numbers")
    if array.ndim == 0:
        return np.eye(n) * array
    if array.shape == (n,):
        return np.diag(array)
    if array.shape == (n, n):
        return array
    raise InvalidParameter(name, value, f"a number, {n} numbers or a {n} x {n} matrix")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def wrong_curvatures(curvatures: Sequence[tuple[Sequence[float], float]], normal: Sequence[float]) -> str | None:
    """Describe the fault in a surface's curvatures, (direction, curvature [1/m]), with this normal; None: no fault."""
    if len(curvatures) > MOST_CURVATURES:
        return f"{len(curvatures)} curvatures; allowed: up to {MOST_CURVATURES}"
    directions = [tuple(normal)]
    for direction, per_m in curvatures:
        if len(direction) != len(normal):
            return f"a curvature's direction with {len(direction)} components; allowed: {len(normal)}"
        square = sum(map(mul, direction, direction))
        leans = [abs(sum(map(mul, direction, other))) for other in directions]
        if not (abs(square - 1.0) <= UNIT_TOLERANCE and all(lean <= UNIT_TOLERANCE for lean in leans)):  # NaN as well
            return f"a curvature's direction {tuple(direction)}; allowed: a unit vector perpendicular to the others"
        if not abs(per_m) <= MOST_CURVATURE_PER_M:
            return f"a curvature of {per_m} per m; allowed: finite, within +-{MOST_CURVATURE_PER_M:g}"
        directions.append(tuple(direction))
    return None


def wrong_effects(effects: Sequence[Any], dof: int) -> str:
    """Describe the fault in the effects of a surface with `dof` axes; empty: no fault.

    effects : viscosity, sticking, a snap's force and reach, and a grain (None: no grain).
    """
    *numbers, grain = effects
    most = (MOST_VISCOSITY, MOST_FRICTION, MOST_SNAP_N, MOST_SNAP_M)
    names = ("viscosity", "sticking", "snap's force", "snap's reach")
    for name, number, limit in zip(names, numbers, most, strict=True):
        if not 0.0 <= number <= limit:  # false for NaN as well
            return f"a {name} of {number}; allowed: 0 to {limit:g}"
    if grain is None:
        return ""
    wave, height, shape = grain
    if len(wave) != dof:
        return f"a grain's wave of {len(wave)} numbers; allowed: {dof}"
    if not all(abs(part) <= MOST_WAVES_PER_M for part in wave):
        return f"a grain's wave {wave}; allowed: {dof} numbers within +-{MOST_WAVES_PER_M:g} 1/m"
    if not 0.0 <= height <= MOST_HEIGHT_M:
        return f"a grain's height of {height} m; allowed: 0 to {MOST_HEIGHT_M:g}"
    if not 2 <= len(shape) <= MOST_GRAIN:
        return f"a grain of {len(shape)} samples; allowed: 2 to {MOST_GRAIN}"
    return ""
