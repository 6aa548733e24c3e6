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
from typing import NamedTuple

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.records.record import MatrixOfAxes, OfAxes, Record, compiled_as, equation
from hapnet.records.vectors import copy, distance, dot, length, times

ROUNDS = 25
"""Most iterations of a fixed point or a search. The one for c contracts by about ``K h^2 / 4M`` in each; if that is not
enough, c is bisected."""

_NEAR = 1e-9
"""Largest relative distance of a limited damper's force from its limit."""


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


class LimitedCoupling(Record):
    """A coupling, for substeps of a fixed length.

    Parameters
    ----------
    stiffness : K [N/m] (n, n). damping : B's diagonal [Ns/m]. resistance : a [Ns/m]. length : h of a substep [s].
    knee : the ``|e|_K`` [sqrt J] at which the spring saturates. force_limit : of spring and damper together [N].

    Attributes
    ----------
    K : its rows. values, vectors : eigenvalues and eigenvectors (as rows) of ``K x = mu (a + lambda B) x``; the vectors
        have unit length in ``a + lambda B``, with lambda = `share`.
    push, offset, pull : of a substep: p [N], e [m] and K e [N], afterwards those at its end.
    middle, force, power, limited : its result: vhat, F, the power dissipated, and whether its damper was limited.
    whole : the length of F with the whole damper. unsolved : the force is not known, as only plain Python searches it.
    pushes, pulls, end, after, before, spring, drag : work arrays of a substep.
    """

    n: int
    K: MatrixOfAxes
    damping: OfAxes
    resistance: float
    h: float
    knee: float
    force_limit: float
    share: float
    values: OfAxes
    vectors: MatrixOfAxes
    push: OfAxes
    offset: OfAxes
    pull: OfAxes
    middle: OfAxes
    force: OfAxes
    power: float
    limited: int
    whole: float
    unsolved: int
    pushes: OfAxes
    pulls: OfAxes
    end: OfAxes
    after: OfAxes
    before: OfAxes
    spring: OfAxes
    drag: OfAxes

    def __init__(
        self, stiffness: Array, damping: Vector, resistance: float, length: float, knee: float, force_limit: float
    ) -> None:
        super().__init__()
        self.n = n = len(damping)
        self._stiffness = stiffness
        self.K, self.damping, self.resistance = stiffness.tolist(), list(damping), resistance
        self.h, self.knee, self.force_limit = length, knee, force_limit
        for name in ("push", "offset", "pull", "middle", "force", "pushes", "pulls"):
            setattr(self, name, [0.0] * n)
        for name in ("end", "after", "before", "spring", "drag"):
            setattr(self, name, [0.0] * n)
        self.limit_damper(1.0)

    def substep(self, push: Vector, offset: Vector, pull: Vector) -> tuple[Substep, bool]:
        """Compute a substep; also returns whether its damper was limited.

        `push` is p [N], `offset` e [m] and `pull` K e [N].
        """
        self.push[:], self.offset[:], self.pull[:] = push, offset, pull
        substep(self)
        middle, end, pull, force = (tuple(vector) for vector in (self.middle, self.offset, self.pull, self.force))
        return Substep(middle, end, pull, force, self.power), bool(self.limited)

    def limit_damper(self, share: float) -> None:
        """From now on compute with lambda = `share`."""
        self.share = share
        root = 1.0 / np.sqrt(self.resistance + np.asarray([share * b for b in self.damping]))
        values, vectors = np.linalg.eigh(self._stiffness * np.outer(root, root))
        self.values, self.vectors = values.tolist(), (vectors.T * root).tolist()


@equation
def substep(coupling: LimitedCoupling) -> None:
    """Compute a substep from `push`, `offset` and `pull`."""
    n = coupling.n
    _damp(coupling)
    coupling.whole = length(n, coupling.force)
    coupling.limited = 0
    if coupling.whole > coupling.force_limit:
        coupling.limited = 1
        if not _find_at_limit(coupling):
            _search(coupling)
    copy(n, coupling.end, coupling.offset)
    copy(n, coupling.after, coupling.pull)


@equation
def _damp(coupling: LimitedCoupling) -> None:
    """Solve ``(a + lambda B + c h/2 K) vhat = p - c K e`` with lambda = `share`, in its modes."""
    n, h = coupling.n, coupling.h
    c = _saturate(coupling)
    for i in range(n):
        coupling.end[i] = coupling.offset[i] + h * coupling.middle[i]
    times(n, coupling.K, coupling.end, coupling.after)
    coupling.power = 0.0
    for i in range(n):
        drag = coupling.share * coupling.damping[i] * coupling.middle[i]
        coupling.force[i] = -0.5 * c * (coupling.pull[i] + coupling.after[i]) - drag
        coupling.power += drag * coupling.middle[i]


