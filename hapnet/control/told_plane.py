"""A plane that the world told, with what the device's local contact model needs of it."""

from __future__ import annotations

from collections.abc import Sequence
from operator import mul

from hapnet.checks import Vector
from hapnet.mechanics.curvature import Curvatures, tangent
from hapnet.mechanics.plane import Plane

SAME_M, SAME_COSINE, SAME_STIFFNESS = 1e-3, 0.95, 1.2
"""Two planes, told one after the other, are the same surface if they differ by less."""

LONGEST_EXTRAPOLATION_S = 0.2
"""For how long a plane is assumed to go on moving [s]."""


class ToldPlane:
    """A plane as told for `position` [m], with what follows from K'."""

    __slots__ = (
        "_compliance", "_foot", "curvatures", "friction", "normal", "offset", "response", "softness", "stiffness",
        "velocity",
    )  # fmt: skip

    def __init__(self, plane: Plane, compliance: Sequence[Vector], position: Vector) -> None:
        self.normal: Vector = plane.normal
        self.offset: float = plane.offset_m
        self.stiffness: float = plane.stiffness
        self.velocity: float = plane.velocity_mps
        self.friction: float = plane.friction
        self.curvatures: Curvatures = plane.curvatures
        self._compliance = compliance
        self._foot = along(position, self.normal, -self.depth(position)) if plane.curvatures else ()
        self.response: Vector = tuple([sum(map(mul, row, plane.normal)) for row in compliance])
        """K'^-1 n [m/N]."""
        self.softness: float = 1.0 / plane.stiffness + sum(map(mul, plane.normal, self.response))
        """Depth of the device per force, through the wall's spring and the virtual coupling [m/N]."""

    def depth(self, position: Vector) -> float:
        """How deep `position` [m] is behind the plane as told [m]."""
        along: float = sum(map(mul, self.normal, position))
        return along - self.offset

    def withdrawn(self, told: Sequence[ToldPlane], position: Vector, reach_m: float) -> bool:
        """Does a proxy at `position` [m] that tells these planes, and no others within `reach_m` [m], deny this one?

        A plane that moves is not remembered: nobody knows where it is by now.
        """
        if self.velocity or -self.depth(position) <= reach_m:
            return True
        return any(self.same(one, position) for one in told)

    def given(self, force: Vector) -> Vector:
        """By how much the virtual coupling gives way to `force` (n,) [N]: K'^-1 times it [m]."""
        return tuple([sum(map(mul, row, force)) for row in self._compliance])

    def same(self, other: ToldPlane, position: Vector) -> bool:
        """Is this the same surface, near enough, for a proxy at `position` [m]?"""
        apart = self.depth(position) - other.depth(position)
        alike = 1.0 / SAME_STIFFNESS < self.stiffness / other.stiffness < SAME_STIFFNESS
        return alike and abs(apart) < SAME_M and sum(map(mul, self.normal, other.normal)) > SAME_COSINE

    def now(self, age: float) -> float:
        """The plane's offset now [m]: a moving one goes on for a while."""
        if not self.velocity:
            return self.offset
        return self.offset + self.velocity * min(max(age, 0.0), LONGEST_EXTRAPOLATION_S)

    def seen_from(self, place: Vector, age: float) -> ToldPlane:
        """The flat plane that is tangent to the surface at this age [s] where it is nearest to `place` [m]."""
        if not self.curvatures:
            return self
        foot = along(self._foot, self.normal, self.now(age) - self.offset)
        normal, depth = tangent(self.normal, foot, self.curvatures, place)
        offset: float = sum(map(mul, normal, place)) - depth
        return ToldPlane(Plane(normal, offset, self.stiffness, 0.0, friction=self.friction), self._compliance, place)


def along(place: Vector, way: Vector, share: float) -> Vector:
    """`place` + `share` `way`."""
    return tuple([a + share * b for a, b in zip(place, way, strict=True)])
