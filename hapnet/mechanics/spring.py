"""The coupling spring, saturated through its potential.

An actuator at its limit is not the linear spring of (2). So the limit is put into the potential itself (footnote 1 of
the paper allows nonlinear springs): with ``s = |e|_K``, ``e = x - ybar``,

    h(s) = s^2 / 2             up to s0 = F_max / sqrt(lambda_max(K))
    h(s) = s0 s - s0^2 / 2     beyond,            force  -h'(s)/s  K e,  never longer than F_max

Its level sets are those of the linear spring, so PSPM's projection stays a projection on an ellipsoid.
"""

from __future__ import annotations

import math
from functools import lru_cache
from operator import mul, sub

import numpy as np
from numpy.typing import ArrayLike

from hapnet import checks
from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.mechanics.ellipsoid import Ellipsoid


class Spring:
    """Spring with potential ``phi(e) = h(|e|_K)``.

    Parameters
    ----------
    stiffness : K, symmetric positive definite, [N/m]: a scalar, the n diagonal entries, or (n, n).
    dof : n, the number of axes.
    force_limit : F_max [N], the longest force (Euclidean norm) the spring may give; None: never saturates.

    Raises
    ------
    InvalidParameter : K is not symmetric positive definite, or has another dimension.
    """

    __slots__ = ("K", "_K11", "_knee_square", "_rows", "dof", "ellipsoid", "force_limit", "knee")

    def __init__(self, stiffness: ArrayLike, dof: int, force_limit: float | None = None) -> None:
        self.K = checks.spd("stiffness", stiffness, dof)
        self.dof: int = dof
        self.ellipsoid: Ellipsoid = Ellipsoid(self.K)
        self._K11 = float(self.K[0, 0])
        self._rows: tuple[Vector, ...] = tuple(tuple(row) for row in self.K.tolist())
        self.force_limit: float | None = None if force_limit is None else checks.positive("force_limit", force_limit)
        self.knee: float = (
            math.inf if self.force_limit is None else self.force_limit / math.sqrt(self.ellipsoid.largest)
        )
        self._knee_square = self.knee * self.knee

    def potential(self, e: Vector) -> float:
        """phi [J] at the offset ``e = x - ybar`` [m]."""
        return self._of_square(self._K11 * e[0] * e[0] if self.dof == 1 else self.ellipsoid.square(e))

    def between(self, ybar: Vector, x: Vector) -> float:
        """phi [J] of the spring that ties x to ybar [m]."""
        if self.dof == 1:
            e = x[0] - ybar[0]
            square = self._K11 * e * e
        else:
            square = self.ellipsoid.square(tuple(map(sub, x, ybar)))
        return 0.5 * square if square <= self._knee_square else self._of_square(square)

    def _of_square(self, square: float) -> float:
        """h(s), given s^2."""
        if square <= self._knee_square:
            return 0.5 * square
        return self.knee * math.sqrt(square) - 0.5 * self._knee_square

    def force(self, ybar: Vector, x: Vector) -> Vector:
        """The force on the device at x of the spring that ties it to ybar [N]."""
        scale = -1.0
        if self.dof == 1:
            e, K = x[0] - ybar[0], self._K11
            if (square := K * e * e) > self._knee_square:
                scale = -self.knee / math.sqrt(square)
            return (scale * K * e,)
        offset = tuple(map(sub, x, ybar))
        if (square := self.ellipsoid.square(offset)) > self._knee_square:
            scale = -self.knee / math.sqrt(square)
        return tuple([scale * sum(map(mul, row, offset)) for row in self._rows])

    def saturation(self, e: Vector) -> float:
        """The share of the linear spring's force ``-K e`` that it gives at the offset e [m]: 1 up to the limit."""
        square = self.ellipsoid.square(e)
        return 1.0 if square <= self._knee_square else self.knee / math.sqrt(square)

    def nearest(self, e: Vector, energy: float) -> Vector:
        """The offset with ``phi <= energy`` [J] nearest to `e`; the bound holds in floating point."""
        if energy <= 0.0:
            return (0.0,) * self.dof
        knee = self.knee
        radius = math.sqrt(2.0 * energy) if energy <= 0.5 * knee * knee else energy / knee + 0.5 * knee
        p, square = self.ellipsoid.project_measured(e, radius)
        excess: float = 2.0**-52
        while self._of_square(square) > energy:  # the square roots may have rounded up
            p, square = self.ellipsoid.project_measured(p, radius * (1.0 - excess))
            excess *= 2.0
        return p

    def curvature_bound(self) -> float:
        """Sum of |K_ij| [N/m]: bounds how far phi can be off for an offset wrong by half a count an axis."""
        return float(np.abs(self.K).sum())


def shared_spring(stiffness: ArrayLike, dof: int, force_limit: float | None = None) -> Spring:
    """The `Spring` of these values, made once for all who ask for it: it has no state. Raises InvalidParameter."""
    try:
        K = np.asarray(stiffness, dtype=np.float64)
        return _made(K.tobytes(), K.shape, dof, force_limit)
    except (InvalidParameter, TypeError, ValueError):
        return Spring(stiffness, dof, force_limit)  # which says what is wrong with the values as they were given


@lru_cache
def _made(stiffness: bytes, shape: tuple[int, ...], dof: int, force_limit: float | None) -> Spring:
    return Spring(np.frombuffer(stiffness).reshape(shape), dof, force_limit)
