"""Decides at which edges of a mesh its faces are samples of one curved surface; at all others the solid has an edge.

An angle between two faces does not tell: a flat top with drafted sides has the same angles as a coarse ball. So the
faces around a face must show that the surface goes on bending there. With the planar faces' normals n and centroids c,
the normal's change along the surface is fitted to the faces around a face, ``n_j - n = S (c_j - c)``. The face is
*curved* if there are faces on both sides along each strong bend, if those of one bend agree, and if a face beside it is
curved too: a flat top with drafted sides bends on all its sides, but its sides bend on one side only. At a curved
face's edges the mesh is smooth. If the faces on both sides contradict each other, the face is *level*.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array

Flags = NDArray[np.bool_]
Numbers = NDArray[np.int64]

_PLANAR = 1e-3
"""Triangles that meet at a smaller angle belong to one planar face [rad]. A ball of a million triangles bends more."""

_ABOVE_PI = 4.0

_MOST_AROUND = 40
"""At a vertex with more planar faces only those that share an edge count as neighbours."""

_FARTHEST = 0.7
"""Faces whose normals differ by more [rad] tell nothing about each other: 40 degrees."""

_ASIDE = 0.3
"""A neighbour lies on one side along the bend if the cosine of its direction and the bend's is above this."""

_UNKNOWN = 0.02
"""Regularises the fit: a direction in which almost no face lies has no bend."""

_STRONG = 0.5
"""A principal bend counts if it is at least this share of the stronger one."""

_ALIKE = 0.2
"""The smallest ratio of the bends on both sides of a curved face [1/m], or of the angles. Bends alone would not do: the
first strip of a fillet bends little towards the wide flat face."""

_MOST = 0.5
"""A face is curved, too, if more than this share of its neighbours is: meshes from volumes have slivers among them."""

_HARMLESS_M = 5e-5
"""An edge stays smooth if smoothing it moves the surface by less than this [m]: noise of a scanned surface."""


class Smoothness(NamedTuple):
    sharp: Flags  #: (F, 3): the edge across from each corner is an edge of the solid
    level: Flags  #: (F,): triangles of planar faces between faces that contradict each other
    doubled: Array  #: (F,): twice the area of the planar face of each triangle [m^2]
    turns: Array  #: (F,): the largest angle to a triangle across a smooth edge [rad]


def angles_at(facets: Array, across: Numbers) -> Array:
    """(F, 3): the angle at which a triangle meets that behind the edge across from each corner [rad].

    The arguments are those of `smoothness`. Beside a triangle without area every angle is above pi.
    """
    has_area = np.array(facets.any(axis=1))
    known = has_area[:, None] & has_area[across]
    return np.where(known, _between(facets[:, None], facets[across]), _ABOVE_PI)


def smoothness(
    corners: Array, facets: Array, doubled: Array, across: Numbers, fan_of: Numbers, angles: Array, steep: Flags
) -> Smoothness:
    """How the triangles of a closed mesh join.

    corners : (F, 3, 3) [m]. facets : (F, 3), unit normals, 0 without area. doubled : (F,), twice the areas [m^2].
    across : (F, 3), the triangle behind the edge across from each corner. fan_of : (3F,), the group of each corner:
    corners around a vertex without a steep edge between them. angles : (F, 3), as `angles_at` returns them. steep :
    (F, 3), edges that are sharp in any case.
    """
    f, k = np.nonzero((angles < _PLANAR) & ~steep)
    face_of = linked_groups(len(facets), f, across[f, k])[1]
    count = int(face_of.max()) + 1
    normals = group_sums(face_of, doubled[:, None] * facets, count)
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    f, k = np.nonzero(~steep)
    bent = face_of[f] != face_of[across[f, k]]
    f, k = f[bent], k[bent]
    beside = np.unique(np.stack([face_of[f], face_of[across[f, k]]]), axis=1)
    centres, ringlike = _centres(corners, doubled, face_of, count)
    one, other, way = _around(centres, face_of, fan_of)
    near = _between(normals[one], normals[other]) <= _FARTHEST
    one, other, way = one[near], other[near], way[near]
    one, other = np.concatenate([one, face_of[f]]), np.concatenate([other, face_of[across[f, k]]])
    way = np.concatenate([way, centres[across[f, k]] - centres[f]])
    first = np.unique(one * count + other, return_index=True)[1]
    kept = ringlike[one] | ringlike[other]
    kept[first] = True
    one, other, way = one[kept], other[kept], way[kept]
    curved, level = _bends(normals, one, other, way, count)
    curved &= np.bincount(beside[0], curved[beside[1]], count) > 0
    around = np.maximum(np.bincount(one, minlength=count), 1)
    curved |= np.bincount(one, curved[other], count) / around > _MOST
    smooth = curved[face_of][:, None] | curved[face_of][across]
    harmless = angles * _heights(corners, doubled, across) / 8.0 < _HARMLESS_M
    smooth |= harmless
    smooth &= ~steep
    turns: Array = np.where(smooth, angles, 0.0).max(axis=1)
    areas = np.bincount(face_of, doubled, count).astype(np.float64)
    return Smoothness(~smooth, level[face_of] & ~curved[face_of] & ~harmless.any(axis=1), areas[face_of], turns)


