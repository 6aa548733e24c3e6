"""Euclidean projection on an ellipsoid: the core of PSPM's optimisation (8)-(9).

With R the energy at hand, (9) requires that the modulated set-position is in ``1/2 |ybar - x|_K^2 <= R``; (8) is the
nearest point of this ellipsoid to y. In K's eigenbasis, with u the offset of y from the centre, the answer is
``u_i / (1 + mu lambda_i)`` with the multiplier mu >= 0 solving one scalar (secular) equation. For K = kappa I it is a
radial scaling.
"""

from __future__ import annotations

import math

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.records.record import Floats, MatrixOfAxes, OfAxes, Reals, Record, equation

_MOST_ITERATIONS = 60  # Newton needs 3 to 8; the bound only makes the loop finite
_INSIDE = 1.0 - 2.0**-50  # factor of the radius: despite rounding, the point is then inside at the first try
_VANISHING = 1e-280  # squared radius below which products underflow; the ball is a point


class Ellipsoid(Record):
    """The norm ``|e|_K`` of a symmetric positive definite K, and projections on its balls.

    Parameters
    ----------
    K : (n, n) symmetric positive definite matrix (checked by the caller). It is factored once.

    Attributes
    ----------
    coupled : whether K is not diagonal. Then `basis` has its eigenvectors as columns, and `modes` as rows.
    isotropic : whether all eigenvalues are the same. largest : the largest of them.
    ratios, weights : for each eigenvalue largest/lambda, and lambda times its square.
    u, p : room for a point in the eigenbasis, while `project` runs.
    """

    n: int
    coupled: int
    isotropic: int
    largest: float
    eigenvalues: OfAxes
    ratios: OfAxes
    weights: OfAxes
    modes: MatrixOfAxes
    basis: MatrixOfAxes
    u: OfAxes
    p: OfAxes

    def __init__(self, K: Array) -> None:
        super().__init__()
        self.n = K.shape[0]
        if np.array_equal(K, np.diag(np.diagonal(K))):
            eigenvalues = np.diagonal(K)
        else:
            eigenvalues, basis = np.linalg.eigh(K)
            self.coupled, self.basis, self.modes = 1, basis.tolist(), basis.T.tolist()
        self.eigenvalues = eigenvalues.tolist()
        self.largest = max(self.eigenvalues)
        self.isotropic = int(min(self.eigenvalues) == self.largest)
        self.ratios = [self.largest / value for value in self.eigenvalues]
        self.weights = [value * ratio * ratio for value, ratio in zip(self.eigenvalues, self.ratios, strict=True)]
        self.u, self.p = [0.0] * self.n, [0.0] * self.n

    def square(self, e: Vector) -> float:
        """``|e|_K^2``, never negative."""
        return square(self, e)

    def project(self, e: Vector, radius: float) -> Vector:
        """The point with ``|p|_K <= radius`` nearest to `e` in the Euclidean norm.

        The returned point meets the bound exactly in floating point, as computed by `square`, not only up to rounding.
        """
        p = list(e)
        project(self, p, radius)
        return tuple(p)


@equation
def square(ellipsoid: Ellipsoid, e: Reals) -> float:
    """``|e|_K^2``."""
    n = ellipsoid.n
    if n == 1:
        return ellipsoid.largest * e[0] * e[0]
    total = 0.0
    if not ellipsoid.coupled:
        for i in range(n):
            total += ellipsoid.eigenvalues[i] * (e[i] * e[i])
        return total
    for k in range(n):
        u = 0.0
        for i in range(n):
            u += ellipsoid.modes[k][i] * e[i]
        total += ellipsoid.eigenvalues[k] * (u * u)
    return total


@equation
def project(ellipsoid: Ellipsoid, e: Floats, radius: float) -> float:
    """Replace e by the nearest point with ``|p|_K <= radius``; returns its ``|p|_K^2``."""
    n = ellipsoid.n
    bound = radius * radius
    s2 = square(ellipsoid, e)
    if s2 <= bound:
        return s2
    if bound < _VANISHING:
        for i in range(n):
            e[i] = 0.0
        return 0.0
    if ellipsoid.isotropic:
        scale = radius / math.sqrt(s2)
        for i in range(n):
            e[i] = scale * e[i]
    else:
        _secular(ellipsoid, e, radius * _INSIDE)
    s2 = square(ellipsoid, e)  # rounding may leave e outside by an ulp or two; it is pulled in until the bound holds
    excess = 2.0**-52
    while s2 > bound:
        for i in range(n):
            e[i] = (1.0 - excess) * e[i]
        s2 = square(ellipsoid, e)
        excess *= 2.0
    return s2


@equation
def _secular(ellipsoid: Ellipsoid, e: Floats, radius: float) -> None:
    """Solve ``|p(mu)|_K = radius``, ``p_i = u_i r_i / (r_i + mu)``, by Newton on ``radius/|p(mu)|_K - 1``, in place.

    That function is increasing and concave in mu, so Newton from mu = 0 climbs to the root without overshooting
    (More and Sorensen's argument for trust regions). mu is scaled by the largest eigenvalue (r = largest/lambda).
    `u` is the point in K's eigenbasis.
    """
    n, u, p = ellipsoid.n, ellipsoid.u, ellipsoid.p
    for k in range(n):
        u[k] = e[k]
        if ellipsoid.coupled:
            u[k] = 0.0
            for i in range(n):
                u[k] += ellipsoid.modes[k][i] * e[i]
    mu = 0.0
    for _ in range(_MOST_ITERATIONS):
        total = slope = 0.0
        for k in range(n):
            scaled = u[k] / radius  # p^2 and its slope would underflow where the reservoir is all but empty
            shrink = 1.0 / (ellipsoid.ratios[k] + mu)
            term = ellipsoid.weights[k] * (scaled * scaled) * shrink * shrink
            total += term
            slope += term * shrink
        step = (math.sqrt(total) - 1.0) * (total / slope)
        mu += step
        if step <= 1e-8 * mu:  # quadratic convergence: the next step would be 1e-16
            break
    for k in range(n):
        p[k] = u[k] * (ellipsoid.ratios[k] / (ellipsoid.ratios[k] + mu))
    for i in range(n):
        e[i] = p[i]
        if ellipsoid.coupled:
            e[i] = 0.0
            for k in range(n):
                e[i] += ellipsoid.basis[i][k] * p[k]
