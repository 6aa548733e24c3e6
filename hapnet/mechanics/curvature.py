"""The curvatures of a surface, and its tangent plane at the point nearest to a given place."""

from __future__ import annotations

from math import sqrt
from typing import Annotated, NamedTuple

from hapnet.checks import MOST_CURVATURES, Vector
from hapnet.records.record import AXES, FloatRows, Floats, Reals, Record, equation
from hapnet.records.vectors import copy, length

DEEPEST = 0.5
"""At depths above this share of the radius of curvature, the surface is treated as flatter, so that it never folds."""


class Curvature(NamedTuple):
    """The curvature of a surface along a principal direction.

    direction : a unit vector (n,) in the tangent plane. per_m : 1/radius [1/m]; above 0 the solid is convex, like a
    ball, below 0 it is concave.
    """

    direction: Vector
    per_m: float


Curvatures = tuple[Curvature, ...]
"""At most two, perpendicular to one another. Empty: the surface is flat, or its curvatures are unknown."""


class Bends(Record):
    """`Curvatures` for equations: the first `count` directions (n,), and the curvature along each [1/m]."""

    count: int
    directions: Annotated[FloatRows, (MOST_CURVATURES, AXES)]
    per_m: Annotated[Floats, (MOST_CURVATURES,)]

    def __init__(self, curvatures: Curvatures) -> None:
        self.count = len(curvatures)
        self.directions = [list(direction) for direction, _ in curvatures]
        self.per_m = [per_m for _, per_m in curvatures]

    @property
    def curvatures(self) -> Curvatures:
        """The same `Curvatures`, for a `Plane`."""
        pairs = zip(self.directions[: self.count], self.per_m[: self.count], strict=True)
        return tuple([Curvature(tuple(direction), per_m) for direction, per_m in pairs])


FLAT = Bends(())
"""No curvatures. It is shared, so never write into it."""


@equation
def copy_bends(n: int, source: Bends, target: Bends) -> None:
    """Copy the curvatures `source` to `target`, for n axes."""
    target.count = source.count
    for k in range(source.count):
        copy(n, source.directions[k], target.directions[k])
        target.per_m[k] = source.per_m[k]


def tangent(normal: Vector, foot: Vector, curvatures: Curvatures, place: Vector) -> tuple[Vector, float]:
    """The normal at the surface's point nearest to `place` (n,) [m], and the depth of `place` behind the surface [m].

    The surface has the unit `normal` (into the solid) at `foot` (n,) [m]. The curvatures are applied one after the
    other: with kappa along e, ``q = 1 - kappa t``, ``p = kappa u``, ``h = sqrt(q^2 + p^2)``

        t = n . (place - foot),   u = e . (place - foot),
        t' = (2 t - kappa (t^2 + u^2)) / (1 + h),   n' = (q n - p e)/h

    which is the distance from a circle of radius 1/kappa, also for kappa = 0. Two curvatures make a torus: a ball if
    they are equal, a cylinder if one is 0, and to second order any surface.
    """
    tangent_normal = [0.0] * len(normal)
    depth = see_tangent(len(normal), normal, foot, Bends(curvatures), place, tangent_normal)
    return tuple(tangent_normal), depth


@equation
def see_tangent(n: int, normal: Reals, foot: Reals, bends: Bends, place: Reals, found: Floats) -> float:
    """`tangent`: returns the depth of `place`; the normal goes into `found`."""
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
    """The n - 1 unit vectors perpendicular to the unit vector `normal` (n,) and to one another, for n up to 3."""
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
    """The curvatures of a ball of this radius [m] at the point with the unit normal `normal` (n,)."""
    return tuple([Curvature(direction, 1.0 / radius) for direction in across(normal)])
