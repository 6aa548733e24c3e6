"""A mesh near the proxy: the foot that stays on the surface that was entered, and the planes that meet there.

While the proxy is in contact, its foot walks over the mesh (`hapnet.ext.solids.mesh_walk`), so the solid may be thin
and other surfaces may lie behind it. It enters where its path first meets the mesh, however long the step is.

A foot at a concave edge has a plane for each face. If a step leads from one face behind another, the other face's plane
is found at the end of the foot's walk.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, dist, hypot, pi, sin

import numpy as np

from hapnet.checks import MOST_PLANES, Array, Vector
from hapnet.ext.solids.friction import Friction
from hapnet.ext.solids.mesh import Foot, Mesh
from hapnet.ext.solids.mesh_walk import SMOOTH
from hapnet.ext.solids.secant import (
    Hit,
    Secant,
    Tangent,
    along,
    dot,
    enter,
    friction_now,
    note,
    put,
    put_opposite,
    turned,
)  # fmt: skip
from hapnet.ext.solids.shapes import Near, Shape, triple
from hapnet.mechanics.curvature import Curvatures, across, tangent
from hapnet.records.vectors import added

_OTHERS = 2
"""Further faces: a proxy touches up to three faces at once."""

_SAME_SIDE = 0.64
"""Normals with a greater cosine (50 degrees) belong to one curved surface."""

_LITTLE = 0.05
"""If the last step's plane turned by less, the next plane is assumed to turn as much: then it mostly needs no
correction."""

_TURNS_LITTLE = 0.87
"""Cosine of 30 degrees."""

_TOUCHES_M = 1e-9

_CLEAR_M = 1e-4
"""At this distance in front of a smooth patch none of its facets is in the way."""

_AROUND_M, _LIFT_M, _RAYS = 0.015, 0.0005, 8
"""Search for faces beside the foot: reach, distance of its origin in front of the foot, number of directions."""

_STILL_M = 0.0005
"""Distance that a proxy may move over the same triangle before this search is repeated."""

_GHOST_M = 0.0003
"""A plane is left out if a free place of the proxy is this deep behind it..."""

_HALF_AS_FAR, _NEARBY_M = 1.5, 0.002
"""... within this range: not much farther away than the plane itself."""


class FootSecant(Secant):
    """A mesh near the proxy. `others` are the planes of further faces; they follow it in a list of all planes."""

    def __init__(self, mesh: Mesh, stiffness: float, damping: float, friction: float | Friction) -> None:
        super().__init__(mesh, stiffness, damping, friction)
        self._mesh = mesh
        self._face: int | None = None  # of the foot at the last onset, or where the step enters; None: free
        self._next: int | None = None  # face that it may have entered after leaving
        self._at: Vector | None = None  # the place whose foot is `_foot`
        self._foot: Foot | None = None
        self._walked = False  # True: a walk found it
        self._slides = False  # True: it was on a smooth patch at the last onset
        self._from: Vector = (0.0, 0.0, 0.0)  # a point of the plane
        self._there: tuple[int, int, int] | None = None  # the foot at the last search for faces beside it...
        self._looked: Vector = (0.0, 0.0, 0.0)  # ... the proxy's place...
        self._seen: list[_Plane] = []  # ... and the planes found
        self.more: list[tuple[Vector, Vector]] = []
        """Faces that the proxy is, or would be, behind at once: the normal out of the solid, and a point."""
        self.others: tuple[FaceBeside, ...] = tuple([FaceBeside(self) for _ in range(_OTHERS)])

    def near(self, x: Vector) -> Near:
        return self.foot(x).near

    def foot(self, x: Vector) -> Foot:
        """The foot of `x` [m]; in contact it is found by a walk from the last foot."""
        if self._at == x and self._foot is not None:
            return self._foot
        self._foot = foot = self._mesh.foot(x, self._face)
        self._at, self._walked = x, self._face is not None
        note(self.known, x, foot.near)
        return foot

    def farther_than(self, reach: float, x: Vector) -> bool:
        return not self._walked and super().farther_than(reach, x)

    def tangents(self, x: Vector, reach: float, dof: int) -> list[Tangent]:
        if self.farther_than(reach, x):
            return []
        foot = self.foot(x)
        if self._walked and foot.near.distance_m > 0.0:
            foot = self._mesh.foot(x)
        if foot.near.distance_m > reach:
            return []
        planes = [_Plane(normal, foot.at, ()) for normal in self._mesh.faces(foot)]
        if not planes:
            planes = [_Plane(foot.near.gradient, foot.at, self._mesh.curvatures_at(foot))]
        if foot.near.distance_m < min(reach, _AROUND_M) and dof > 1:
            planes += self._beside(x, foot, planes, dof)
        return [Tangent(dot(one.normal, _less(x, one.at)), one.normal, one.curvatures) for one in planes]

    # -- its planes in a step -----------------------------------------------------------------------------------------

    def meets(self, x: Vector, delta: Vector, length: float) -> bool:
        self.more = []
        if self._face is None and self.farther_than(length, x):
            return False
        foot = self.foot(x)
        if self._walked and foot.near.distance_m > 0.0:  # it has left where it was
            self._face, self._at = self._next, None
            foot = self.foot(x)
            if self._next is not None and foot.near.distance_m > 0.0:
                self._face = self._at = None
                foot = self.foot(x)
        self._next = None
        self.rounds = 0
        if self.varies:
            self.friction = friction_now(self, x)
        if foot.near.distance_m <= 0.0:
            self._face, self.entering = foot.face, 0
            self._begin(x, foot)
            self._slides = foot.kind == SMOOTH
            return True
        self._face, self._slides = None, False
        self._starts(foot.near)
        if foot.near.distance_m > length or not (entry := self.hit(x, delta, length)).found:
            return False
        self.entering = 1
        self._from = along(entry.at, entry.near.gradient, -entry.near.distance_m)
        enter(self, x, entry.at, entry.near)
        return True

    def _starts(self, near: Near) -> None:
        self.start_m = near.distance_m
        put(self.start, near.gradient)

    def _begin(self, x: Vector, foot: Foot) -> None:
        """The planes at an onset inside."""
        start = foot.near
        if foot.kind != SMOOTH:
            away = _less(foot.at, x)
            faces = sorted([(dot(normal, away), normal) for normal in self._mesh.faces(foot)], reverse=True)
            if faces and faces[0][0] > 0.0:
                start = Near(-faces[0][0], faces[0][1])
                self.more = [(normal, foot.at) for deep, normal in faces[1:] if deep > 0.0]
        self._from = foot.at
        self.depth = -start.distance_m
        a, b, c = start.gradient
        if self._slides and foot.kind == SMOOTH:
            (d, e, f), (p, q, r) = self.start, self.normal
            d, e, f = d + p, e + q, f + r
            if d * d + e * e + f * f < _LITTLE * _LITTLE:
                a, b, c = a - d, b - e, c - f
        self._starts(start)
        put_opposite(self.normal, (a, b, c))

    def hit(self, x: Vector, direction: Vector, length: float) -> Hit:
        struck = self._mesh.struck(x, direction)
        if struck is None or dot(struck.near.gradient, direction) >= 0.0:  # at most the smooth patch was entered
            entry = super().hit(x, direction, length)
            self._face, self._at = (self._mesh.foot(entry.at).face if entry.found else None), None
            return entry
        self._face, self._at = struck.face, None
        end = along(x, direction, 1.0)
        after = self.foot(end)
        inside = after.near.distance_m < 0.0 and dot(after.near.gradient, _less(x, after.at)) >= 0.0
        if inside and dot(after.near.gradient, direction) < 0.0 and not self._mesh.faces(after):
            return Hit(True, end, after.near)
        return Hit(True, struck.at, Near(0.0, struck.near.gradient))

    def correct(self, x: Vector, delta: Vector, end: Vector, good: float) -> bool:
        found = self._ahead(end)
        if found is None or (self.entering and self._is_beyond(x, found.gradient)):
            return False
        return turned(self, x, delta, end, found, good)

    def _is_beyond(self, x: Vector, gradient: Vector) -> bool:
        """Whether the surface entered at `x` faces another side at the step's end, as beyond an edge."""
        if self._foot is None or dot(gradient, triple(self.normal)) < -_TURNS_LITTLE:
            return False
        return dot(gradient, _less(x, self._foot.at)) < 0.0

    def _ahead(self, end: Vector) -> Near | None:
        """Distance and gradient of the plane's face at the step's end; None: the proxy has left this face."""
        foot = self.foot(end)
        distance, (a, b, c) = foot.near
        self.more, self._next = [], None
        if distance >= 0.0:
            self._look_out(end)
        elif foot.kind != SMOOTH and (faces := self._mesh.faces(foot)):
            self.more = [(face, foot.at) for face in faces]
            return self.facing(end, triple(self.normal))
        else:
            p, q, r = self.normal
            if a * p + b * q + c * r > -_SAME_SIDE and self._is_hollow((a, b, c), foot.at):
                self.more = [((a, b, c), foot.at)]
                return None
        return foot.near

    def _look_out(self, end: Vector) -> None:
        """Find another surface on the path of a step that leaves this surface: the step may end behind the other."""
        start = along(self._from, triple(self.normal), -_CLEAR_M)
        path = _less(end, start)
        struck = self._mesh.struck(start, path)
        if struck is not None and dot(struck.near.gradient, path) < 0.0:
            self.more = [(struck.near.gradient, struck.at)]
            self._next = struck.face

    def facing(self, end: Vector, normal: Vector) -> Near | None:
        """Distance and gradient at the step's end of the face with `normal`, among the faces that meet there; None: the
        proxy has left them.
        """
        gradient, at = min(self.more, key=lambda face: dot(face[0], normal))
        return Near(dot(gradient, _less(end, at)), gradient) if dot(gradient, normal) < -_SAME_SIDE else None

    def _is_hollow(self, gradient: Vector, at: Vector) -> bool:
        """Whether the surface rises from this plane to that one."""
        rise = _less(at, self._from)
        return dot(gradient, rise) < _TOUCHES_M and dot(triple(self.normal), rise) < _TOUCHES_M

    def further(self, x: Vector) -> Near | None:
        """A face without a plane that the proxy is behind, or ends behind: its distance from `x`, and gradient."""
        used = [triple(one.normal) for one in (self, *self.others) if one is self or one.met]
        for gradient, at in self.more:
            if all(dot(gradient, normal) > -_SAME_SIDE for normal in used) and self._is_hollow(gradient, at):
                distance = dot(gradient, _less(x, at))
                return Near(distance if at == self._from else max(0.0, distance), gradient)
        return None

    # -- planes for the device ----------------------------------------------------------------------------------------

    def _beside(self, x: Vector, foot: Foot, known: Sequence[_Plane], dof: int) -> list[_Plane]:
        """The planes of `_around`; its last result if the proxy is still near that place."""
        there = foot.face, foot.kind, foot.corner
        if there != self._there or dist(x, self._looked) > _STILL_M:
            self._there, self._looked = there, x
            self._seen = self._around(x, foot, known, dof)
        return self._seen

    def _around(self, x: Vector, foot: Foot, known: Sequence[_Plane], dof: int) -> list[_Plane]:
        """The planes of the faces that a proxy at `x` would hit, if it moved along the surface or away from it.

        The rays start just in front of the foot, so nothing hides these faces. A plane is a ghost, and left out, if a
        free place lies behind it.
        """
        middle = _unit([added(parts) for parts in zip(*[one.normal for one in known], strict=True)])
        place = x if foot.near.distance_m > _LIFT_M else along(foot.at, middle, _LIFT_M)
        paths = _AROUND_M * _directions([one.normal for one in known], middle, dof)
        seen = self._mesh.seen(place, paths)
        found = sorted([(share, face, tuple(path)) for path, (face, share) in zip(paths.tolist(), seen, strict=True)])
        planes = list(known)
        for share, face, path in found:
            if share == 1.0 or len(planes) == MOST_PLANES:
                break
            one = self._plane_at(along(place, path, share), face)
            if dot(one.normal, path) >= 0.0 or any(_covers(other, one) for other in planes):
                continue
            most = _HALF_AS_FAR * share + _NEARBY_M / _AROUND_M
            free = [along(place, direction, min(most, until)) for until, _, direction in found]
            if any(one.depth(there) > _GHOST_M for there in [*free, *[other.at for other in planes]]):
                continue
            planes.append(one)
        return planes[len(known) :]

    def _plane_at(self, place: Vector, face: int) -> _Plane:
        foot = self._mesh.foot(place, face)
        if foot.kind == SMOOTH:
            return _Plane(foot.near.gradient, foot.at, self._mesh.curvatures_at(foot))
        return _Plane(self._mesh.facet(face), place, ())


