"""Joins the parts of a mesh to one solid: turns parts that are inside out, and joins parts that overlap.

CAD programs write assemblies: parts that overlap or touch, screws inside blocks, sometimes a part whose triangles
face inwards. Where parts overlap, no triangle shows what is inside. So parts are separated by their edges; a part
inside another part that faces the other way is a cavity and stays; manifold3d makes the union.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from hapnet.checks import Array
from hapnet.errors import InvalidParameter, MissingLibrary
from hapnet.ext.solids.mesh_mending import mended
from hapnet.ext.solids.mesh_smoothness import linked_groups
from hapnet.ext.solids.mesh_surface import Triangles, directed, fans_of, require_closed
from hapnet.installing import require
from hapnet.records.vectors import added

_SAMPLES = 40
"""Vertices of a part that are tested to find whether it lies inside another part."""

_EMPTY = 1e-9
"""A part with less volume, as a share of the cube around it, is left out."""

_ROUNDING = 1e-9


class MeshPart(NamedTuple):
    vertices: Array
    triangles: Triangles
    volume: float  #: [m^3]; below 0: it faces inwards
    low: Array  #: the corners of its extent
    high: Array

    @classmethod
    def of(cls, vertices: Array, triangles: Triangles) -> MeshPart:
        used, numbers = np.unique(triangles, return_inverse=True)
        own = vertices[used]
        low, high = own.min(axis=0), own.max(axis=0)
        corners = own[numbers.reshape(-1, 3)] - 0.5 * (low + high)
        six = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
        return cls(own, numbers.reshape(-1, 3), float(six) / 6.0, low, high)

    @property
    def pieces(self) -> int:
        """Number of pieces of its surface: more than one with cavities."""
        return int(import_module("igl").facet_components(self.triangles)[0])

    def turned(self) -> MeshPart:
        return self._replace(triangles=self.triangles[:, ::-1], volume=-self.volume)

    def holds(self, other: MeshPart) -> bool:
        """Whether `other` lies inside."""
        if np.any(other.low < self.low) or np.any(other.high > self.high):
            return False
        corners = self.vertices[self.triangles]
        return all(abs(_turns(x, corners)) > 0.5 for x in other.vertices[:: len(other.vertices) // _SAMPLES + 1])

    def meets(self, other: MeshPart) -> bool:
        """Whether their extents overlap."""
        return bool(np.all(self.low <= other.high) and np.all(other.low <= self.high))


def joined(vertices: Array, triangles: Triangles) -> tuple[Array, Triangles, str]:
    """Vertices and triangles of a mesh, its parts joined to one solid; and a note on the changes.

    Raises InvalidParameter: it is not closed, has no volume, or cannot be joined. MissingLibrary: there are parts to
    be joined, and manifold3d is not installed; or libigl is not.
    """
    require("mesh", "a scene with a mesh")
    triangles, notes = mended(triangles)
    vertices, triangles = _apart(vertices, triangles)
    require_closed(triangles)
    igl: Any = import_module("igl")
    count, part_of = igl.facet_components(triangles)
    every = [MeshPart.of(vertices, triangles[part_of == i]) for i in range(count)]
    parts = [part for part in every if abs(part.volume) > _EMPTY * float(np.prod(part.high - part.low))]
    if not parts:
        raise InvalidParameter("mesh", f"of {count} parts", "", why="none of them encloses a volume")
    solids, turned, cavities = _oriented(parts)
    made, before, after = _united(solids)
    counts = [
        f"{len(every) - len(parts)} without volume left out" * (len(parts) < len(every)),
        f"{turned} turned, inside out in the file" * (turned > 0),
        f"{before} that overlap or touch joined into {after}" * (before > 0),
        f"{cavities} kept as a cavity" * (cavities > 0),
    ]
    done = "; ".join(filter(None, counts))
    if not (turned or before or len(parts) < len(every)):
        return vertices, triangles, "; ".join(notes)
    start = np.cumsum([0, *[len(part.vertices) for part in made]])
    return (
        np.concatenate([part.vertices for part in made]),
        np.concatenate([part.triangles + first for part, first in zip(made, start, strict=False)]),
        "; ".join([*notes, f"of {count} part{'s' * (count > 1)}: {done}"]),
    )


def _oriented(parts: Sequence[MeshPart]) -> tuple[list[MeshPart], int, int]:
    """Each solid together with its cavities; the number of turned parts, and of cavities.

    A part is a solid if it faces the same way as the outermost part around it, else a cavity.
    """
    around = [[j for j, other in enumerate(parts) if j != i and other.holds(part)] for i, part in enumerate(parts)]
    outermost = [min(inside, key=lambda j: len(around[j]), default=i) for i, inside in enumerate(around)]
    hollow = [parts[i].volume * parts[j].volume < 0.0 for i, j in enumerate(outermost)]
    groups = {i: [part] for i, part in enumerate(parts) if not hollow[i]}
    for i, part in enumerate(parts):
        if hollow[i]:
            groups[min((j for j in around[i] if not hollow[j]), key=lambda j: abs(parts[j].volume))].append(part)
    turned = 0
    solids = []
    for first, *others in groups.values():
        if first.volume < 0.0:
            turned += 1 + len(others)
            first, others = first.turned(), [other.turned() for other in others]
        solids.append(_together([first, *others]))
    return solids, turned, hollow.count(True)


def _united(solids: Sequence[MeshPart]) -> tuple[list[MeshPart], int, int]:
    """Join solids that overlap, or share a piece of a face; also their number before, and after."""
    made: list[MeshPart] = []
    before = after = 0
    left = list(solids)
    while left:
        cluster = [left.pop()]
        for one in cluster:  # it grows
            near = [other for other in left if one.meets(other)]
            left = [other for other in left if not one.meets(other)]
            cluster += near
        if len(cluster) > 1:
            union = _union(cluster)
            cavities = added([part.pieces - 1 for part in cluster])
            if union.pieces < len(cluster) + cavities or union.volume < (1.0 - _ROUNDING) * added(
                [part.volume for part in cluster]
            ):
                before, after = before + len(cluster), after + max(1, union.pieces - int(cavities))
                cluster = [union]
        made += cluster
    return made, before, after


def _union(parts: Sequence[MeshPart]) -> MeshPart:
    try:
        manifold: Any = import_module("manifold3d")
    except ImportError:
        raise MissingLibrary("a mesh with parts that overlap", "manifold3d", "mesh") from None
    solids = [manifold.Manifold(manifold.Mesh64(part.vertices, part.triangles.astype(np.uint64))) for part in parts]
    union = manifold.Manifold.batch_boolean(solids, manifold.OpType.Add)
    if union.status() != manifold.Error.NoError or union.is_empty():
        raise InvalidParameter("mesh", f"{len(parts)} parts ({union.status().name})", "parts that can be joined")
    mesh = union.to_mesh64()
    return MeshPart.of(np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, dtype=np.int64))


def _together(parts: Sequence[MeshPart]) -> MeshPart:
    start = np.cumsum([0, *[len(part.vertices) for part in parts]])
    return MeshPart(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.triangles + first for part, first in zip(parts, start, strict=False)]),
        added([part.volume for part in parts]), parts[0].low, parts[0].high,
    )  # fmt: skip


def _turns(x: Array, corners: Array) -> float:
    """The winding number of a closed mesh around x (van Oosterom, Strackee 1983)."""
    a, b, c = (corners[:, i] - x for i in range(3))
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    dots = [np.einsum("ij,ij->i", p, q) for p, q in ((a, b), (b, c), (c, a))]
    triple = np.einsum("ij,ij->i", a, np.cross(b, c))
    below = la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb
    return float(np.arctan2(triple, below).sum() / (2.0 * np.pi))


def _apart(vertices: Array, triangles: Triangles) -> tuple[Array, Triangles]:
    """Give parts that touch along edges or at corners separate vertices."""
    one, other = directed(triangles)
    order = np.lexsort((np.maximum(one, other), np.minimum(one, other)))
    ends = np.stack([np.minimum(one, other)[order], np.maximum(one, other)[order]], axis=1)
    starts = np.flatnonzero(np.r_[True, np.any(ends[1:] != ends[:-1], axis=1)])
    sizes = np.diff(np.r_[starts, len(ends)])
    if np.all(sizes == 2) or np.any(sizes % 2):
        return vertices, triangles
    count = len(triangles)
    beside = np.empty_like(order)
    pairs = order[np.repeat(sizes == 2, sizes)].reshape(-1, 2)
    beside[pairs] = pairs[:, ::-1]
    part_of = linked_groups(count, pairs[:, 0] % count, pairs[:, 1] % count)[1]
    for start, size in zip(starts[sizes > 2].tolist(), sizes[sizes > 2].tolist(), strict=True):
        edges = order[start : start + size].tolist()
        a, b = vertices[ends[start]]
        forward = {edge: bool(one[edge] < other[edge]) for edge in edges}
        parts = [[edge for edge in edges if part_of[edge % count] == i] for i in {part_of[e % count] for e in edges}]
        if not all(_balanced(part, forward) for part in parts):
            parts = [edges]
            if not _balanced(edges, forward):
                return vertices, triangles
        for part in parts:
            away = {edge: vertices[triangles[edge % count, edge // count - 1]] - a for edge in part}
            for edge, mate in _mates(away, forward, b - a):
                beside[edge], beside[mate] = mate, edge
    by_edge = (beside % count).reshape(3, -1).T
    fans, fan_of = fans_of(triangles, np.roll(by_edge, -1, axis=1), np.zeros_like(triangles))
    first_of = np.empty(fans, dtype=np.int64)
    first_of[fan_of] = triangles.reshape(-1)
    return vertices[first_of], fan_of.reshape(-1, 3).astype(np.int64)


def _balanced(edges: Sequence[int], forward: Mapping[int, bool]) -> bool:
    return 2 * [forward[edge] for edge in edges].count(True) == len(edges)


def _mates(away: Mapping[int, Array], forward: Mapping[int, bool], axis: Array) -> Iterator[tuple[int, int]]:
    """The pairs of triangles around one edge that have solid between them.

    away : the direction of each edge's triangle. forward : whether the edge runs along `axis`, the common direction.
    """
    axis = axis / np.linalg.norm(axis)
    first = next(iter(away.values()))
    first = first - axis * (axis @ first)
    second = np.cross(axis, first)
    row = sorted(  # the solid lies between a backward edge and the next forward edge
        (round(float(np.arctan2(second @ out, first @ out)), 9), not forward[edge], edge) for edge, out in away.items()
    )
    waiting: list[int] = []
    done: set[int] = set()
    for _, backward, edge in row * 2:
        if edge in done:
            continue
        if not backward and waiting:
            mate = waiting.pop()
            done |= {edge, mate}
            yield edge, mate
        elif backward and edge not in waiting:
            waiting.append(edge)
