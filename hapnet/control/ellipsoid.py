"""Euclidean projection on an ellipsoid: the whole difficulty of PSPM's optimisation (8)-(9).

With R the energy at hand, (9) says that the modulated set-position lies in ``1/2 |ybar - x|_K^2 <= R``; (8) asks for
the point of that ellipsoid nearest to y. In K's eigenbasis, with u the offset of y from the centre, the answer is
``u_i / (1 + mu lambda_i)`` with the multiplier mu >= 0 solving one scalar (secular) equation. For K = kappa I it is a
radial scaling.
"""

from __future__ import annotations

import math
from operator import mul

import numpy as np

from hapnet.checks import Array, Vector

_MOST_ITERATIONS = 60  # Newton needs 3 to 8; the bound only makes the loop finite
_VANISHING = 1e-280  # squared radius below which products underflow; the ball is a point


class Ellipsoid:
    """The norm ``|e|_K`` of a symmetric positive definite K, and projections on its balls.

    Parameters
    ----------
    K : (n, n) symmetric positive definite matrix (checked by the caller).

    Factored once; each call then costs a few microseconds on plain floats.
    """

    __slots__ = ("_columns", "_ratios", "_rows", "eigenvalues", "isotropic", "largest", "n")

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
        self.largest = max(self.eigenvalues)
        self.isotropic = min(self.eigenvalues) == self.largest
        self._ratios = tuple(value / self.largest for value in self.eigenvalues)

    def square(self, e: Vector) -> float:
        """``|e|_K^2``, never negative."""
        if self.n == 1:
            return self.largest * e[0] * e[0]
        u = e if self._columns is None else [sum(map(mul, column, e)) for column in self._columns]
        square: float = sum(map(mul, self.eigenvalues, map(mul, u, u)))
        return square

    def project(self, e: Vector, radius: float) -> Vector:
        """The point with ``|p|_K <= radius`` nearest to `e` in the Euclidean norm.

        The returned point obeys the bound in floating point, as `square` computes it, not only up to rounding.
        """
        square = self.square(e)
        bound = radius * radius
        if square <= bound:
            return e
        if bound < _VANISHING:
            return (0.0,) * self.n
        if self.isotropic:
            scale = radius / math.sqrt(square)
            p: Vector = tuple([scale * component for component in e])
        else:
            p = self._secular(e, radius)
        # Rounding may leave p outside by an ulp or two; pull it in until the bound holds exactly.
        excess: float = 2.0**-52
        while self.square(p) > bound:
            p = tuple([(1.0 - excess) * component for component in p])
            excess *= 2.0
        return p

    def _secular(self, e: Vector, radius: float) -> Vector:
        """Solve ``|p(mu)|_K = radius``, ``p_i = u_i / (1 + mu r_i)``, by Newton on ``radius/|p(mu)|_K - 1``.

        That function is increasing and concave in mu, so Newton from mu = 0 climbs to the root without overshooting
        (More and Sorensen's argument for trust regions). mu is scaled by the largest eigenvalue (r = lambda/largest).
        """
        u = e if self._columns is None else [sum(map(mul, column, e)) for column in self._columns]
        # In units of the radius: p^2 and its slope would underflow where the reservoir is all but empty.
        weights = [value * (component / radius) ** 2 for value, component in zip(self.eigenvalues, u, strict=True)]
        ratios = self._ratios
        mu = 0.0
        for _ in range(_MOST_ITERATIONS):
            square = slope = 0.0
            for weight, ratio in zip(weights, ratios, strict=True):
                shrink = 1.0 / (1.0 + mu * ratio)
                term = weight * shrink * shrink
                square += term
                slope += term * shrink * ratio
            step = (math.sqrt(square) - 1.0) * (square / slope)
            mu += step
            if step <= 1e-9 * mu:  # quadratic convergence: the next step would be 1e-18
                break
        p = [component / (1.0 + mu * ratio) for component, ratio in zip(u, ratios, strict=True)]
        if self._rows is None:
            return tuple(p)
        return tuple([sum(map(mul, row, p)) for row in self._rows])
