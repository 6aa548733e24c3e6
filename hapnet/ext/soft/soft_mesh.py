"""Meshes of tetrahedra: a block and an organ by formulas, or a file (meshio; a surface is filled by wildmeshing)."""

from __future__ import annotations

from itertools import permutations
from typing import Any

import numpy as np

from hapnet.checks import Array
from hapnet.errors import InvalidParameter, MissingLibrary
from hapnet.ext.soft.soft_linear import Indices
from hapnet.ext.solids.mesh_file import LARGEST_M, SMALLEST_M, require_file
from hapnet.loading import cause

MOST_TETRAHEDRA = 60_000
_ROUND = 0.65
"""Roundness of the organ: 0: a block, 1: an ellipsoid, where the tetrahedra at the block's edges would vanish."""

_BEND = 0.35
_FLAT = 1e-6
"""A tetrahedron of less than this share of the mean volume is dropped, and a body of less than this share of the cube
around it is flat."""

_SAME = 1e-7
"""Nodes closer than this share of the extent are at the same place."""


def block(size: tuple[float, ...], nodes: int) -> tuple[Array, Indices]:
    """A block of this size (3,) [m] about the origin, with about this number of nodes: (N, 3) [m], (E, 4)."""
    spacing = (size[0] * size[1] * size[2] / nodes) ** (1.0 / 3.0)
    counts = [max(2, round(side / spacing)) for side in size]
    axes = [np.linspace(-0.5 * side, 0.5 * side, count) for side, count in zip(size, counts, strict=True)]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(places)).reshape(counts)
    corner = {
        (i, j, k): number[i : counts[0] - 1 + i, j : counts[1] - 1 + j, k : counts[2] - 1 + k].ravel()
        for i in (0, 1) for j in (0, 1) for k in (0, 1)
    }  # fmt: skip
    parts = []
    for order in permutations(range(3)):  # each cell's six tetrahedra share one diagonal (Kuhn 1960)
        at, path = [0, 0, 0], [corner[0, 0, 0]]
        for axis in order:
            at[axis] = 1
            path.append(corner[at[0], at[1], at[2]])
        parts.append(np.stack(path, axis=1))
    return places, oriented(places, np.concatenate(parts))


def organ(size: tuple[float, ...], nodes: int) -> tuple[Array, Indices]:
    """A bean-shaped body: a block that is rounded to an ellipsoid, and bent."""
    places, tets = block((2.0, 2.0, 2.0), nodes)
    x, y, z = places.T
    ball = np.stack(
        [
            x * np.sqrt(1.0 - y * y / 2.0 - z * z / 2.0 + y * y * z * z / 3.0),
            y * np.sqrt(1.0 - z * z / 2.0 - x * x / 2.0 + z * z * x * x / 3.0),
            z * np.sqrt(1.0 - x * x / 2.0 - y * y / 2.0 + x * x * y * y / 3.0),
        ],
        axis=1,
    )
    shape = _ROUND * ball + (1.0 - _ROUND) * places
    shape[:, 0] += _BEND * (1.0 - shape[:, 1] ** 2)
    shape *= 0.5 * np.array(size)
    return shape - 0.5 * (shape.min(axis=0) + shape.max(axis=0)), oriented(shape, tets)


def oriented(nodes: Array, tets: Indices) -> Indices:
    """Reorder the nodes of the tetrahedra so that all volumes are positive."""
    edges = nodes[tets[:, 1:]] - nodes[tets[:, :1]]
    return np.where((np.linalg.det(edges) < 0.0)[:, None], tets[:, [0, 2, 1, 3]], tets)


