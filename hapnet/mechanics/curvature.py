"""How a surface bends, and where its tangent plane lies as seen from a place nearby."""

from __future__ import annotations

from math import sqrt
from typing import Annotated, NamedTuple

from hapnet.checks import MOST_CURVATURES, Vector
from hapnet.records.record import AXES, FloatRows, Floats, Reals, Record, equation
from hapnet.records.vectors import copy, length

DEEPEST = 0.5
"""Farther in than this share of a bend's radius, the surface is taken as flatter, so that it never folds."""


class Curvature(NamedTuple):
    """How a surface bends along one of its principal directions.

    direction : a unit vector (n,) in the tangent plane. per_m : 1/radius [1/m]; above 0 the solid bulges, as a ball
    does, below 0 it is hollow.
    """

    direction: Vector
    per_m: float


Curvatures = tuple[Curvature, ...]
"""At most two, across one another. None: the surface is flat, or nobody knows."""


class Bends(Record):
    """`Curvatures` as equations have them: the first `count` directions (n,), and the curvature along each [1/m]."""

    count: int
    directions: Annotated[FloatRows, (MOST_CURVATURES, AXES)]
    per_m: Annotated[Floats, (MOST_CURVATURES,)]

    def __init__(self, curvatures: Curvatures) -> None:
        self.count = len(curvatures)
        self.directions = [list(direction) for direction, _ in curvatures]
        self.per_m = [per_m for _, per_m in curvatures]

    @property
    def curvatures(self) -> Curvatures:
        """As a plane has them."""
        pairs = zip(self.directions[: self.count], self.per_m[: self.count], strict=True)
        return tuple([Curvature(tuple(direction), per_m) for direction, per_m in pairs])


FLAT = Bends(())
"""None. Nobody writes into it."""


@equation
def copy_bends(n: int, source: Bends, target: Bends) -> None:
    """Copy them, in n axes."""
    target.count = source.count
    for k in range(source.count):
        copy(n, source.directions[k], target.directions[k])
        target.per_m[k] = source.per_m[k]


def tangent(normal: Vector, foot: Vector, curvatures: Curvatures, place: Vector) -> tuple[Vector, float]:
    """The normal of the surface's point nearest to `place` (n,) [m], and how deep `place` is behind it there [m].

    The surface has the unit `normal` (into the solid) at `foot` (n,) [m] and bends as `curvatures` say, one after the
    other: with kappa along e, ``q = 1 - kappa t``, ``p = kappa u``, ``h = sqrt(q^2 + p^2)``

        t = n . (place - foot),   u = e . (place - foot),
        t' = (2 t - kappa (t^2 + u^2)) / (1 + h),   n' = (q n - p e)/h

    which is the distance from a circle of radius 1/kappa, also for kappa = 0. Two of them make a torus: a ball if they
    are equal, a cylinder if one is 0, and to second order any surface.
    """
    found = [0.0] * len(normal)
    depth = see_tangent(len(normal), normal, foot, Bends(curvatures), place, found)
    return tuple(found), depth


@equation
def see_tangent(n: int, normal: Reals, foot: Reals, bends: Bends, place: Reals, found: Floats) -> float:
    """`tangent`: how deep `place` is; the normal goes into `found`."""
    depth = 0.0
    for i in range(n):
        found[i] = normal[i]
        depth += normal[i] * (place[i] - foot[i])
    for k in range(bends.count):
        direction, per_m = bends.directions[k], bends.per_m[k]
        bend = DEEPEST / depth if per_m * depth > DEEPEST else per_m
        along = 0.0
        for i in range(n):
            along += direction[i] * (place[i] - foot[i])
        q, p = 1.0 - bend * depth, bend * along
        h = sqrt(q * q + p * p)
        depth = (2.0 * depth - bend * (depth * depth + along * along)) / (1.0 + h)
        for i in range(n):
            found[i] = (q * found[i] - p * direction[i]) / h
    return depth


def across(normal: Vector) -> tuple[Vector, ...]:
    """Unit vectors across the unit vector `normal` (n,) and one another: n - 1 of them, for one to three axes."""
    if len(normal) == 1:
        return ()
    if len(normal) == 2:
        return ((-normal[1], normal[0]),)
    return across_in_space(normal)


@equation
def across_in_space(normal: Vector) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """`across` for three axes."""
    x, y, z = normal[0], normal[1], normal[2]
    if abs(x) <= abs(y) and abs(x) <= abs(z):
        a, b, c = 0.0, -z, y
    elif abs(y) <= abs(z):
        a, b, c = z, 0.0, -x
    else:
        a, b, c = -y, x, 0.0
    size = length(3, (a, b, c))
    a, b, c = a / size, b / size, c / size
    return (a, b, c), (y * c - z * b, z * a - x * c, x * b - y * a)


def round_all_over(normal: Vector, radius: float) -> Curvatures:
    """Those of a ball of this radius [m] where its unit normal is `normal` (n,)."""
    return tuple([Curvature(direction, 1.0 / radius) for direction in across(normal)])
