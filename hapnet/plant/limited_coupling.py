"""The coupling (2) in one midpoint substep, within the actuators' limits: its spring saturates, its damper is limited.

    a vhat = p + F,    F = -c K (e + h/2 vhat) - lambda B vhat,    |F| <= the force limit

a is the resistance besides the coupling's (masses, hand, own damping; the same on every axis), p the driving force, and
e the offset ``x - ybar`` at the start. c makes the spring's force the discrete gradient of its saturated potential: the
force never exceeds the spring's own limit, and its work is exactly the change of phi. lambda, from 0 to 1, is the
largest for which the whole force is within its limit; 0 always works, because the spring's limit is not greater. A
limited damper still only dissipates, ``lambda |vhat|_B^2 h``. So the substep's energy account stays exact at both
limits.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from operator import mul
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hapnet.checks import Array, Vector
from hapnet.records.equation import equation

ROUNDS = 25
"""Most iterations of a fixed point or a search. The one for c contracts by about ``K h^2 / 4M`` in each; if that is not
enough, c is bisected."""

_NEAR = 1e-9
"""How far the force of a limited damper may stay below its limit, relative to the limit."""

Modes = tuple[Vector, tuple[Vector, ...]]
"""Eigenvalues and eigenvectors (as rows) of ``K x = mu (a + lambda B) x``; the vectors have unit length in
``a + lambda B``."""


class Substep(NamedTuple):
    """The result of a substep with the coupling."""

    velocity: Vector
    """vhat [m/s]."""
    offset: Vector
    """e at the end [m]."""
    pull: Vector
    """K e at the end [N]."""
    force: Vector
    """F [N], on the device."""
    dissipated: float
    """Mean power dissipated by the damper, ``lambda |vhat|_B^2`` [W]."""


class LimitedCoupling:
    """A coupling, for substeps of a fixed length.

    Parameters
    ----------
    stiffness : K [N/m] (n, n). damping : B's diagonal [Ns/m]. resistance : a [Ns/m]. length : h of a substep [s].
    knee : the ``|e|_K`` [sqrt J] at which the spring saturates. force_limit : of spring and damper together [N].
    """

    def __init__(
        self, stiffness: Array, damping: Vector, resistance: float, length: float, knee: float, force_limit: float
    ) -> None:
        self.rows: tuple[Vector, ...] = rows(stiffness)
        self.modes: Modes = self._modes(stiffness, damping, resistance)
        self._stiffness, self._damping, self._resistance = stiffness, damping, resistance
        self._h, self._knee, self._force_limit = length, knee, force_limit

    def substep(self, push: Vector, offset: Vector, pull: Vector) -> tuple[Substep, bool]:
        """Compute a substep; also returns whether its damper was limited.

        `push` is p [N], `offset` e [m] and `pull` K e [N].
        """
        whole = self._damped(1.0, self.modes, push, offset, pull)
        if math.hypot(*whole.force) <= self._force_limit:
            return whole, False
        return self._at_limit(whole, push, offset, pull) or self._within_limit(whole, push, offset, pull), True

    def _at_limit(self, whole: Substep, push: Vector, offset: Vector, pull: Vector) -> Substep | None:
        """Find the direction of a force of known length by a fixed point; None if it does not converge.

        vhat follows from the force, the spring's force from vhat, and lambda from the condition that the whole force
        has the length of its limit. One axis needs no iteration; with more, each contracts by about
        ``limit / (a |vhat|)``.
        """
        limit, h = self._force_limit, self._h
        start = math.sqrt(max(0.0, sum(map(mul, offset, pull))))
        shorter = limit / math.hypot(*whole.force)
        force = [shorter * f for f in whole.force]
        for _ in range(ROUNDS):
            middle = [(p + f) / self._resistance for p, f in zip(push, force, strict=True)]
            end = [e + h * m for e, m in zip(offset, middle, strict=True)]
            after = [sum(map(mul, row, end)) for row in self.rows]
            c = discrete_gradient(start, math.sqrt(max(0.0, sum(map(mul, end, after)))), self._knee)
            spring = [-0.5 * c * (g + g1) for g, g1 in zip(pull, after, strict=True)]
            drag = list(map(mul, self._damping, middle))
            along, square = sum(map(mul, spring, drag)), sum(map(mul, drag, drag))
            if square == 0.0:
                return None
            room = limit * limit - sum(map(mul, spring, spring))
            share = (along + math.sqrt(max(0.0, along * along + square * room))) / square
            before, force = force, [s - share * d for s, d in zip(spring, drag, strict=True)]
            if math.dist(before, force) <= 1e-14 * limit:
                lost = sum([(s - f) * m for s, f, m in zip(spring, before, middle, strict=True)])
                return Substep(tuple(middle), tuple(end), tuple(after), tuple(before), max(0.0, lost))
        return None

    def _within_limit(self, whole: Substep, push: Vector, offset: Vector, pull: Vector) -> Substep:
        """If `_at_limit` fails: search the lambda that gives the limit, by false position (Illinois), from below."""
        limit = self._force_limit

        def damped(share: float) -> Substep:
            B = tuple([share * b for b in self._damping])
            return self._damped(share, self._modes(self._stiffness, B, self._resistance), push, offset, pull)

        best, low, high = damped(0.0), 0.0, 1.0
        below, above = math.hypot(*best.force) - limit, math.hypot(*whole.force) - limit
        beyond = below
        for _ in range(ROUNDS):
            share = low - below * (high - low) / (above - below)
            if math.hypot(*best.force) >= (1.0 - _NEAR) * limit or not low < share < high:
                break
            step = damped(share)
            again, beyond = beyond, math.hypot(*step.force) - limit
            if beyond > 0.0:
                high, above = share, beyond
                below *= 0.5 if again > 0.0 else 1.0
            else:
                best, low, below = step, share, beyond
                above *= 0.5 if again <= 0.0 else 1.0
        return best

    def _damped(self, share: float, modes: Modes, push: Vector, offset: Vector, pull: Vector) -> Substep:
        """The substep with lambda = `share`: ``(a + lambda B + c h/2 K) vhat = p - c K e``, solved in its modes."""
        h = self._h
        c, middle = self._saturated(modes, push, pull, sum(map(mul, offset, pull)))
        end = tuple([e + h * m for e, m in zip(offset, middle, strict=True)])
        after = tuple([sum(map(mul, row, end)) for row in self.rows])
        drag = [share * b * m for b, m in zip(self._damping, middle, strict=True)]
        force = [-0.5 * c * (g + g1) - d for g, g1, d in zip(pull, after, drag, strict=True)]
        return Substep(middle, end, after, tuple(force), sum(map(mul, drag, middle)))

    def _saturated(self, modes: Modes, push: Vector, pull: Vector, square: float) -> tuple[float, Vector]:
        """(c, vhat) for a given damper; `square` is ``|e|_K^2`` at the start [J].

        In the modes ``w = (push - c pull)/(1 + c h/2 mu)``, ``vhat = modes' w``, and at the end
        ``|e|_K^2 = square + 2 h w . pull + h^2 sum mu w^2``.
        """
        h, knee = self._h, self._knee
        values, vectors = modes
        pushes = [sum(map(mul, mode, push)) for mode in vectors]
        pulls = [sum(map(mul, mode, pull)) for mode in vectors]
        start = math.sqrt(max(0.0, square))
        terms = list(zip(pushes, pulls, values, strict=True))

        def gradient(c: float) -> float:
            gain = 0.0
            for a, b, k in terms:
                u = (a - c * b) / (1.0 + 0.5 * c * h * k)
                gain += u * (2.0 * b + h * k * u)
            return discrete_gradient(start, math.sqrt(max(0.0, square + h * gain)), knee)

        c = _fixed_point(gradient, 1.0 if start <= knee else knee / start)
        w = [(a - c * b) / (1.0 + 0.5 * c * h * k) for a, b, k in terms]
        return c, tuple([sum(map(mul, column, w)) for column in zip(*vectors, strict=True)])

    @staticmethod
    def _modes(stiffness: Array, damping: ArrayLike, resistance: float) -> Modes:
        root = 1.0 / np.sqrt(resistance + np.asarray(damping))
        values, vectors = np.linalg.eigh(stiffness * np.outer(root, root))
        return tuple(values.tolist()), rows(vectors.T * root)


def rows(matrix: NDArray[np.floating[Any]]) -> tuple[Vector, ...]:
    """The matrix's rows as tuples of floats."""
    return tuple(tuple(row) for row in matrix.tolist())


@equation
def discrete_gradient(start: float, end: float, knee: float) -> float:
    """c with ``h(end) - h(start) = c (end^2 - start^2) / 2`` for the potential h of a spring saturated at the knee."""
    if start <= knee and end <= knee:
        return 1.0
    if start >= knee and end >= knee:
        return 2.0 * knee / (start + end)
    inner, outer = min(start, end), max(start, end)
    below, beyond = knee - inner, outer - knee
    # The mean of h' over the path, part of it below the knee: this avoids the difference of nearly equal potentials.
    return (below * (knee + inner) + 2.0 * beyond * knee) / ((below + beyond) * (outer + inner))


def _fixed_point(gradient: Callable[[float], float], c: float) -> float:
    """The c with ``gradient(c) = c``, to rounding. gradient(0) is above 0, and gradient(1) is at most 1."""
    for _ in range(ROUNDS):
        before, c = c, gradient(c)
        if abs(c - before) <= 1e-15:
            return c
    low, high = 0.0, 1.0
    while low < (c := 0.5 * (low + high)) < high:
        if gradient(c) > c:
            low = c
        else:
            high = c
    return c
