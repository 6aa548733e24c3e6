"""Coupling springs of many scenarios at once: `hapnet.mechanics.spring`, in the same order of operations."""

from __future__ import annotations

import math

import numpy as np

from hapnet.checks import Array
from hapnet.mechanics.spring import Spring


class Springs:
    """One `Spring`, evaluated for offsets of shape (n, M)."""

    def __init__(self, spring: Spring) -> None:
        self.scalar = spring
        self.dof = spring.dof
        self.knee = spring.knee
        self.isotropic = spring.ellipsoid.isotropic
        self._largest = spring.ellipsoid.largest
        self._saturates = spring.knee != math.inf
        self._values = np.array(spring.ellipsoid.eigenvalues)[:, None]
        diagonal = np.array_equal(spring.K, np.diag(np.diagonal(spring.K)))
        self._basis = None if diagonal else np.linalg.eigh(spring.K)[1].T

    def square(self, e: Array) -> Array:
        """``|e|_K^2``, shape (M,)."""
        if self.dof == 1:
            first: Array = e[0]
            return self._largest * first * first
        u = e if self._basis is None else self._basis @ e
        total: Array = (self._values * (u * u)).sum(axis=0)
        return total

    def potential(self, e: Array) -> Array:
        """phi [J], shape (M,)."""
        square = self.square(e)
        phi = 0.5 * square
        if self._saturates:
            knee = self.knee
            beyond = (square > knee * knee).nonzero()[0]
            if beyond.size:
                phi[beyond] = knee * np.sqrt(square[beyond]) - 0.5 * knee * knee
        return phi

    def nearest(self, e: Array, energy: Array) -> Array:
        """The offsets with ``phi <= energy`` nearest to `e`, for an isotropic K; see `Spring.nearest`."""
        knee = self.knee
        some = energy > 0.0
        safe = np.where(some, energy, 1.0)
        with np.errstate(over="ignore"):
            radius = np.sqrt(2.0 * safe)
            if self._saturates:
                radius = np.where(safe <= 0.5 * knee * knee, radius, safe / knee + 0.5 * knee)
        p = self._project(e, radius)
        excess: float = 2.0**-52
        while (out := (some & (self.potential(p) > energy)).nonzero()[0]).size:
            p[:, out] = self._project(p[:, out], radius[out] * (1.0 - excess))
            excess *= 2.0
        p[:, ~some] = 0.0
        return p

    def _project(self, e: Array, radius: Array) -> Array:
        square, bound = self.square(e), radius * radius
        out = (square > bound).nonzero()[0]
        p = e.copy()
        if not out.size:
            return p
        bound = bound[out]
        q = radius[out] / np.sqrt(square[out]) * e[:, out]
        q[:, bound < 1e-280] = 0.0
        excess: float = 2.0**-52
        while (far := (self.square(q) > bound).nonzero()[0]).size:
            q[:, far] = (1.0 - excess) * q[:, far]
            excess *= 2.0
        p[:, out] = q
        return p
