"""Several planes that act on one another through the mass: a convex problem, solved by a semismooth Newton method.

Each plane i pushes with ``f_i <= 0`` along its normal n_i (into the solid), which depends on ``u_i = n_i . vhat`` only.
The law is that of `hapnet.plant.worlds.walls`: the discrete gradient of the potential, a damper for the share of the
path inside, and no pull.
No f_i rises with u_i. So the step's

    vhat = w + C f,    f = sum n_i f_i(n_i . vhat)                                          C = A^-1, w = C c

is the minimum of a strictly convex function and has one solution. Newton's direction descends there, and the slope
along it rises, so a step that went too far is halved.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from hapnet.records.record import AXES, FloatRows, Floats, OfAxes, Reals, Record, equation
from hapnet.records.vectors import copy, dot, length, times

MOST = 8
"""The most planes of a compiled step."""

ROUNDS = 50
"""The most rounds; 3 to 8 are usual."""

_EXACT = 1e-13
"""A residual below this share of the forces counts as 0."""

_RIGHT = 4
"""The most right-hand sides of a system."""


class Coupled(Record):
    """At most `most` planes of one step with n axes, and the solver's work arrays.

    count : the number of planes. normals : into the solid, of any length. depths : p0, below 0 outside [m].
    stiffnesses, dampings : [N/m], [Ns/m]. pushes : f_i [N], none above 0. rates : -df_i/du_i [Ns/m]. drags : for
    a caller that adds friction across the normals [Ns/m].
    """

    n: int
    count: int
    normals: Annotated[FloatRows, (MOST, AXES)]
    depths: Annotated[Floats, (MOST,)]
    stiffnesses: Annotated[Floats, (MOST,)]
    dampings: Annotated[Floats, (MOST,)]
    pushes: Annotated[Floats, (MOST,)]
    rates: Annotated[Floats, (MOST,)]
    drags: Annotated[Floats, (MOST,)]
    best: Annotated[Floats, (MOST,)]
    f: OfAxes
    trial: OfAxes
    residual: OfAxes
    step: OfAxes
    direction: OfAxes
    vhat: OfAxes
    rows: Annotated[FloatRows, (AXES, AXES + _RIGHT)]

    def __init__(self, n: int, most: int) -> None:
        self.n, self.count = n, 0
        self.normals = [[0.0] * n for _ in range(most)]
        self.depths, self.stiffnesses, self.dampings = [0.0] * most, [0.0] * most, [0.0] * most
        self.pushes, self.rates, self.best = [0.0] * most, [0.0] * most, [0.0] * most
        self.drags = [0.0] * most
        self.f, self.trial, self.residual, self.step = [0.0] * n, [0.0] * n, [0.0] * n, [0.0] * n
        self.direction, self.vhat = [0.0] * n, [0.0] * n
        self.rows = [[0.0] * (n + _RIGHT) for _ in range(n)]


@equation
def put(planes: Coupled, normal: Reals, depth: float, stiffness: float, damping: float) -> None:
    """Add a plane."""
    k = planes.count
    copy(planes.n, normal, planes.normals[k])
    planes.depths[k], planes.stiffnesses[k], planes.dampings[k] = depth, stiffness, damping
    planes.count = k + 1


@equation
def compliance(n: int, columns: Sequence[Reals], C: FloatRows) -> None:
    """Compute C = A^-1 from its columns, made symmetric."""
    for i in range(n):
        for j in range(n):
            C[i][j] = 0.5 * (columns[i][j] + columns[j][i])


@equation
def force(stiffness: float, damping: float, depth: float, u: float, dt: float) -> tuple[float, float]:
    """f [N] at the velocity `u` [m/s] along the normal over a step of `dt` [s], and -df/du [Ns/m]."""
    K, p0 = stiffness, depth
    direction = dt * u
    p1 = p0 + direction
    if p1 > 0.0:
        if p0 > 0.0:
            push = 0.5 * K * (p0 + p1) + damping * u
            rate = 0.5 * K * dt + damping
        else:
            share = p1 / direction
            push = 0.5 * K * p1 * share + damping * p1 / dt
            rate = K * dt * share * (1.0 - 0.5 * share) + damping
    elif p0 > 0.0:
        share = -p0 / direction
        push = 0.5 * K * p0 * share - damping * p0 / dt
        rate = 0.5 * K * dt * share * share
    else:
        return 0.0, 0.0
    return (-push, rate) if push > 0.0 else (0.0, 0.0)


@equation
def solve(planes: Coupled, w: Reals, C: FloatRows, dt: float) -> None:
    """Compute the forces of all planes into `pushes`.

    w : (n,) velocity without contact [m/s]. C : (n, n) A^-1 [m/s per N]. dt : the step's length [s].
    """
    n, f, trial = planes.n, planes.f, planes.trial
    for i in range(n):
        f[i] = 0.0
    for k in range(planes.count):
        planes.best[k] = 0.0
    _balance(planes, f, w, C, dt)
    minimum = length(n, planes.residual)
    for _ in range(ROUNDS):
        scale = 0.0
        for k in range(planes.count):
            scale += -planes.pushes[k] * length(n, planes.normals[k])
        if length(n, planes.residual) <= _EXACT * scale:
            return
        _turn(planes, C)
        times(n, C, planes.step, planes.direction)
        slope = dot(n, planes.residual, planes.direction)
        size, low, high = 1.0, 0.0, 0.0
        for _ in range(30):
            for i in range(n):
                trial[i] = f[i] + size * planes.step[i]
            _balance(planes, trial, w, C, dt)
            if dot(n, planes.residual, planes.direction) <= -0.5 * slope:
                break  # slope < 0: it may overshoot, but by less than it was short
            high = size
            size = 0.5 * (low + high)
        copy(n, trial, f)
        now = length(n, planes.residual)
        if now < minimum:
            minimum = now
            copy(planes.count, planes.pushes, planes.best)
    copy(planes.count, planes.best, planes.pushes)


@equation
def total(planes: Coupled, out: Floats) -> None:
    """The sum of all forces [N]."""
    for i in range(planes.n):
        out[i] = 0.0
    for k in range(planes.count):
        for i in range(planes.n):
            out[i] = out[i] + planes.pushes[k] * planes.normals[k][i]


@equation
def _balance(planes: Coupled, f: Reals, w: Reals, C: FloatRows, dt: float) -> None:
    """Compute the forces at the velocity that `f` [N] causes, and their difference from `f`."""
    n, residual = planes.n, planes.residual
    times(n, C, f, planes.vhat)
    for i in range(n):
        planes.vhat[i] = w[i] + planes.vhat[i]
        residual[i] = f[i]
    for k in range(planes.count):
        normal = planes.normals[k]
        u = dot(n, normal, planes.vhat)
        push, planes.rates[k] = force(planes.stiffnesses[k], planes.dampings[k], planes.depths[k], u, dt)
        planes.pushes[k] = push
        if push != 0.0:
            for i in range(n):
                residual[i] = residual[i] - push * normal[i]


@equation
def _turn(planes: Coupled, C: FloatRows) -> None:
    """Compute Newton's step of f: ``(I + sum k_i n_i n_i' C) step = -residual``."""
    n, rows, seen = planes.n, planes.rows, planes.direction
    for i in range(n):
        for j in range(n):
            rows[i][j] = 1.0 if i == j else 0.0
        rows[i][n] = -planes.residual[i]
    for k in range(planes.count):
        if planes.rates[k] != 0.0:
            normal = planes.normals[k]
            times(n, C, normal, seen)  # C is symmetric
            for i in range(n):
                factor = planes.rates[k] * normal[i]
                for j in range(n):
                    rows[i][j] = rows[i][j] + factor * seen[j]
    eliminate(n, 1, rows)
    for i in range(n):
        planes.step[i] = rows[i][n] / rows[i][i]


@equation
def eliminate(n: int, right: int, rows: FloatRows) -> None:
    """Make the first n columns diagonal, with pivots; the `right` columns after them are the right-hand sides."""
    for i in range(n):
        pivot = i
        for k in range(i + 1, n):
            if abs(rows[k][i]) > abs(rows[pivot][i]):
                pivot = k
        if pivot != i:
            for j in range(n + right):
                rows[i][j], rows[pivot][j] = rows[pivot][j], rows[i][j]
        top = rows[i]
        for k in range(n):
            if k != i:
                row = rows[k]
                factor = row[i] / top[i]
                if factor != 0.0:
                    for j in range(n + right):
                        row[j] = row[j] - factor * top[j]
