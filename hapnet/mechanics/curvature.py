"""How a surface bends, and where its tangent plane lies as seen from a place nearby."""

from __future__ import annotations

from math import hypot, sqrt
from operator import sub
from typing import NamedTuple

from hapnet.checks import Vector
from hapnet.records.vectors import inner

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


def tangent(normal: Vector, foot: Vector, curvatures: Curvatures, place: Vector) -> tuple[Vector, float]:
    """The normal of the surface's point nearest to `place` (n,) [m], and how deep `place` is behind it there [m].

    The surface has the unit `normal` (into the solid) at `foot` (n,) [m] and bends as `curvatures` say, one after the
    other: with kappa along e, ``q = 1 - kappa t``, ``p = kappa u``, ``h = sqrt(q^2 + p^2)``

        t = n . (place - foot),   u = e . (place - foot),
        t' = (2 t - kappa (t^2 + u^2)) / (1 + h),   n' = (q n - p e)/h

    which is the distance from a circle of radius 1/kappa, also for kappa = 0. Two of them make a torus: a ball if they
    are equal, a cylinder if one is 0, and to second order any surface.
    """
    away = tuple(map(sub, place, foot))
    depth: float = inner(normal, away)
    for direction, per_m in curvatures:
        bend = DEEPEST / depth if per_m * depth > DEEPEST else per_m
        along: float = inner(direction, away)
        q, p = 1.0 - bend * depth, bend * along
        h = sqrt(q * q + p * p)
        depth = (2.0 * depth - bend * (depth * depth + along * along)) / (1.0 + h)
        normal = tuple([(q * n - p * e) / h for n, e in zip(normal, direction, strict=True)])
    return normal, depth


def across(normal: Vector) -> tuple[Vector, ...]:
    """Unit vectors across the unit vector `normal` (n,) and one another: n - 1 of them, for one to three axes."""
    if len(normal) == 1:
        return ()
    if len(normal) == 2:
        return ((-normal[1], normal[0]),)
    x, y, z = normal
    minimum = min(range(3), key=lambda axis: abs(normal[axis]))
    a, b, c = [(0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)][minimum]
    size = hypot(a, b, c)
    a, b, c = a / size, b / size, c / size
    return ((a, b, c), (y * c - z * b, z * a - x * c, x * b - y * a))


def round_all_over(normal: Vector, radius: float) -> Curvatures:
    """Those of a ball of this radius [m] where its unit normal is `normal` (n,)."""
    return tuple([Curvature(direction, 1.0 / radius) for direction in across(normal)])
