"""Properties of a mesh's surface, computed when it is loaded: neighbours, sharp edges, normals, and curvature."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array
from hapnet.errors import InvalidParameter
from hapnet.ext.solids.mesh_smoothness import Smoothness, angles_at, group_sums, linked_groups, smoothness

Triangles = NDArray[np.int64]

SHARP_DEG = 40.0
"""Triangles that meet at a larger angle meet at an edge of the solid; at a smaller angle they form a curved surface.
The sides of an octagon meet at 45 degrees."""

_SMALL = 0.3
"""A planar face smaller than this share of the largest triangle around a corner does not count there: a flat face stays
flat beside a narrow fillet or chamfer."""

_TIP, _LEAST_TIP = 2.0, 0.02
"""If a vertex's mean normal is farther from each triangle's [rad] than this many times the largest angle at which the
triangle meets a neighbour on the curved surface, and than the second value, the surface has a tip there."""

_RING, _CLOSER, _TURN_ERROR = 0.02, (0.25, 0.85), 0.01
"""Rings of vertices around a tip: the share of the edges' lengths at which the last one is, the least and the greatest
ratio of two rings' distances, and the largest error of the normal between them [rad]."""

_KEY = 1 << 31
_FLAT = 1e-6
"""Normals that differ by less count as equal."""


@dataclass(frozen=True)
class MeshSurface:
    """A closed mesh, for each triangle and its corners; see `hapnet.ext.solids.mesh_walk.follow`."""

    vertices: Array  #: (V, 3) [m]
    triangles: Triangles  #: (F, 3)
    across: Triangles  #: (F, 3): the triangle behind the edge that lies across from each corner
    facets: Array  #: (F, 3): the triangles' unit normals; 0 where there is no area
    normals: Array  #: (F, 3, 3): the unit normals at the corners; the same around a vertex, but for sharp edges
    pseudonormals: Array  #: (V, 3): of all triangles around each vertex, weighted by the angles
    rims: Triangles  #: (F, 3): 0: that edge is smooth; sharp edges: 1: convex, -1: concave, 2: neither
    pointed: Triangles  #: (V,): not 0: a sharp edge ends there
    flat: Triangles  #: (F,): not 0: all normals at the corners equal the triangle's
    first: Triangles  #: (V + 1,) see `ring`
    ring: Triangles  #: the triangles around the vertex v: ring[first[v]:first[v + 1]]
    bends: Array  #: (F, 3, 3): how the normal turns along a direction [1/m]

    @classmethod
    def of(cls, vertices: Array, triangles: Triangles, sharp_deg: float, splits_tips: bool = True) -> MeshSurface:
        """The surface of a mesh. It has more triangles than the mesh if that has tips; see `_split`.

        Raises InvalidParameter: the mesh is empty or not closed.
        """
        require_closed(triangles)
        corners = vertices[triangles]
        doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        sizes = np.linalg.norm(doubled, axis=1)
        facets = doubled / np.where(sizes, sizes, 1.0)[:, None]
        across = _across(triangles)
        rims, joins = _rims(corners, facets, sizes, across, triangles, sharp_deg)
        angles = _angles(corners)
        weighted = (angles[:, :, None] * facets[:, None]).reshape(-1, 3)
        fans, fan_of = fans_of(triangles, across, rims)
        normals, tips = _normals(angles, facets, sizes, joins, fans, fan_of)
        if splits_tips and tips.any():
            return cls.of(*_split(vertices, triangles, np.unique(triangles[tips]), joins.turns), sharp_deg, False)
        pointed = np.zeros(len(vertices), dtype=np.int64)
        for k in range(3):
            at = rims[:, k] != 0
            pointed[triangles[at, k - 1]] = pointed[triangles[at, k - 2]] = 1
        around = np.argsort(triangles.reshape(-1), kind="stable")
        count = np.bincount(triangles.reshape(-1), minlength=len(vertices))
        flat = np.all(np.abs(normals - facets[:, None]) < _FLAT, axis=(1, 2))
        normals[flat] = facets[flat][:, None]
        bends = _bends(corners, facets, normals, sizes).reshape(-1, 9)
        shares = np.where(flat, 0.0, sizes).repeat(3)
        mean = group_sums(fan_of, shares[:, None] * bends.repeat(3, axis=0), fans)
        mean /= np.maximum(np.bincount(fan_of, shares, fans), np.finfo(float).tiny)[:, None]
        bends = np.where(flat[:, None], 0.0, mean[fan_of].reshape(-1, 3, 9).mean(axis=1))
        return cls(
            vertices, triangles, across, facets, normals,
            group_sums(triangles.reshape(-1), weighted, len(vertices)), rims, pointed, flat.astype(np.int64),
            np.concatenate([[0], np.cumsum(count)]), around // 3, bends.reshape(-1, 3, 3),
        )  # fmt: skip

    def curved(self) -> tuple[float, float]:
        """The share of the area that is felt as curved, and how far its middles are from the triangles, at most [m]."""
        corners, bent = self.vertices[self.triangles], self.flat == 0
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        off = corners.mean(axis=1)[:, None] - corners
        lifts = np.einsum("fkj,fkj->fk", self.normals, off)[:, :, None] * self.normals
        far = np.linalg.norm(lifts.sum(axis=1) / 6.0, axis=1)[bent]
        return float(areas[bent].sum() / areas.sum()), float(far.max(initial=0.0))


