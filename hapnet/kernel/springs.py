"""The saturating spring and projections on its ellipsoids: `hapnet.mechanics.spring`, `hapnet.mechanics.ellipsoid`."""

from __future__ import annotations

import math

from hapnet.records.equation import equation
from hapnet.records.record import Floats, Matrix, Record, Vector

_MOST_ITERATIONS = 60
_INSIDE = 1.0 - 2.0**-50
_VANISHING = 1e-280


class Spring(Record):
    """`hapnet.mechanics.spring.Spring`. coupled : is K not diagonal? Then `columns` and `rows` are its eigenbasis."""

    dof: int
    K: Matrix
    knee: float
    knee_square: float
    coupled: int
    isotropic: int
    largest: float
    eigenvalues: Vector
    ratios: Vector
    weights: Vector
    columns: Matrix
    rows: Matrix
    u: Vector
    p: Vector


@equation
def square(spring: Spring, e: Floats) -> float:
    """``|e|_K^2``."""
    n = spring.dof
    if n == 1:
        return float(spring.K[0][0] * e[0] * e[0])
    total = 0.0
    if not spring.coupled:
        for i in range(n):
            total += spring.eigenvalues[i] * (e[i] * e[i])
        return total
    for k in range(n):
        u = 0.0
        for i in range(n):
            u += spring.columns[k][i] * e[i]
        total += spring.eigenvalues[k] * (u * u)
    return total


@equation
def of_square(spring: Spring, s2: float) -> float:
    """phi [J], given ``|e|_K^2``."""
    if s2 <= spring.knee_square:
        return 0.5 * s2
    return spring.knee * math.sqrt(s2) - 0.5 * spring.knee_square


@equation
def between(spring: Spring, ybar: Floats, x: Floats) -> float:
    """phi [J] of the spring that ties x to ybar."""
    if spring.dof == 1:
        e = x[0] - ybar[0]
        return of_square(spring, spring.K[0][0] * e * e)
    for i in range(spring.dof):
        spring.u[i] = x[i] - ybar[i]
    return of_square(spring, square(spring, spring.u))


@equation
def force(spring: Spring, x: Floats, ybar: Floats, out: Floats) -> None:
    """The spring's force on the device [N]."""
    n, e = spring.dof, spring.u
    for i in range(n):
        e[i] = x[i] - ybar[i]
    scale = -1.0
    s2 = square(spring, e)
    if s2 > spring.knee_square:
        scale = -spring.knee / math.sqrt(s2)
    if n == 1:
        out[0] = scale * spring.K[0][0] * e[0]
        return
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += spring.K[i][j] * e[j]
        out[i] = scale * total


@equation
def saturation(spring: Spring, x: Floats, ybar: Floats) -> float:
    """The share of the linear spring's force that it gives."""
    for i in range(spring.dof):
        spring.u[i] = x[i] - ybar[i]
    s2 = square(spring, spring.u)
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
    s2 = project(spring, e, radius)
    excess = 2.0**-52
    while of_square(spring, s2) > energy:
        s2 = project(spring, e, radius * (1.0 - excess))
        excess *= 2.0


@equation
def project(spring: Spring, e: Floats, radius: float) -> float:
    """Replace e by the nearest point with ``|p|_K <= radius``; returns its ``|p|_K^2``."""
    n = spring.dof
    bound = radius * radius
    s2 = square(spring, e)
    if s2 <= bound:
        return s2
    if bound < _VANISHING:
        for i in range(n):
            e[i] = 0.0
        return 0.0
    if spring.isotropic:
        scale = radius / math.sqrt(s2)
        for i in range(n):
            e[i] = scale * e[i]
    else:
        _secular(spring, e, radius * _INSIDE)
    s2 = square(spring, e)
    excess = 2.0**-52
    while s2 > bound:
        for i in range(n):
            e[i] = (1.0 - excess) * e[i]
        s2 = square(spring, e)
        excess *= 2.0
    return s2


@equation
def _secular(spring: Spring, e: Floats, radius: float) -> None:
    """`Ellipsoid._secular`, in place."""
    n, u, p = spring.dof, spring.u, spring.p
    for k in range(n):
        u[k] = e[k]
        if spring.coupled:
            u[k] = 0.0
            for i in range(n):
                u[k] += spring.columns[k][i] * e[i]
    mu = 0.0
    for _ in range(_MOST_ITERATIONS):
        total = slope = 0.0
        for k in range(n):
            scaled = u[k] / radius
            shrink = 1.0 / (spring.ratios[k] + mu)
            term = spring.weights[k] * (scaled * scaled) * shrink * shrink
            total += term
            slope += term * shrink
        step = (math.sqrt(total) - 1.0) * (total / slope)
        mu += step
        if step <= 1e-8 * mu:
            break
    for k in range(n):
        p[k] = u[k] * (spring.ratios[k] / (spring.ratios[k] + mu))
    for i in range(n):
        e[i] = p[i]
        if spring.coupled:
            e[i] = 0.0
            for k in range(n):
                e[i] += spring.rows[i][k] * p[k]
