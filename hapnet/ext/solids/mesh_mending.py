"""Mends faults of a mesh's triangles that leave no doubt about the solid: doubled and flipped triangles."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from hapnet.ext.solids.mesh_surface import Triangles, directed


def mended(triangles: Triangles) -> tuple[Triangles, list[str]]:
    """The triangles (F, 3), each once and all of a piece facing the same way; and notes on the changes.

    Two solids that share a face have it twice, facing both ways, and keep it. If all triangles are such pairs
    and one of each makes a closed surface, that is double-sided: of each pair the first stays.
    """
    notes = []
    single = _firsts(_rolled(triangles))
    sides = _firsts(np.sort(triangles[single], axis=1))
    if 2 * len(sides) == len(single) and _is_paired(triangles[single[sides]]):
        single = single[sides]
    if len(single) < len(triangles):
        notes.append(f"{len(triangles) - len(single)} doubled triangles left out")
    found = triangles[single]
    if _is_paired(found) and len(np.unique(np.stack(directed(found), axis=1), axis=0)) < 3 * len(found):
        found, flipped = _facing_alike(found)
        notes.append(f"{flipped} triangles turned, inside out in the file")
    return found, notes


def _rolled(triangles: Triangles) -> Triangles:
    """The triangles, facing the same way, each beginning with its lowest vertex."""
    first = np.argmin(triangles, axis=1)[:, None]
    return np.take_along_axis(triangles, (first + np.arange(3)) % 3, axis=1)


def _is_paired(triangles: Triangles) -> bool:
    """Whether each edge belongs to two triangles, whichever way they pass along it."""
    edges = np.sort(np.stack(directed(triangles), axis=1), axis=1)
    return bool(np.all(np.unique(edges, axis=0, return_counts=True)[1] == 2))


def _firsts(rows: Triangles) -> Triangles:
    """The indices of the first of equal rows, in their order."""
    found: Triangles = np.sort(np.unique(rows, axis=0, return_index=True)[1])
    return found


def _facing_alike(triangles: Triangles) -> tuple[Triangles, int]:
    """The triangles, in each piece the fewer ones turned; and the number of these."""
    igl: Any = import_module("igl")
    alike, piece_of = igl.bfs_orient(np.ascontiguousarray(triangles))
    alike, piece_of = np.asarray(alike, dtype=np.int64), np.asarray(piece_of).reshape(-1)
    turned = _ways(alike) != _ways(triangles)
    pieces, members = np.bincount(piece_of, turned), np.bincount(piece_of)
    turned ^= (pieces > 0.5 * members)[piece_of]
    found = triangles.copy()
    found[turned] = triangles[turned, ::-1]
    return found, int(turned.sum())


def _ways(triangles: Triangles) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """(F,): which of its two ways a triangle faces."""
    rolled = _rolled(triangles)
    found: np.ndarray[Any, np.dtype[np.bool_]] = rolled[:, 1] < rolled[:, 2]
    return found
