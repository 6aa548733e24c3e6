"""The coupling spring, which saturates through its potential.

With an actuator that saturates, the spring is not the linear spring of (2). So the potential itself contains the limit
(footnote 1 of the paper allows nonlinear springs): with ``s = |e|_K``, ``e = x - ybar``,

    h(s) = s^2 / 2             up to s0 = F_max / sqrt(lambda_max(K))
    h(s) = s0 s - s0^2 / 2     beyond,            force  -h'(s)/s  K e,  never longer than F_max

Its level sets are those of the linear spring, so PSPM's projection stays a projection on an ellipsoid.
"""

from __future__ import annotations

import math
from copy import copy
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from hapnet import checks
from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.mechanics.ellipsoid import Ellipsoid, project, square
from hapnet.records.record import Floats, MatrixOfAxes, OfAxes, Reals, Record, equation


class Spring(Record):
    """Spring with potential ``phi(e) = h(|e|_K)``.

    Parameters
    ----------
    stiffness : K, symmetric positive definite, [N/m]: a scalar, the n diagonal entries, or (n, n).
    dof : n, the number of axes.
    force_limit : F_max [N], the largest force (Euclidean norm) the spring may give; None: never saturates.

    Attributes
    ----------
    rows : K. ellipsoid : K's norm. knee : s0. u : temporary memory for an offset, used by functions of this module.

    Raises InvalidParameter: K is not symmetric positive definite, or has another dimension.
    """

    dof: int
    rows: MatrixOfAxes
    knee: float
    knee_square: float
    ellipsoid: Ellipsoid
    u: OfAxes

    def __init__(self, stiffness: ArrayLike, dof: int, force_limit: float | None = None) -> None:
        self.K = checks.spd("stiffness", stiffness, dof)
        self.force_limit: float | None = None if force_limit is None else checks.positive("force_limit", force_limit)
        self.dof, self.rows, self.u = dof, self.K.tolist(), [0.0] * dof
        self.ellipsoid = Ellipsoid(self.K)
        self.knee = math.inf if self.force_limit is None else self.force_limit / math.sqrt(self.ellipsoid.largest)
        self.knee_square = self.knee * self.knee

    def potential(self, e: Vector) -> float:
        """phi [J] at the offset ``e = x - ybar`` [m]."""
        return of_square(self, square(self.ellipsoid, e))

    def between(self, ybar: Vector, x: Vector) -> float:
        """phi [J] of the spring that ties x to ybar [m]."""
        return between(self, ybar, x)

    def force(self, ybar: Vector, x: Vector) -> Vector:
        """The force [N] on the device at x, from the spring that ties it to ybar."""
        out = [0.0] * self.dof
        force(self, x, ybar, out)
        return tuple(out)

    def saturation(self, e: Vector) -> float:
        """The spring's force at the offset e [m] as a share of the linear spring's, ``-K e``: 1 up to the limit."""
        return saturation(self, e)

    def nearest(self, e: Vector, energy: float) -> Vector:
        """The offset with ``phi <= energy`` [J] nearest to `e`; the bound holds in floating point."""
        p = list(e)
        nearest(self, p, energy)
        return tuple(p)

    def curvature_bound(self) -> float:
        """Sum of |K_ij| [N/m]: it bounds the error of phi if the offset is wrong by half a count per axis."""
        return float(np.abs(self.K).sum())


@equation
def of_square(spring: Spring, s2: float) -> float:
    """phi [J], given ``s^2 = |e|_K^2``."""
    if s2 <= spring.knee_square:
        return 0.5 * s2
    return spring.knee * math.sqrt(s2) - 0.5 * spring.knee_square


@equation
def between(spring: Spring, ybar: Reals, x: Reals) -> float:
    """phi [J] of the spring that ties x to ybar."""
    if spring.dof == 1:
        e = x[0] - ybar[0]
        s2 = spring.ellipsoid.largest * e * e
        return 0.5 * s2 if s2 <= spring.knee_square else of_square(spring, s2)
    for i in range(spring.dof):
        spring.u[i] = x[i] - ybar[i]
    return of_square(spring, square(spring.ellipsoid, spring.u))


@equation
def force(spring: Spring, x: Reals, ybar: Reals, out: Floats) -> None:
    """The spring's force on the device [N]."""
    n, e = spring.dof, spring.u
    for i in range(n):
        e[i] = x[i] - ybar[i]
    scale = -1.0
    s2 = square(spring.ellipsoid, e)
    if s2 > spring.knee_square:
        scale = -spring.knee / math.sqrt(s2)
    if n == 1:
        out[0] = scale * spring.rows[0][0] * e[0]
        return
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += spring.rows[i][j] * e[j]
        out[i] = scale * total


@equation
def saturation(spring: Spring, e: Reals) -> float:
    """The spring's force at the offset e [m] as a share of the linear spring's."""
    s2 = square(spring.ellipsoid, e)
    return 1.0 if s2 <= spring.knee_square else spring.knee / math.sqrt(s2)


@equation
def nearest(spring: Spring, e: Floats, energy: float) -> None:
    """Replace e by the nearest offset with ``phi <= energy`` [J]."""
    if energy <= 0.0:
        for i in range(spring.dof):
            e[i] = 0.0
        return
    knee = spring.knee
    radius = math.sqrt(2.0 * energy) if energy <= 0.5 * knee * knee else energy / knee + 0.5 * knee
    s2 = project(spring.ellipsoid, e, radius)
    excess = 2.0**-52
    while of_square(spring, s2) > energy:  # the square roots may have rounded up
        s2 = project(spring.ellipsoid, e, radius * (1.0 - excess))
        excess *= 2.0


def shared_spring(stiffness: ArrayLike, dof: int, force_limit: float | None = None) -> Spring:
    """The `Spring` of these values; equal values are factored only once. Raises InvalidParameter."""
    try:
        K = np.asarray(stiffness, dtype=np.float64)
        known = _made(K.tobytes(), K.shape, dof, force_limit)
    except (InvalidParameter, TypeError, ValueError):
        return Spring(stiffness, dof, force_limit)  # raises with the original values in the message
    spring, ellipsoid = copy(known), copy(known.ellipsoid)  # with temporary memory of its own, for its thread
    spring.u, spring.ellipsoid = [0.0] * dof, ellipsoid
    ellipsoid.u, ellipsoid.p = [0.0] * dof, [0.0] * dof
    return spring


@lru_cache
def _made(stiffness: bytes, shape: tuple[int, ...], dof: int, force_limit: float | None) -> Spring:
    return Spring(np.frombuffer(stiffness).reshape(shape), dof, force_limit)