def _bends(normals: Array, face: Numbers, beside: Numbers, way: Array, count: int) -> tuple[Flags, Flags]:
    """Which planar faces are curved, and which are level.

    normals : of the planar faces. face, beside : (N,), pairs of neighbours. way : (N, 3), from one to the other [m].
    """
    frames = _frames(normals)
    way = np.einsum("nij,nj->ni", frames[face], way)
    turn = np.einsum("nij,nj->ni", frames[face], normals[beside] - normals[face])
    squares = np.maximum((way * way).sum(axis=1), 1e-300)
    spread = group_sums(face, (way[:, :, None] * way[:, None] / squares[:, None, None]).reshape(-1, 4), count)
    spread += _UNKNOWN * np.maximum(np.bincount(face, minlength=count), 1)[:, None] * np.eye(2).reshape(-1)
    moments = group_sums(face, (turn[:, :, None] * way[:, None] / squares[:, None, None]).reshape(-1, 4), count)
    fitted = moments.reshape(-1, 2, 2) @ np.linalg.inv(spread.reshape(-1, 2, 2))
    strengths, directions = np.linalg.eigh(0.5 * (fitted + fitted.transpose(0, 2, 1)))
    strong = np.abs(strengths) >= _STRONG * np.abs(strengths).max(axis=1, keepdims=True)
    curved, ends = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    for k in range(2):
        along = directions[face, :, k]
        forward, bent = (way * along).sum(axis=1), (turn * along).sum(axis=1)
        bends, angles = [], []
        for sign in (1.0, -1.0):
            there = sign * forward > _ASIDE * np.sqrt(squares)
            number = np.bincount(face, there, count)
            angles.append(np.bincount(face, there * sign * bent, count) / np.where(number, number, np.nan))
            weight = np.where(there, 1.0 / squares, 0.0)
            total = np.bincount(face, weight * forward * forward, count)
            bends.append(np.bincount(face, weight * bent * forward, count) / np.where(total, total, np.nan))
        both = np.isfinite(bends[0]) & np.isfinite(bends[1])
        curved |= strong[:, k] & both & (_alike(*bends) | _alike(*angles))
        ends |= strong[:, k] & ~both
    return curved & ~ends, ~curved & ~ends


def _alike(one: Array, other: Array) -> Flags:
    """Whether these bends [1/m] or angles [rad] have the same sign, and about the same size."""
    least, most = np.fmin(np.abs(one), np.abs(other)), np.fmax(np.abs(one), np.abs(other))
    found: Flags = (one * other > 0.0) & (least >= _ALIKE * most)
    return found


def _between(one: Array, other: Array) -> Array:
    """The angles between unit vectors [rad]; exact for small ones."""
    found: Array = 2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(one - other, axis=-1), 0.0, 1.0))
    return found


def _heights(corners: Array, doubled: Array, across: Numbers) -> Array:
    """(F, 3): the extent of the two triangles at an edge, across the edge: the larger one [m]."""
    lengths = np.stack([np.linalg.norm(corners[:, k - 1] - corners[:, k - 2], axis=1) for k in range(3)], axis=1)
    own = np.maximum(doubled[:, None], doubled[across])
    found: Array = own / np.maximum(lengths, 1e-300)
    return found


def linked_groups(count: int, one: Numbers, other: Numbers) -> tuple[int, Numbers]:
    """The number of groups, and the group of each of `count` things (count,): one[i] and other[i] share one."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    links = coo_matrix((np.ones(len(one), np.int8), (one, other)), (count, count))
    groups, group_of = connected_components(links, False)
    return int(groups), group_of.astype(np.int64)


def _centres(corners: Array, doubled: Array, face_of: Numbers, count: int) -> tuple[Array, Flags]:
    """(F, 3): for each triangle its planar face's centroid; its own if that is outside of the face, as with a ring.

    Also returns which planar faces are such (count,).
    """
    own = corners.mean(axis=1)
    weights = np.maximum(np.bincount(face_of, doubled, count), 1e-300)[:, None]
    centres = (group_sums(face_of, doubled[:, None] * own, count) / weights)[face_of]
    sides = np.cross(corners[:, [1, 2, 0]] - corners, centres[:, None] - corners)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inside = (np.einsum("fkj,fj->fk", sides, normals) >= -1e-9 * doubled[:, None] ** 2).all(axis=1)
    ringlike = np.bincount(face_of, inside, count) == 0.0
    return np.where(ringlike[face_of, None], own, centres), ringlike


def _around(centres: Array, face_of: Numbers, fan_of: Numbers) -> tuple[Numbers, Numbers, Array]:
    """Pairs of planar faces that meet at a corner: two numbers (N,), and the way between their parts there (N, 3)."""
    corner, face = fan_of, face_of.repeat(3)
    _, member = np.unique(corner * (int(face.max()) + 1) + face, return_inverse=True)
    number = int(member.max()) + 1
    share = np.bincount(member, minlength=number)[:, None]
    parts = group_sums(member, centres.repeat(3, axis=0), number) / share
    fan, of = np.zeros(number, np.int64), np.zeros(number, np.int64)
    fan[member], of[member] = corner, face
    starts = np.searchsorted(fan, np.arange(int(fan.max()) + 2))
    sizes = np.diff(starts)
    pairs = [np.zeros((2, 0), np.int64)]
    for size in range(2, _MOST_AROUND + 1):
        members = starts[:-1][sizes == size][:, None] + np.arange(size)
        one, other = np.nonzero(~np.eye(size, dtype=bool))
        pairs.append(np.stack([members[:, one].reshape(-1), members[:, other].reshape(-1)]))
    one, other = np.concatenate(pairs, axis=1)
    return of[one], of[other], parts[other] - parts[one]


def _frames(normals: Array) -> Array:
    """(N, 2, 3): two unit vectors across each normal."""
    helper = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    one = np.cross(normals, helper)
    one /= np.maximum(np.linalg.norm(one, axis=1), 1e-300)[:, None]
    return np.stack([one, np.cross(normals, one)], axis=1)


def group_sums(of: Numbers, values: Array, count: int) -> Array:
    """(count, n): the sums of the rows (m, n) of each group."""
    return np.stack([np.bincount(of, column, count) for column in values.T], axis=1).astype(np.float64)