class FaceBeside(Secant):
    """The plane of a further face of a mesh, in the steps in which there is one."""

    def __init__(self, owner: FootSecant) -> None:
        super().__init__(owner.shape, owner.stiffness, owner.damping, 0.0)
        self._owner = owner

    def farther_than(self, reach: float, x: Vector) -> bool:
        """Always true: the mesh's own secant returns all planes."""
        return True

    def meets(self, x: Vector, delta: Vector, length: float) -> bool:
        owner = self._owner
        if not owner.more or (near := owner.further(x)) is None:
            return False
        self.friction, self.rounds = owner.friction, 0
        self.start_m, self.depth, self.entering = near.distance_m, -near.distance_m, int(near.distance_m >= 0.0)
        put(self.start, near.gradient)
        put_opposite(self.normal, near.gradient)
        return True

    def correct(self, x: Vector, delta: Vector, end: Vector, good: float) -> bool:
        found = self._owner.facing(end, triple(self.normal)) if self._owner.more else None
        return found is not None and turned(self, x, delta, end, found, good)


def secants_of(shape: Shape, stiffness: float, damping: float, friction: float | Friction) -> tuple[Secant, ...]:
    """Return the secants that hold the contact with a solid of this shape."""
    if not isinstance(shape, Mesh):
        return (Secant(shape, stiffness, damping, friction),)
    foot = FootSecant(shape, stiffness, damping, friction)
    return (foot, *foot.others)


