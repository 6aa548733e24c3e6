"""The tangent planes of rigid solids near a place: at each solid's nearest point, with the curvatures there."""

from __future__ import annotations

from collections.abc import Sequence

from hapnet.checks import MOST_FRICTION, Vector
from hapnet.ext.solids.secant import Secant, farther_than, friction_of, near
from hapnet.ext.solids.shapes import near_form, put_bend, round_form
from hapnet.mechanics.curvature import Bends
from hapnet.records.record import OfAxes, Record, Wholes, equation
from hapnet.records.vectors import length as length_of

_OBLIQUE = 1e-6
"""If the part of a gradient along the axes is shorter by more than this, the axes cut the solid obliquely."""


class Sight(Record):
    """A solid's tangent plane, as `hapnet.mechanics.plane.Plane`. depth : of the place in the solid [m]."""

    depth: float
    normal: OfAxes
    offset: float
    stiffness: float
    damping: float
    friction: float
    bends: Bends


@equation
def see(secant: Secant, n: int, x: Vector, reach: float, sight: Sight) -> bool:
    """Whether the solid, cut by n axes, is within `reach` [m] of x (3,) [m]. If so, make its plane. Plain Python calls
    `Secant.tangents` instead: other solids may have several planes."""
    if farther_than(secant, reach, x):
        return False
    distance, gradient = near(secant, x)
    if distance > reach:
        return False
    sight.bends.count = 0
    if near_form(secant.form, x).gradient == gradient:  # else the front counts, but the back is nearer
        round_form(secant.form, gradient, sight.bends)
    return lay(secant, n, x, distance, gradient, sight)


@equation
def lay(secant: Secant, n: int, x: Vector, distance: float, gradient: Vector, sight: Sight) -> bool:
    """Make the tangent plane at this distance [m] from x (3,) [m], cut by n axes; the curvatures are in the sight.
    False: the axes do not cut it."""
    length = length_of(n, gradient)
    if length == 0.0:
        return False
    along = 0.0
    for i in range(n):
        sight.normal[i] = -gradient[i] / length
        along += sight.normal[i] * x[i]
    sight.depth, sight.offset = -distance, along + distance / length
    sight.stiffness, sight.damping = secant.stiffness, secant.damping
    sight.friction = min(friction_of(secant, x), MOST_FRICTION)
    if abs(length - 1.0) > _OBLIQUE:
        sight.bends.count = 0
    elif n < 3 and sight.bends.count:
        _cut(n, gradient, sight.bends)
    return True


@equation
def _cut(n: int, gradient: Vector, bends: Bends) -> None:
    """Reduce curvatures to n axes: with two axes there is one direction across the normal, with one axis none."""
    along, total = (-gradient[1], gradient[0], 0.0), 0.0
    for k in range(bends.count):
        direction = bends.directions[k]
        share = direction[0] * along[0] + direction[1] * along[1] + direction[2] * along[2]
        total += bends.per_m[k] * (share * share)
    bends.count = 0
    if n == 2:
        put_bend(bends, along, total)


@equation
def see_all(
    secants: Sequence[Secant], count: int, n: int, x: Vector, reach: float, sights: Sequence[Sight], order: Wholes
) -> int:
    """The number of solids within `reach` [m]; `order` gets the indices of their sights, the deepest first."""
    found = 0
    for k in range(count):
        if see(secants[k], n, x, reach, sights[found]):
            at = found
            while at > 0 and _is_before(n, sights[found], sights[order[at - 1]]):
                order[at] = order[at - 1]
                at -= 1
            order[at] = found
            found += 1
    return found


@equation
def _is_before(n: int, one: Sight, other: Sight) -> bool:
    if one.depth != other.depth:
        return one.depth > other.depth
    for i in range(n):
        if one.normal[i] != other.normal[i]:
            return one.normal[i] > other.normal[i]
    return one.offset > other.offset