@equation
def _saturate(coupling: LimitedCoupling) -> float:
    """Return c, and compute vhat into `middle`.

    In the modes ``w = (push - c pull)/(1 + c h/2 mu)``, ``vhat = modes' w``, and at the end
    ``|e|_K^2 = square + 2 h w . pull + h^2 sum mu w^2``, with `square` that at the start [J].
    """
    n, h, pushes, pulls = coupling.n, coupling.h, coupling.pushes, coupling.pulls
    square = dot(n, coupling.offset, coupling.pull)
    for k in range(n):
        pushes[k] = dot(n, coupling.vectors[k], coupling.push)
        pulls[k] = dot(n, coupling.vectors[k], coupling.pull)
    start = math.sqrt(max(0.0, square))
    c = _fixed_point(coupling, start, square, 1.0 if start <= coupling.knee else coupling.knee / start)
    for i in range(n):
        coupling.middle[i] = 0.0
    for k in range(n):
        w = (pushes[k] - c * pulls[k]) / (1.0 + 0.5 * c * h * coupling.values[k])
        for i in range(n):
            coupling.middle[i] += coupling.vectors[k][i] * w
    return c


@equation
def _gradient(coupling: LimitedCoupling, start: float, square: float, c: float) -> float:
    """The discrete gradient of the substep that a given c leads to."""
    h, gain = coupling.h, 0.0
    for k in range(coupling.n):
        value, pull = coupling.values[k], coupling.pulls[k]
        u = (coupling.pushes[k] - c * pull) / (1.0 + 0.5 * c * h * value)
        gain += u * (2.0 * pull + h * value * u)
    return discrete_gradient(start, math.sqrt(max(0.0, square + h * gain)), coupling.knee)


@equation
def _fixed_point(coupling: LimitedCoupling, start: float, square: float, c: float) -> float:
    """The c with ``gradient(c) = c``, to rounding. gradient(0) is above 0, and gradient(1) is at most 1."""
    for _ in range(ROUNDS):
        before = c
        c = _gradient(coupling, start, square, c)
        if abs(c - before) <= 1e-15:
            return c
    low, high = 0.0, 1.0
    c = 0.5
    while low < c < high:
        if _gradient(coupling, start, square, c) > c:
            low = c
        else:
            high = c
        c = 0.5 * (low + high)
    return c


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


@equation
def _find_at_limit(coupling: LimitedCoupling) -> bool:
    """Find the direction of a force of known length by a fixed point; false if it does not converge.

    vhat follows from the force, the spring's force from vhat, and lambda from the condition that the whole force has
    the length of its limit. One axis needs no iteration; with more, each contracts by about ``limit / (a |vhat|)``.
    """
    n, h, limit, middle = coupling.n, coupling.h, coupling.force_limit, coupling.middle
    force, spring, drag = coupling.force, coupling.spring, coupling.drag
    start = math.sqrt(max(0.0, dot(n, coupling.offset, coupling.pull)))
    shorter = limit / coupling.whole
    for i in range(n):
        force[i] = shorter * force[i]
    for _ in range(ROUNDS):
        for i in range(n):
            middle[i] = (coupling.push[i] + force[i]) / coupling.resistance
            coupling.end[i] = coupling.offset[i] + h * middle[i]
        times(n, coupling.K, coupling.end, coupling.after)
        c = discrete_gradient(start, math.sqrt(max(0.0, dot(n, coupling.end, coupling.after))), coupling.knee)
        for i in range(n):
            spring[i] = -0.5 * c * (coupling.pull[i] + coupling.after[i])
            drag[i] = coupling.damping[i] * middle[i]
        along, square = dot(n, spring, drag), dot(n, drag, drag)
        if square == 0.0:
            return False
        room = limit * limit - dot(n, spring, spring)
        share = (along + math.sqrt(max(0.0, along * along + square * room))) / square
        for i in range(n):
            coupling.before[i] = force[i]
            force[i] = spring[i] - share * drag[i]
        if distance(n, coupling.before, force) <= 1e-14 * limit:
            lost = 0.0
            for i in range(n):
                lost += (spring[i] - coupling.before[i]) * middle[i]
            copy(n, coupling.before, force)
            coupling.power = max(0.0, lost)
            return True
    return False


def _give_up(coupling: LimitedCoupling) -> None:
    coupling.unsolved = 1


@compiled_as(_give_up)
def _search(coupling: LimitedCoupling) -> None:
    """If `_find_at_limit` fails: search the lambda that gives the limit, by false position (Illinois), from below."""
    limit = coupling.force_limit
    low, high = 0.0, 1.0
    beyond = below = _beyond(coupling, low)
    best = length(coupling.n, coupling.force)
    above = coupling.whole - limit
    for _ in range(ROUNDS):
        share = low - below * (high - low) / (above - below)
        if best >= (1.0 - _NEAR) * limit or not low < share < high:
            break
        again, beyond = beyond, _beyond(coupling, share)
        if beyond > 0.0:
            high, above = share, beyond
            below *= 0.5 if again > 0.0 else 1.0
        else:
            low, below, best = share, beyond, length(coupling.n, coupling.force)
            above *= 0.5 if again <= 0.0 else 1.0
    _beyond(coupling, low)
    coupling.limit_damper(1.0)


def _beyond(coupling: LimitedCoupling, share: float) -> float:
    """The excess of the force over its limit with lambda = `share` [N]; computes the substep with this lambda."""
    coupling.limit_damper(share)
    _damp(coupling)
    return length(coupling.n, coupling.force) - coupling.force_limit
