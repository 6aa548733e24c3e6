"""Rigid solids as seen from a place: the tangent plane at each one's nearest point, and how it bends there."""

from __future__ import annotations

from collections.abc import Sequence

from hapnet.checks import MOST_FRICTION, Vector
from hapnet.ext.solids.secant import Secant, farther_than, friction_of, near
from hapnet.ext.solids.shapes import near_form, put_bend, round_form
from hapnet.mechanics.curvature import Bends
from hapnet.records.record import OfAxes, Record, Wholes, equation
from hapnet.records.vectors import length as length_of

_OBLIQUE = 1e-6
"""A gradient whose part along the axes is shorter by more belongs to a solid that is cut obliquely."""


class Sight(Record):
    """A solid's tangent plane, as `hapnet.mechanics.plane.Plane`. depth : how deep the place is in the solid [m]."""

    depth: float
    normal: OfAxes
    offset: float
    stiffness: float
    damping: float
    friction: float
    bends: Bends


@equation
def see(secant: Secant, n: int, x: Vector, reach: float, sight: Sight) -> bool:
    """Whether the solid is within `reach` [m] of x (3,) [m], as it is cut by n axes. Then its plane is made. As
    `Secant.tangents`, which Python asks: other solids may have several."""
    if farther_than(secant, reach, x):
        return False
    distance, gradient = near(secant, x)
    if distance > reach:
        return False
    sight.bends.count = 0
    if near_form(secant.form, x).gradient == gradient:  # else the front is what counts, and the back is nearer
        round_form(secant.form, gradient, sight.bends)
    return lay(secant, n, x, distance, gradient, sight)


@equation
def lay(secant: Secant, n: int, x: Vector, distance: float, gradient: Vector, sight: Sight) -> bool:
    """The tangent plane at this distance [m] from x (3,) [m], as it is cut by n axes; the sight knows how the surface
    bends. False: it is not cut."""
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
    """With two axes a surface bends along the one direction across its normal, with one not at all."""
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
    """How many of the solids are within `reach` [m]; `order` has the places of their sights, the deepest first."""
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
