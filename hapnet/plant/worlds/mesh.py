"""A closed triangle mesh as a signed distance. The nearest point is libigl's; sign and gradient are made here.

The nearest point c lies in a triangle, on an edge or at a corner. The sign of ``(x - c) . n`` says on which side x is,
if n is the pseudonormal there: the triangle's normal, the sum of those of the edge's two triangles, or the sum of those
around the corner, weighted by their angles (Baerentzen, Aanaes 2005). That is exact for a closed mesh.

A query takes about as long as a whole step at a flat wall. So contact takes the tangent plane within `flat_m` of the
last query. That is less than an encoder's count (55 um), and than facets usually differ from the surface that is meant.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from math import dist, sqrt

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array, Vector
from hapnet.errors import InvalidParameter, MissingLibrary
from hapnet.plant.worlds.shapes import Near
from hapnet.records.vectors import inner

Triangles = NDArray[np.int64]

_FLAT = 1e-9
"""The nearest point is inside its triangle if the direction to it differs from the normal by less, as a share."""

_ON_EDGE = 1e-7
"""A barycentric coordinate below this is zero."""

_NOWHERE_M = 1e-12
"""A point that is nearer has no direction from the surface."""


class Mesh:
    """A solid that a closed mesh bounds.

    vertices : (V, 3) [m]. triangles : (F, 3) indices of vertices, anticlockwise as seen from outside.

    Raises InvalidParameter: the mesh is empty or not closed. MissingLibrary: the extra `mesh` is not installed.
    """

    slope: float = 1.0
    flat_m: float = 5e-5

    def __init__(self, vertices: Array, triangles: Triangles) -> None:
        self.vertices: Array = np.ascontiguousarray(vertices, dtype=np.float64)
        self.triangles: NDArray[np.int64] = np.ascontiguousarray(triangles, dtype=np.int64)
        require_closed(self.triangles)
        try:
            import igl
        except ImportError:
            raise MissingLibrary("a scene with a mesh", "libigl trimesh", "mesh") from None
        tree = igl.AABB()
        tree.init(self.vertices, self.triangles)
        self._search = partial(tree.squared_distance, self.vertices, self.triangles)
        corners = self.vertices[self.triangles]
        doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        sizes = np.linalg.norm(doubled, axis=1)
        self._normals = doubled / np.where(sizes, sizes, 1.0)[:, None]
        self._normal_of: list[Vector] = [tuple(row) for row in self._normals.tolist()]
        self._corner_normals = _corner_normals(self.vertices, self.triangles, self._normals)
        self._edge_normals = _edge_normals(self.triangles, self._normals)
        self._point = np.zeros((1, 3))

    def near(self, position: Vector) -> Near:
        """Distance and gradient at `position` (3,) [m]."""
        self._point[0] = position
        _, faces, points = self._search(self._point)
        face = faces.item()
        a, b, c = point = points[0].tolist()
        x, y, z = position[0] - a, position[1] - b, position[2] - c
        distance = sqrt(x * x + y * y + z * z)
        normal = self._normal_of[face]
        side = x * normal[0] + y * normal[1] + z * normal[2]
        if distance < _NOWHERE_M or abs(abs(side) - distance) > _FLAT * distance:
            normal = self._pseudonormal(face, point)
            if distance < _NOWHERE_M:
                return Near(0.0, normal)
            side = x * normal[0] + y * normal[1] + z * normal[2]
        signed = distance if side >= 0.0 else -distance
        return Near(signed, (x / signed, y / signed, z / signed))

    def _pseudonormal(self, face: int, point: Sequence[float]) -> Vector:
        """The unit normal of the triangle, edge or corner on which `point` lies."""
        corners = self.triangles[face]
        away = [weight > _ON_EDGE for weight in _barycentric(point, *self.vertices[corners].tolist())]
        if sum(away) == 1:
            normal = self._corner_normals[corners[away.index(True)]]
        elif sum(away) == 2:
            normal = self._edge_normals[face, away.index(False)]
        else:
            return self._normal_of[face]
        x, y, z = normal.tolist()
        size = sqrt(x * x + y * y + z * z)
        return (x / size, y / size, z / size) if size else (1.0, 0.0, 0.0)


_KEY = 1 << 31


def require_closed(triangles: Triangles) -> None:
    """Raise InvalidParameter unless every edge belongs to two triangles that pass along it in opposite directions."""
    if not len(triangles):
        raise InvalidParameter("mesh", "no triangles", "one triangle or more")
    if len(triangles) >= _KEY // 4:
        raise InvalidParameter("mesh", f"{len(triangles)} triangles", "fewer")
    one, other = _directed(triangles)
    keys, back = np.sort(one * _KEY + other), np.sort(other * _KEY + one)
    open_edges = len(np.setxor1d(keys, back)) // 2 + int((keys[1:] == keys[:-1]).sum())
    if open_edges:
        allowed = "a closed mesh: two triangles at each edge, both anticlockwise as seen from outside"
        raise InvalidParameter("mesh", f"{open_edges} edges that do not fit", allowed)


def volume(vertices: Array, triangles: Triangles) -> float:
    """The volume that a closed mesh encloses [m^3]; below 0: it is inside out."""
    a, b, c = (vertices[triangles[:, i]] - vertices.mean(axis=0) for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0


def _directed(triangles: Triangles) -> tuple[Triangles, Triangles]:
    """From and to: the first edges of all triangles, then the second ones, then the third ones."""
    return triangles.T.reshape(-1), np.roll(triangles, -1, axis=1).T.reshape(-1)


def _edge_normals(triangles: Triangles, normals: Array) -> Array:
    """(F, 3, 3): for each triangle and each of its corners the sum of the two normals at the edge across from it."""
    one, other = _directed(triangles)
    order = np.argsort(np.minimum(one, other) * _KEY + np.maximum(one, other), kind="stable")
    pairs = order.reshape(-1, 2)  # the mesh is closed: each edge is there twice
    total = np.empty((len(order), 3))
    total[pairs] = (normals[pairs[:, 0] % len(normals)] + normals[pairs[:, 1] % len(normals)])[:, None]
    by_first = total.reshape(3, -1, 3).swapaxes(0, 1)  # of the edges from corners 0, 1 and 2
    return np.ascontiguousarray(np.roll(by_first, -1, axis=1))


def _corner_normals(vertices: Array, triangles: Triangles, normals: Array) -> Array:
    """(V, 3): for each vertex the sum of the normals around it, weighted by the angles."""
    total = np.zeros_like(vertices)
    corners = vertices[triangles]
    for i in range(3):
        one, other = corners[:, i - 1] - corners[:, i], corners[:, i - 2] - corners[:, i]
        sizes = np.linalg.norm(one, axis=1) * np.linalg.norm(other, axis=1)
        cosines = np.einsum("ij,ij->i", one, other) / np.where(sizes, sizes, 1.0)
        np.add.at(total, triangles[:, i], np.arccos(np.clip(cosines, -1.0, 1.0))[:, None] * normals)
    return total


def _barycentric(point: Sequence[float], a: Vector, b: Vector, c: Vector) -> Vector:
    """The weights of the corners with which `point` is made; all 0 but one in a triangle without area."""
    ab, ac, ap = _less(b, a), _less(c, a), _less(point, a)
    x, y, z = normal = _cross(ab, ac)
    square = x * x + y * y + z * z
    if not square:
        nearest = min(range(3), key=lambda i: dist(point, (a, b, c)[i]))
        return (float(nearest == 0), float(nearest == 1), float(nearest == 2))
    v = inner(_cross(ap, ac), normal) / square
    w = inner(_cross(ab, ap), normal) / square
    return (1.0 - v - w, v, w)


def _less(one: Sequence[float], other: Sequence[float]) -> Vector:
    return (one[0] - other[0], one[1] - other[1], one[2] - other[2])


def _cross(one: Vector, other: Vector) -> Vector:
    a, b, c = one
    x, y, z = other
    return (b * z - c * y, c * x - a * z, a * y - b * x)