def require_closed(triangles: Triangles) -> None:
    """Raise InvalidParameter unless every edge belongs to two triangles that pass along it in opposite directions."""
    if not len(triangles):
        raise InvalidParameter("mesh", "without triangles", "", why="it needs one triangle or more")
    if len(triangles) >= _KEY // 4:
        raise InvalidParameter("mesh", f"of {len(triangles)} triangles", "", why=f"it may have {_KEY // 4} at most")
    one, other = directed(triangles)
    keys, back = np.sort(one * _KEY + other), np.sort(other * _KEY + one)
    twice = int((keys[1:] == keys[:-1]).sum())
    if twice or not np.array_equal(keys, back):
        open_edges = len(np.setxor1d(keys, back)) // 2 + twice
        allowed = "a closed mesh: two triangles at each edge, both anticlockwise as seen from outside"
        raise InvalidParameter("mesh", f"{open_edges} edges that do not fit", allowed)


def volume(vertices: Array, triangles: Triangles) -> float:
    """The volume that a closed mesh encloses [m^3]; below 0: it is inside out."""
    a, b, c = (vertices[triangles[:, i]] - vertices.mean(axis=0) for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0


def directed(triangles: Triangles) -> tuple[Triangles, Triangles]:
    """Start and end of edges: the first edges of all triangles, then the second, then the third edges."""
    return triangles.T.reshape(-1), np.roll(triangles, -1, axis=1).T.reshape(-1)


def _across(triangles: Triangles) -> Triangles:
    one, other = directed(triangles)
    order = np.argsort(np.minimum(one, other) * _KEY + np.maximum(one, other), kind="stable")
    pairs = order.reshape(-1, 2)  # the mesh is closed: each edge is there twice
    beside = np.empty_like(order)
    beside[pairs] = pairs[:, ::-1] % len(triangles)
    by_edge = beside.reshape(3, -1).T  # behind the edges from corners 0, 1 and 2
    return np.ascontiguousarray(np.roll(by_edge, -1, axis=1))


def _rims(
    corners: Array, facets: Array, sizes: Array, across: Triangles, triangles: Triangles, sharp_deg: float
) -> tuple[Triangles, Smoothness]:
    """`MeshSurface.rims`, and how the triangles join; sizes : (F,), twice the areas [m^2]."""
    angles = angles_at(facets, across)
    steep = angles > np.radians(sharp_deg)
    fan_of = fans_of(triangles, across, steep.astype(np.int64))[1]
    joins = smoothness(corners, facets, sizes, across, fan_of, angles, steep)
    sharp = joins.sharp
    rising = np.empty(across.shape)
    for k in range(3):  # whether the middle of the neighbour is in front of the triangle
        away = corners[across[:, k]].mean(axis=1) - corners[:, k - 1]
        rising[:, k] = np.einsum("ij,ij->i", away, facets)
    found: Triangles = np.where(sharp, np.where(rising < 0.0, 1, np.where(rising > 0.0, -1, 2)), 0)
    return found, joins


def _normals(
    angles: Array, facets: Array, sizes: Array, joins: Smoothness, fans: int, fan_of: Triangles
) -> tuple[Array, NDArray[np.bool_]]:
    """(F, 3, 3): the normals at the corners: the mean of a fan, weighted by the angles; (F, 3): which are tips.

    In a fan with level triangles only these count, otherwise only the large ones. At the tip of a cone, where the mean
    is far from all triangles' normals, each keeps its own.
    """
    largest, levels = np.zeros(fans), np.zeros(fans)
    np.maximum.at(largest, fan_of, sizes.repeat(3))
    np.maximum.at(levels, fan_of, joins.level.repeat(3))
    counts = (joins.doubled[:, None] > _SMALL * largest[fan_of].reshape(-1, 3)) & (levels[fan_of].reshape(-1, 3) == 0.0)
    counts |= joins.level[:, None]
    turned = (np.where(counts, angles, 0.0)[:, :, None] * facets[:, None]).reshape(-1, 3)
    found: Array = _unit(group_sums(fan_of, turned, fans))[fan_of].reshape(-1, 3, 3)
    off = np.linalg.norm(found - facets[:, None], axis=2) > np.maximum(_TIP * joins.turns, _LEAST_TIP)[:, None]
    near = np.bincount(fan_of, ~off.reshape(-1), fans) > 0.0
    tip = ~near[fan_of].reshape(-1, 3)
    found[tip] = np.broadcast_to(facets[:, None], found.shape)[tip]
    return found, tip


def _split(vertices: Array, triangles: Triangles, tips: Triangles, turns: Array) -> tuple[Array, Triangles]:
    """The same mesh with rings of further vertices around the vertices `tips`. turns : (F,), as `Smoothness.turns`.

    Towards a tip each edge that leads there keeps the normal of its other end, as on a cone. A normal is linear in a
    triangle, so the rings are so close that it differs by `_TURN_ERROR` at most from a cone's.
    """
    for tip in tips.tolist():
        at, k = np.nonzero(triangles == tip)
        around = triangles[at[:, None], (k[:, None] + np.arange(3)) % 3]
        ends, number = np.unique(around[:, 1:], return_inverse=True)
        number = number.reshape(-1, 2)
        closer = min(max(1.0 - 4.0 * _TURN_ERROR / float(turns[at].max()), _CLOSER[0]), _CLOSER[1])
        shares = [closer]
        while shares[-1] * closer > _RING:
            shares.append(shares[-1] * closer)
        rings = [vertices[tip] + share * (vertices[ends] - vertices[tip]) for share in shares]
        numbers = [ends[number], *[len(vertices) + i * len(ends) + number for i in range(len(rings))]]
        vertices = np.concatenate([vertices, *rings])
        made = [np.column_stack([around[:, 0], numbers[-1]])]
        for far, near in pairwise(numbers):
            made.append(np.column_stack([near[:, 0], far]))
            made.append(np.column_stack([near[:, 0], far[:, 1], near[:, 1]]))
        triangles = np.concatenate([np.delete(triangles, at, axis=0), *made])
        turns = np.concatenate([np.delete(turns, at), *[turns[at]] * len(made)])
    return vertices, triangles


def _angles(corners: Array) -> Array:
    """(F, 3)"""
    found = np.empty(corners.shape[:2])
    for i in range(3):
        one, other = corners[:, i - 1] - corners[:, i], corners[:, i - 2] - corners[:, i]
        sizes = np.linalg.norm(one, axis=1) * np.linalg.norm(other, axis=1)
        cosines = np.einsum("ij,ij->i", one, other) / np.where(sizes, sizes, 1.0)
        found[:, i] = np.arccos(np.clip(cosines, -1.0, 1.0))
    return found


def fans_of(triangles: Triangles, across: Triangles, rims: Triangles) -> tuple[int, Triangles]:
    """The number of fans, and each corner's fan (3F,): corners around a vertex without a sharp edge between them."""
    face, k = np.nonzero(rims == 0)
    beside = across[face, k]
    joined = []
    for end in (k - 1, k - 2):
        vertex = triangles[face, end]
        there = np.argmax(triangles[beside] == vertex[:, None], axis=1)
        joined.append((3 * face + end % 3, 3 * beside + there))
    one, other = (np.concatenate(part) for part in zip(*joined, strict=True))
    return linked_groups(3 * len(triangles), one, other)


def _bends(corners: Array, facets: Array, normals: Array, sizes: Array) -> Array:
    """(F, 3, 3): the symmetric map that takes the edges to the differences of the normals (Rusinkiewicz 2004)."""
    edges = corners[:, [1, 2, 0]] - corners
    turns = normals[:, [1, 2, 0]] - normals
    lengths = np.linalg.norm(edges[:, 0], axis=1)
    e = edges[:, 0] / np.where(lengths, lengths, 1.0)[:, None]
    frame = np.stack([e, np.cross(facets, e)], axis=1)
    flat, turned = np.einsum("fkj,faj->fka", edges, frame), np.einsum("fkj,faj->fka", turns, frame)
    zero = np.zeros(flat.shape[:2])
    rows = np.concatenate([
        np.stack([flat[..., 0], flat[..., 1], zero], -1), np.stack([zero, flat[..., 0], flat[..., 1]], -1)
    ], axis=1)  # fmt: skip
    right = np.concatenate([turned[..., 0], turned[..., 1]], axis=1)
    squares, given = np.einsum("fka,fkb->fab", rows, rows), np.einsum("fka,fk->fa", rows, right)
    scale = np.trace(squares, axis1=1, axis2=2)
    good = (sizes > 0.0) & (np.linalg.det(squares) > 1e-9 * scale**3)
    squares[~good] = np.eye(3)
    a, b, c = np.where(good[:, None], np.linalg.solve(squares, given[..., None])[..., 0], 0.0).T
    found: Array = np.einsum("fai,fab,fbj->fij", frame, np.stack([a, b, b, c], -1).reshape(-1, 2, 2), frame)
    return found


def _unit(vectors: Array) -> Array:
    sizes = np.linalg.norm(vectors, axis=1)
    return vectors / np.where(sizes, sizes, 1.0)[:, None]
