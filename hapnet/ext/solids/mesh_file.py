"""Reads solids from files: meshes (STL, OBJ, PLY), and height fields (numbers in rows)."""

from __future__ import annotations

import io
import logging
from pathlib import Path
from typing import Any

import numpy as np

from hapnet.checks import Array
from hapnet.errors import InvalidParameter
from hapnet.ext.solids.mesh_surface import Triangles, volume
from hapnet.file_content import read_bytes
from hapnet.installing import require
from hapnet.loading import cause

FORMATS = (".stl", ".obj", ".ply")
LARGEST_BYTES = 200_000_000
MOST_TRIANGLES = 1_000_000
SMALLEST_M, LARGEST_M = 0.001, 2.0
"""The smallest and the largest extent of a solid: a hand with a desktop device reaches some 0.1 m."""

_SAME = 1e-7
"""Vertices closer than this share of the extent are joined."""

_BACK_M = 0.01
"""Thickness of a height field below its lowest point."""


def read_mesh(file: str, unit_m: float) -> tuple[Array, Triangles]:
    """Vertices (V, 3) [m] and triangles (F, 3) of a mesh whose file has the unit `unit_m` [m].

    Vertices at the same place are joined, and triangles with a corner twice are dropped.

    Raises InvalidParameter: the file cannot be read, has no triangles or too many, or is absurdly large or small.
    MissingLibrary: the extra `mesh` is not installed.
    """
    kind = Path(file).suffix.lower()
    if kind not in FORMATS:
        raise InvalidParameter("mesh", file, f"a file that ends with {', '.join(FORMATS)}")
    require("mesh", "a scene with a mesh")
    import trimesh

    logging.getLogger("trimesh").addHandler(logging.NullHandler())  # its tracebacks would go to standard error
    data = _read(file)
    try:
        loaded: Any = trimesh.load(io.BytesIO(data), file_type=kind[1:], force="mesh", process=False)
        vertices = np.asarray(loaded.vertices, dtype=np.float64)
        triangles = np.asarray(loaded.faces, dtype=np.int64)
    except Exception as error:  # for a broken file trimesh may raise any error
        raise InvalidParameter("mesh", file, f"a mesh that can be read ({cause(error)})") from None
    if triangles.ndim != 2 or not len(triangles):
        raise InvalidParameter("mesh", file, "a file with triangles")
    if len(triangles) > MOST_TRIANGLES:
        raise InvalidParameter("mesh", f"{file} with {len(triangles)} triangles", f"{MOST_TRIANGLES} at most")
    if triangles.min() < 0 or triangles.max() >= len(vertices) or not np.isfinite(vertices[triangles]).all():
        raise InvalidParameter("mesh", file, "triangles between existing vertices with finite coordinates")
    vertices = unit_m * vertices
    extent = _checked_extent(file, vertices[triangles].reshape(-1, 3))
    _, first, numbers = np.unique(np.round(vertices / (_SAME * extent)), axis=0, return_index=True, return_inverse=True)
    vertices, triangles = vertices[first], numbers.reshape(-1)[triangles]
    one, two, three = triangles.T
    triangles = triangles[(one != two) & (two != three) & (three != one)]
    return vertices, triangles


def read_heights(file: str, unit_m: float, spacing_m: float) -> tuple[Array, Triangles]:
    """A height field as a closed mesh: (V, 3) [m] and (F, 3).

    file : rows of numbers, with commas or blanks: the heights, towards -x, at y = (number of the row) spacings and z =
        (number of the column) spacings. unit_m : of the heights [m].

    Raises InvalidParameter.
    """
    text = _read(file).decode(errors="replace").replace(",", " ")
    try:
        heights = unit_m * np.loadtxt(io.StringIO(text), ndmin=2)
    except ValueError as error:
        raise InvalidParameter("heights", file, f"rows of numbers, all of one length ({cause(error)})") from None
    rows, columns = heights.shape
    if rows < 2 or columns < 2 or 4 * heights.size > MOST_TRIANGLES or not np.isfinite(heights).all():
        allowed = f"2 rows and columns or more, finite numbers, {MOST_TRIANGLES // 4} at most"
        raise InvalidParameter("heights", f"{file}, {rows} x {columns}", allowed)
    y, z = np.meshgrid(spacing_m * np.arange(rows), spacing_m * np.arange(columns), indexing="ij")
    back = np.full_like(y, _BACK_M - heights.min())
    vertices = np.concatenate([np.stack([x, y, z], axis=-1).reshape(-1, 3) for x in (-heights, back)])
    number = np.arange(rows * columns).reshape(rows, columns)
    top = _quads(number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1])
    rim = np.concatenate([number[0, :-1], number[:-1, -1], number[-1, :0:-1], number[:0:-1, 0]])
    following = np.roll(rim, -1)
    behind = rows * columns
    sides = _quads(following, rim, rim + behind, following + behind)
    triangles = np.concatenate([top, top[:, ::-1] + behind, sides])
    _checked_extent(file, vertices)
    if volume(vertices, triangles) < 0.0:
        triangles = triangles[:, ::-1]
    return vertices, triangles


def _quads(a: Triangles, b: Triangles, c: Triangles, d: Triangles) -> Triangles:
    """Two triangles for each quadrilateral."""
    return np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)]).reshape(-1, 3)


def require_file(file: str) -> None:
    """Raises InvalidParameter if it is not there, empty or too large."""
    try:
        size = Path(file).stat().st_size
    except OSError as error:
        raise InvalidParameter("file", file, f"a file that can be read ({error.strerror})") from None
    if size > LARGEST_BYTES:
        raise InvalidParameter("file", f"{file}, {size / 1e6:.0f} MB", f"{LARGEST_BYTES / 1e6:.0f} MB at most")
    if not size:
        raise InvalidParameter("file", file, "a file that is not empty")


def _read(file: str) -> bytes:
    require_file(file)
    try:
        return read_bytes(file, LARGEST_BYTES)
    except OSError as error:
        raise InvalidParameter("file", file, f"a file that can be read ({error.strerror})") from None


def _checked_extent(file: str, places: Array) -> float:
    extent = float(np.ptp(places, axis=0).max())
    if not SMALLEST_M <= extent <= LARGEST_M:
        allowed = f"{1e3 * SMALLEST_M:g} mm to {LARGEST_M:g} m: is the unit right?"
        raise InvalidParameter("size", f"{file}, {extent:.3g} m", allowed)
    return extent
