"""A plane that the world sent, with the values that the device's local contact model derives from it."""

from __future__ import annotations

from collections.abc import Sequence

from hapnet.checks import Vector
from hapnet.mechanics.curvature import FLAT, Bends, copy_bends, see_tangent
from hapnet.mechanics.effects import Effects
from hapnet.mechanics.plane import Plane
from hapnet.records.record import PLANES, POINT_PLANES, FloatRows, OfAxes, Reals, Record, equation
from hapnet.records.vectors import copy, dot, times
from hapnet.units import POSE_AXES

SAME_M, SAME_COSINE, SAME_STIFFNESS = 1e-3, 0.95, 1.2
"""Two planes, sent one after the other, are the same surface if their differences are below these limits."""

MAX_EXTRAPOLATION_S = 0.2
"""The longest time for which a plane's motion is extrapolated [s]."""


class ContactPlane(Record):
    """A plane as sent for `position` [m], with values that depend on K'.

    Attributes
    ----------
    response : K'^-1 n [m/N]. softness : depth of the device per force, through the wall's spring and the virtual
        coupling [m/N]. bends : the surface's curvatures; foot : its point at which they hold [m].
    grip : excess of the static mu over the sliding mu. raised : the height of its grain [m].
    effects : of the surface (not in compiled code).
    """

    normal: OfAxes
    offset: float
    stiffness: float
    velocity: float
    response: OfAxes
    softness: float
    friction: float
    grip: float
    raised: float
    bends: Bends
    foot: OfAxes

    def __init__(self, plane: Plane, compliance: FloatRows, position: Vector) -> None:
        self.normal, self.offset = list(plane.normal), plane.offset_m
        self.stiffness, self.velocity = plane.stiffness, plane.velocity_mps
        self.response = [0.0] * len(self.normal)
        self.friction, self.bends, self.foot = plane.friction, FLAT, [0.0] * len(self.normal)
        self.effects = effects = Effects.of(plane.effects)
        self.grip, self.raised = max(0.0, effects.sticking - plane.friction) if effects else 0.0, 0.0
        if plane.curvatures:
            self.bends = Bends(plane.curvatures)
            stand_on(self, len(self.normal), position)
        understand(self, len(self.normal), compliance)

    def depth(self, position: Reals) -> float:
        """The depth of `position` [m] behind the plane as sent [m]."""
        return depth(self, len(self.normal), position)

    def withdrawn(self, reported: Sequence[ContactPlane], position: Vector, reach_m: float) -> bool:
        """Whether an answer rules this plane out; it has a proxy's position [m], and all planes within `reach_m`."""
        return withdrawn(self, reported, len(reported), len(self.normal), position, reach_m)

    def now(self, age: float) -> float:
        """The plane's present offset, without its grain [m]: a plane's motion is extrapolated for a while."""
        return now(self, age)


def no_planes(compliance: FloatRows, n: int) -> list[ContactPlane]:
    """Memory for planes with n axes."""
    return [ContactPlane(Plane((0.0,) * n, 0.0, 1.0, 0.0), compliance, (0.0,) * n) for _ in range(PLANES)]


@equation
def understand(one: ContactPlane, n: int, compliance: FloatRows) -> None:
    """Compute the values that follow from K'."""
    times(n, compliance, one.normal, one.response)
    one.softness = 1.0 / one.stiffness + dot(n, one.normal, one.response)


@equation
def stand_on(one: ContactPlane, n: int, position: Reals) -> None:
    """Set its foot to the point of the surface nearest to `position` [m]."""
    deep = depth(one, n, position)
    for i in range(n):
        one.foot[i] = position[i] + -deep * one.normal[i]


@equation
def see_from(one: ContactPlane, n: int, compliance: FloatRows, place: Reals, age: float, seen: ContactPlane) -> None:
    """The flat plane tangent to the surface at its point nearest to `place` [m], for this age of the plane [s]."""
    if not one.bends.count:
        copy_flat(one, n, seen)
        return
    moved = now(one, age) - one.offset
    for i in range(n):
        seen.foot[i] = one.foot[i] + moved * one.normal[i]
    deep = see_tangent(n, one.normal, seen.foot, one.bends, place, seen.normal)
    seen.offset = dot(n, seen.normal, place) - deep
    seen.stiffness, seen.velocity, seen.raised = one.stiffness, 0.0, one.raised
    seen.friction, seen.grip = one.friction, one.grip
    understand(seen, n, compliance)


@equation
def copy_flat(source: ContactPlane, n: int, target: ContactPlane) -> None:
    """Copy a plane, as if it were flat."""
    copy(n, source.normal, target.normal)
    copy(n, source.response, target.response)
    target.offset, target.stiffness = source.offset, source.stiffness
    target.velocity, target.softness = source.velocity, source.softness
    target.friction, target.grip, target.raised = source.friction, source.grip, source.raised


@equation
def copy_bent(source: ContactPlane, n: int, target: ContactPlane) -> None:
    """Copy a plane and its curvatures."""
    copy_flat(source, n, target)
    copy(n, source.foot, target.foot)
    copy_bends(n, source.bends, target.bends)


@equation
def depth(one: ContactPlane, n: int, position: Reals) -> float:
    """The depth of a position behind the plane as sent [m]: `ContactPlane.depth`."""
    return dot(n, one.normal, position) - one.offset


@equation
def now(one: ContactPlane, age: float) -> float:
    """The plane's present offset, without its grain [m]: `ContactPlane.now`."""
    if one.velocity == 0.0:
        return one.offset
    return one.offset + one.velocity * min(max(age, 0.0), MAX_EXTRAPOLATION_S)


@equation
def most_known(n: int) -> int:
    """The most planes that the model knows, for a device with n axes."""
    return PLANES if n == POSE_AXES else POINT_PLANES


@equation
def same(one: ContactPlane, other: ContactPlane, n: int, position: Reals) -> bool:
    """Whether these planes are about the same surface, for a proxy at `position` [m]."""
    apart = depth(one, n, position) - depth(other, n, position)
    alike = 1.0 / SAME_STIFFNESS < one.stiffness / other.stiffness < SAME_STIFFNESS
    return alike and abs(apart) < SAME_M and dot(n, one.normal, other.normal) > SAME_COSINE


@equation
def among(one: ContactPlane, others: Sequence[ContactPlane], count: int, n: int, position: Reals) -> bool:
    """Whether a plane is the same surface as any of the first `count` others."""
    found = False
    for j in range(count):
        found = found or same(one, others[j], n, position)
    return found


@equation
def withdrawn(
    one: ContactPlane, reported: Sequence[ContactPlane], count: int, n: int, position: Reals, reach_m: float
) -> bool:
    """Whether an answer rules this plane out, as in `ContactPlane.withdrawn`; always for a moving plane."""
    if one.velocity != 0.0 or -depth(one, n, position) <= reach_m:
        return True
    return among(one, reported, count, n, position)
