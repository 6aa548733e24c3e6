"""Euclidean projection on an ellipsoid: the whole difficulty of PSPM's optimisation (8)-(9).

With R the energy at hand, (9) says that the modulated set-position lies in ``1/2 |ybar - x|_K^2 <= R``; (8) asks for
the point of that ellipsoid nearest to y. In K's eigenbasis, with u the offset of y from the centre, the answer is
``u_i / (1 + mu lambda_i)`` with the multiplier mu >= 0 solving one scalar (secular) equation. For K = kappa I it is a
radial scaling.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import mul

import numpy as np

from hapnet.checks import Array, Vector

_MOST_ITERATIONS = 60  # Newton needs 3 to 8; the bound only makes the loop finite
_INSIDE = 1.0 - 2.0**-50  # of the radius: what rounding adds then leaves the point inside at the first try
_VANISHING = 1e-280  # squared radius below which products underflow; the ball is a point


class Ellipsoid:
    """The norm ``|e|_K`` of a symmetric positive definite K, and projections on its balls.

    Parameters
    ----------
    K : (n, n) symmetric positive definite matrix (checked by the caller).

    Factored once; each call then costs a few microseconds on plain floats.
    """

    __slots__ = ("_columns", "_modes", "_ratios", "_rows", "_weights", "eigenvalues", "isotropic", "largest", "n")

    def __init__(self, K: Array) -> None:
        self.n: int = K.shape[0]
        self._rows: tuple[Vector, ...] | None = None
        self._columns: tuple[Vector, ...] | None = None
        if np.array_equal(K, np.diag(np.diagonal(K))):
            eigenvalues = np.diagonal(K)
        else:
            eigenvalues, basis = np.linalg.eigh(K)
            self._rows = tuple(tuple(row) for row in basis.tolist())
            self._columns = tuple(tuple(row) for row in basis.T.tolist())
        self.eigenvalues: Vector = tuple(eigenvalues.tolist())
        self.largest: float = max(self.eigenvalues)
        self.isotropic: bool = min(self.eigenvalues) == self.largest
        self._modes = tuple(zip(self.eigenvalues, self._columns or (), strict=False))
        self._ratios = tuple(self.largest / value for value in self.eigenvalues)
        self._weights = tuple(
            value * ratio * ratio for value, ratio in zip(self.eigenvalues, self._ratios, strict=True)
        )

    def square(self, e: Vector) -> float:
        """``|e|_K^2``, never negative."""
        if self.n == 1:
            return self.largest * e[0] * e[0]
        if self._columns is None:
            return self._square_of(e)
        square = 0.0
        for value, column in self._modes:
            u = sum(map(mul, column, e))
            square += value * (u * u)
        return square

    def _in_modes(self, e: Vector) -> Sequence[float]:
        return e if self._columns is None else [sum(map(mul, column, e)) for column in self._columns]

    def _square_of(self, u: Sequence[float]) -> float:
        square: float = sum(map(mul, self.eigenvalues, map(mul, u, u)))
        return square

    def project(self, e: Vector, radius: float) -> Vector:
        """The point with ``|p|_K <= radius`` nearest to `e` in the Euclidean norm.

        The returned point obeys the bound in floating point, as `square` computes it, not only up to rounding.
        """
        return self.project_measured(e, radius)[0]

    def project_measured(self, e: Vector, radius: float) -> tuple[Vector, float]:
        """`project`, and the projected point's `square`."""
        u = self._in_modes(e)
        square = self.square(e) if self.n == 1 else self._square_of(u)
        bound = radius * radius
        if square <= bound:
            return e, square
        if bound < _VANISHING:
            return (0.0,) * self.n, 0.0
        if self.isotropic:
            scale = radius / math.sqrt(square)
            p: Vector = tuple([scale * component for component in e])
        else:
            p = self._secular(u, radius * _INSIDE)
        # Rounding may leave p outside by an ulp or two; pull it in until the bound holds exactly.
        square = self.square(p)
        excess: float = 2.0**-52
        while square > bound:
            p = tuple([(1.0 - excess) * component for component in p])
            square = self.square(p)
            excess *= 2.0
        return p, square

    def _secular(self, u: Sequence[float], radius: float) -> Vector:
        """Solve ``|p(mu)|_K = radius``, ``p_i = u_i r_i / (r_i + mu)``, by Newton on ``radius/|p(mu)|_K - 1``.

        That function is increasing and concave in mu, so Newton from mu = 0 climbs to the root without overshooting
        (More and Sorensen's argument for trust regions). mu is scaled by the largest eigenvalue (r = largest/lambda).
        `u` is the point in K's eigenbasis.
        """
        # In units of the radius: p^2 and its slope would underflow where the reservoir is all but empty.
        scaled = [component / radius for component in u]
        terms = list(zip(map(mul, self._weights, map(mul, scaled, scaled)), self._ratios, strict=True))
        mu = 0.0
        for _ in range(_MOST_ITERATIONS):
            square = slope = 0.0
            for weight, ratio in terms:
                shrink = 1.0 / (ratio + mu)
                term = weight * shrink * shrink
                square += term
                slope += term * shrink
            step = (math.sqrt(square) - 1.0) * (square / slope)
            mu += step
            if step <= 1e-8 * mu:  # quadratic convergence: the next step would be 1e-16
                break
        p = [component * (ratio / (ratio + mu)) for component, ratio in zip(u, self._ratios, strict=True)]
        return tuple(p if self._rows is None else [sum(map(mul, row, p)) for row in self._rows])
