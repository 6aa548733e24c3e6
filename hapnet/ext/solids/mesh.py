"""A closed triangle mesh as a signed distance. libigl finds the nearest triangle; sign and gradient are computed here.

The nearest point c lies in a triangle, on an edge or at a corner. Where edges are sharp, the sign of ``(x - c) . n``
gives the side of x, if n is the pseudonormal there: the triangle's normal, the sum of the normals of the edge's two
triangles, or the sum of the normals around the corner, weighted by the angles (Baerentzen, Aanaes 2005). This is exact
for a closed mesh. Elsewhere the surface is the smooth patch of `hapnet.ext.solids.mesh_walk`.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.ext.solids.mesh_surface import SHARP_DEG, MeshSurface, Triangles
from hapnet.ext.solids.mesh_walk import EDGE, SMOOTH, follow, principal
from hapnet.ext.solids.shapes import Near
from hapnet.installing import require
from hapnet.mechanics.curvature import Curvature, Curvatures
from hapnet.records.machine_code import compiled
from hapnet.records.vectors import inner

_NOWHERE_M = 1e-12
"""For a nearer point the direction from the surface is undefined."""

_SCALE = float(1 << 17)
"""Rays are cast in units of 7.6 um: libigl treats a triangle whose determinant is below 1e-6 as parallel to the ray."""

_STRAIGHT_PER_M = 0.5
"""A curvature below that of a ball of 2 m counts as 0 [1/m]."""

_SAME_FACE = 0.999
"""Normals with this cosine or above belong to one face."""

_OBTUSE = 0.2
"""Two faces at a concave edge whose normals have a larger cosine count as one: behind both of them the nearest point
is used, since the second face would begin to act with some depth at once."""


class Foot(NamedTuple):
    """The nearest place of the surface, at least locally."""

    near: Near
    face: int  #: its triangle
    at: Vector  #: (3,) [m]
    kind: int  #: see `hapnet.ext.solids.mesh_walk`
    corner: int  #: 0 to 2: the corner, or the corner across from the edge


class Mesh:
    """A solid that a closed mesh bounds.

    vertices : (V, 3) [m]. triangles : (F, 3) indices of vertices, anticlockwise as seen from outside. sharp_deg :
        triangles that meet at a larger angle meet at an edge, others form a curved surface; 0: all are facets.

    Raises InvalidParameter: the mesh is empty or not closed. MissingLibrary: the extra `mesh` is not installed.
    """

    slope: float = 1.0

    def __init__(self, vertices: Array, triangles: Triangles, sharp_deg: float = SHARP_DEG) -> None:
        require("mesh", "a scene with a mesh")
        import igl

        vertices = np.ascontiguousarray(vertices, dtype=np.float64)
        triangles = np.ascontiguousarray(triangles, dtype=np.int64)
        self._surface = surface = MeshSurface.of(vertices, triangles, sharp_deg)
        self.vertices, self.triangles = surface.vertices, surface.triangles
        self._scaled = _SCALE * self.vertices
        self._tree = igl.AABB()
        self._tree.init(self._scaled, self.triangles)
        parts: Any = (
            surface.vertices, surface.triangles, surface.normals, surface.across, surface.rims, surface.pointed,
            surface.first, surface.ring, surface.flat,
        )  # fmt: skip
        self._follow: Any = compiled(follow)
        self._principal: Any = compiled(principal)
        plain = self._follow is follow
        self._parts = tuple([part.tolist() for part in parts]) if plain else parts
        self._bends: Any = surface.bends.tolist() if plain else surface.bends
        self._point, self._direction = np.zeros((1, 3)), np.zeros((1, 3))

    @property
    def curved(self) -> tuple[float, float]:
        """The share of the area that is felt as curved, and how far it is felt from the triangles, at most [m]."""
        return self._surface.curved()

    def near(self, position: Vector) -> Near:
        """Distance and gradient at `position` (3,) [m]."""
        return self.foot(position).near

    def foot(self, position: Vector, face: int | None = None) -> Foot:
        """The nearest place; with `face` the end of a walk that begins in that triangle."""
        x, y, z = position
        if face is None:
            self._point[0] = (_SCALE * x, _SCALE * y, _SCALE * z)
            face = self._tree.squared_distance(self._scaled, self.triangles, self._point)[1].item()
        face, kind, corner, a, b, c, p, q, r, distance = self._follow(*self._parts, face, x, y, z)
        if kind == SMOOTH:
            return Foot(Near(distance, (p, q, r)), face, (a, b, c), kind, corner)
        p, q, r = normal = self._pseudonormal(face, kind, corner)
        if distance < _NOWHERE_M:
            return Foot(Near(0.0, normal), face, (a, b, c), kind, corner)
        x, y, z = x - a, y - b, z - c
        signed = distance if x * p + y * q + z * r >= 0.0 else -distance
        return Foot(Near(signed, (x / signed, y / signed, z / signed)), face, (a, b, c), kind, corner)

    def struck(self, place: Vector, path: Vector) -> Foot | None:
        """The first point of a triangle, from either side, on the straight `path` (3,) from `place` [m], or None."""
        self._point[0] = [_SCALE * part for part in place]
        self._direction[0] = [_SCALE * part for part in path]
        faces, shares, _ = self._tree.intersect_ray_first(self._scaled, self.triangles, self._point, self._direction)
        face, share = faces.item(), shares.item()
        if face < 0 or not share <= 1.0:
            return None
        return self.foot(tuple([a + share * b for a, b in zip(place, path, strict=True)]), face)

    def seen(self, place: Vector, paths: Array) -> list[tuple[int, float]]:
        """For straight `paths` (N, 3) from `place` [m]: the first triangle on each path, and the path's share there.

        Triangle -1 and share 1: the path meets none.
        """
        start = np.repeat([[_SCALE * part for part in place]], len(paths), axis=0)
        faces, shares, _ = self._tree.intersect_ray_first(self._scaled, self.triangles, start, _SCALE * paths)
        return [
            (face, share) if face >= 0 and share <= 1.0 else (-1, 1.0)
            for face, share in zip(faces.tolist(), shares.tolist(), strict=True)
        ]

    def facet(self, face: int) -> Vector:
        """A triangle's unit normal."""
        normal: Vector = tuple(self._surface.facets[face].tolist())
        return normal

    def faces(self, foot: Foot) -> list[Vector]:
        """The unit normals of the faces that meet at the foot of a proxy behind a concave edge or corner; empty if they
        count as one.
        """
        if foot.kind == SMOOTH or foot.near.distance_m >= 0.0:
            return []
        surface, face = self._surface, foot.face
        if foot.kind == EDGE:
            if surface.rims[face, foot.corner] != -1:
                return []
            around = [face, surface.across[face, foot.corner].item()]
        else:
            vertex = surface.triangles[face, foot.corner]
            around = surface.ring[surface.first[vertex] : surface.first[vertex + 1]].tolist()
        found: list[Vector] = []
        for normal in map(tuple, surface.facets[around].tolist()):
            if all(inner(normal, other) < _SAME_FACE for other in found):
                found.append(normal)
        obtuse = any(inner(one, other) > _OBTUSE for i, one in enumerate(found) for other in found[:i])
        return [] if obtuse else found

    def curvatures(self, position: Vector) -> Curvatures:
        """The curvatures of the surface at the nearest place."""
        return self.curvatures_at(self.foot(position))

    def curvatures_at(self, foot: Foot) -> Curvatures:
        if foot.kind != SMOOTH:
            return ()
        one, a, b, c, other, p, q, r = self._principal(self._bends, foot.face, *foot.near.gradient)
        found = (Curvature((a, b, c), one), Curvature((p, q, r), other))
        if abs(one) >= _STRAIGHT_PER_M <= abs(other):
            return found
        return tuple([bend for bend in found if abs(bend.per_m) >= _STRAIGHT_PER_M])

    def _pseudonormal(self, face: int, kind: int, corner: int) -> Vector:
        """The unit normal of the edge or corner."""
        surface = self._surface
        if kind == EDGE:
            normal = surface.facets[face] + surface.facets[surface.across[face, corner]]
        else:
            normal = surface.pseudonormals[surface.triangles[face, corner]]
        x, y, z = normal.tolist()
        size = sqrt(x * x + y * y + z * z)
        return (x / size, y / size, z / size) if size else (1.0, 0.0, 0.0)