class _Plane:
    """A tangent plane: the normal out of the solid, a point, and the curvatures there."""

    def __init__(self, normal: Vector, at: Vector, curvatures: Curvatures) -> None:
        self.normal, self.at, self.curvatures = normal, at, curvatures
        a, b, c = normal
        self._into = (-a, -b, -c)

    def depth(self, place: Vector) -> float:
        """The depth of `place` behind the plane [m]."""
        return tangent(self._into, self.at, self.curvatures, place)[1]

    def normal_at(self, place: Vector) -> Vector:
        a, b, c = tangent(self._into, self.at, self.curvatures, place)[0]
        return (-a, -b, -c)


def _covers(known: _Plane, one: _Plane) -> bool:
    """Whether the `known` plane already covers plane `one`, or `one` lies behind it."""
    depth = known.depth(one.at)
    return depth > _GHOST_M or (depth > -_GHOST_M and dot(known.normal_at(one.at), one.normal) > 0.9)


def _directions(normals: Sequence[Vector], middle: Vector, dof: int) -> Array:
    """Directions away from the surface, and along it."""
    if dof == 2:
        a, b, _ = middle
        return np.array([*normals, (-b, a, 0.0), (b, -a, 0.0)])
    one, other = across(middle)
    turns = [2.0 * pi * k / _RAYS for k in range(_RAYS)]
    return np.array([*normals, *[[cos(t) * p + sin(t) * q for p, q in zip(one, other, strict=True)] for t in turns]])


def _unit(vector: Sequence[float]) -> Vector:
    size = hypot(*vector)
    return tuple([part / size for part in vector])


def _less(one: Vector, other: Vector) -> Vector:
    return (one[0] - other[0], one[1] - other[1], one[2] - other[2])
