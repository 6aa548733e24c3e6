"""Several planes that act on one another through the mass: one convex problem, by a semismooth Newton method.

Each plane i pushes with ``f_i <= 0`` along its normal n_i (into the solid), a law of ``u_i = n_i . vhat`` alone. It is
that of `hapnet.plant.worlds.walls`: the discrete gradient of its potential and a damper for the share inside, no pull.
No f_i rises with u_i. So the step's

    vhat = w + C f,    f = sum n_i f_i(n_i . vhat)                                          C = A^-1, w = C c

is the minimum of a strictly convex function and has one solution. Newton's direction descends there, and the slope
along it rises, so a step that went too far is halved.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot
from typing import NamedTuple

from hapnet.checks import Vector
from hapnet.records.vectors import added, inner

Matrix = Sequence[Sequence[float]]

ROUNDS = 50
"""The most rounds; 3 to 8 are usual."""

_EXACT = 1e-13
"""A residual of so much of the forces is none."""


class Contact(NamedTuple):
    """A plane for one step."""

    normal: Vector  #: into the solid; of any length
    depth_m: float  #: p0, below 0 outside
    stiffness: float
    damping: float


def compliance(inverse_columns: Sequence[Sequence[float]]) -> list[list[float]]:
    """C = A^-1 from its columns, made symmetric."""
    n = len(inverse_columns)
    return [[0.5 * (inverse_columns[i][j] + inverse_columns[j][i]) for j in range(n)] for i in range(n)]


def force(contact: Contact, u: float, dt: float) -> tuple[float, float]:
    """f [N] at the velocity `u` [m/s] along the normal over a step of `dt` [s], and -df/du [Ns/m]."""
    K, p0 = contact.stiffness, contact.depth_m
    direction = dt * u
    p1 = p0 + direction
    if p1 > 0.0:
        if p0 > 0.0:
            push = 0.5 * K * (p0 + p1) + contact.damping * u
            rate = 0.5 * K * dt + contact.damping
        else:
            share = p1 / direction
            push = 0.5 * K * p1 * share + contact.damping * p1 / dt
            rate = K * dt * share * (1.0 - 0.5 * share) + contact.damping
    elif p0 > 0.0:
        share = -p0 / direction
        push = 0.5 * K * p0 * share - contact.damping * p0 / dt
        rate = 0.5 * K * dt * share * share
    else:
        return 0.0, 0.0
    return (-push, rate) if push > 0.0 else (0.0, 0.0)


def solve(contacts: Sequence[Contact], w: Sequence[float], C: Matrix, dt: float) -> list[float]:
    """The forces f_i [N] of all planes, none above 0.

    Parameters
    ----------
    w : (n,) velocity without contact [m/s]. C : (n, n) A^-1 [m/s per N]. dt : the step's length [s].
    """
    n = len(w)
    f = [0.0] * n
    best: list[float] = [0.0] * len(contacts)
    residual, stiffening, pushes = _residual(contacts, f, w, C, dt)
    minimum = hypot(*residual)
    for _ in range(ROUNDS):
        scale = added([-push * hypot(*c.normal) for push, c in zip(pushes, contacts, strict=True)])
        if hypot(*residual) <= _EXACT * scale:
            return pushes
        step = _direction(residual, stiffening, contacts, C)
        direction = times(C, step)
        slope = inner(residual, direction)
        size, low, high = 1.0, 0.0, 0.0
        for _ in range(30):
            trial = [a + size * b for a, b in zip(f, step, strict=True)]
            residual, stiffening, pushes = _residual(contacts, trial, w, C, dt)
            there = inner(residual, direction)
            if there <= -0.5 * slope:  # slope < 0: it may overshoot, but by less than it was short
                break
            high = size
            size = 0.5 * (low + high)
        f = trial
        if (size_now := hypot(*residual)) < minimum:
            minimum, best = size_now, pushes
    return best


def _residual(
    contacts: Sequence[Contact], f: Sequence[float], w: Sequence[float], C: Matrix, dt: float
) -> tuple[list[float], list[float], list[float]]:
    vhat = [a + b for a, b in zip(w, times(C, f), strict=True)]
    residual, stiffening, pushes = list(f), [], []
    for contact in contacts:
        push, rate = force(contact, inner(contact.normal, vhat), dt)
        stiffening.append(rate)
        pushes.append(push)
        if push:
            residual = [r - push * n for r, n in zip(residual, contact.normal, strict=True)]
    return residual, stiffening, pushes


def _direction(
    residual: Sequence[float], rates: Sequence[float], contacts: Sequence[Contact], C: Matrix
) -> list[float]:
    """Newton's step of f: ``(I + sum k_i n_i n_i' C) step = -residual``."""
    n = len(residual)
    rows = [[1.0 if i == j else 0.0 for j in range(n)] for i in range(n)]
    for contact, rate in zip(contacts, rates, strict=True):
        if rate:
            seen = times(C, contact.normal)  # C is symmetric
            for row, part in zip(rows, contact.normal, strict=True):
                factor = rate * part
                for j, value in enumerate(seen):
                    row[j] += factor * value
    return solved(rows, [[-r] for r in residual])[0]


def solved(rows: list[list[float]], right: list[list[float]]) -> list[list[float]]:
    """The columns of X in ``rows X = right``, by elimination with pivots; both arguments are used up."""
    n = len(rows)
    work = [row + values for row, values in zip(rows, right, strict=True)]
    for i in range(n):
        pivot = max(range(i, n), key=lambda k: abs(work[k][i]))
        work[i], work[pivot] = work[pivot], work[i]
        top = work[i]
        for k in range(n):
            if k != i and (factor := work[k][i] / top[i]):
                work[k] = [a - factor * b for a, b in zip(work[k], top, strict=True)]
    return [[work[i][n + j] / work[i][i] for i in range(n)] for j in range(len(right[0]))]


def times(matrix: Matrix, vector: Sequence[float]) -> list[float]:
    return [inner(row, vector) for row in matrix]