def read(file: str, unit_m: float, nodes: int) -> tuple[Array, Indices]:
    """The tetrahedra of a file in one of meshio's formats; a surface is filled with about this number of nodes.

    Raises InvalidParameter: the file cannot be read, or has neither tetrahedra nor triangles. MissingLibrary.
    """
    require_file(file)
    try:
        import meshio
    except ImportError:
        raise MissingLibrary("a soft body of a file", "meshio", "soft") from None
    try:
        mesh = meshio.read(file)
    except (Exception, SystemExit) as error:  # for a broken file meshio may raise any error, even SystemExit
        raise InvalidParameter("soft", file, f"a mesh that meshio reads ({cause(error)})") from None
    cells = {kind: np.asarray(found, dtype=np.int64) for kind, found in mesh.cells_dict.items()}
    places = unit_m * np.asarray(mesh.points, dtype=float)
    if "tetra" in cells:
        tets = cells["tetra"]
    elif "triangle" in cells:
        places, tets = _filled(file, places, cells["triangle"], nodes)
    else:
        raise InvalidParameter("soft", f"{file} with {', '.join(cells) or 'no cells'}", "tetrahedra, or a surface")
    return checked(file, places, tets)


def checked(file: str, places: Array, tets: Indices) -> tuple[Array, Indices]:
    """Remove flat tetrahedra and unused nodes.

    Raises InvalidParameter: there are none or too many, they are not between nodes, the body is flat, or some overlap.
    """
    if not len(tets) or len(tets) > MOST_TETRAHEDRA:
        raise InvalidParameter("soft", f"{file} with {len(tets)} tetrahedra", f"1 to {MOST_TETRAHEDRA}")
    if tets.min() < 0 or tets.max() >= len(places) or not np.isfinite(places[tets]).all():
        raise InvalidParameter("soft", file, "tetrahedra between existing nodes with finite coordinates")
    extent = float(np.ptp(places[np.unique(tets)], axis=0).max())
    if not SMALLEST_M <= extent <= LARGEST_M:
        allowed = f"{1e3 * SMALLEST_M:g} mm to {LARGEST_M:g} m: is the unit right?"
        raise InvalidParameter("soft", f"{file}, {extent:.3g} m", allowed)
    volumes = np.abs(np.linalg.det(places[tets[:, 1:]] - places[tets[:, :1]]))
    if not volumes.sum() > _FLAT * extent**3:
        raise InvalidParameter("soft", file, "", why="its tetrahedra have no volume")
    tets = tets[volumes > _FLAT * volumes.mean()]
    if crowded := _crowded_faces(places, tets, extent):
        why = f"{crowded} faces belong to three tetrahedra or more; is a tetrahedron in the file twice?"
        raise InvalidParameter("soft", file, "", why=why)
    used, numbers = np.unique(tets, return_inverse=True)
    places = places[used]
    return places, oriented(places, numbers.reshape(-1, 4))


def _crowded_faces(places: Array, tets: Indices, extent: float) -> int:
    """The number of faces of more than two tetrahedra; nodes at the same place count as one."""
    node_of = np.unique(np.round(places / (_SAME * extent)), axis=0, return_inverse=True)[1].reshape(-1)
    faces = np.concatenate([np.delete(node_of[tets], i, axis=1) for i in range(4)])
    counts = np.unique(np.sort(faces, axis=1), axis=0, return_counts=True)[1]
    return int((counts > 2).sum())


def _filled(file: str, places: Array, triangles: Indices, nodes: int) -> tuple[Array, Indices]:
    """Fill a closed surface with tetrahedra (fTetWild, Hu et al. 2020)."""
    try:
        import wildmeshing
    except ImportError:
        raise MissingLibrary(f"a soft body of the surface {file}", "wildmeshing", "soft-surface") from None
    extent = np.ptp(places, axis=0)
    edge = float((extent.prod() / nodes) ** (1.0 / 3.0) / np.linalg.norm(extent))
    mesher: Any = wildmeshing.Tetrahedralizer(stop_quality=10, edge_length_r=edge, max_threads=1)
    mesher.set_mesh(np.ascontiguousarray(places), np.ascontiguousarray(triangles, dtype=np.int32))
    mesher.tetrahedralize()
    found: Any = mesher.get_tet_mesh()
    return np.asarray(found[0], dtype=float), np.asarray(found[1], dtype=np.int64)
