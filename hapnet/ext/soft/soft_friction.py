"""Coulomb's friction of all points of a soft body in one problem, by a semismooth Newton's method.

With N a point's push, g its friction (a force across its normal) and s its speed across it, Coulomb's law is

    g = P(g + s/r),    P(t) = t if |t| <= mu N, else mu N t/|t|

for any r > 0 (Alart and Curnier, Comput. Methods Appl. Mech. Eng. 92, 1991). A round of Newton's method, with mu N of
the last round, takes for each point the derivative of P: a point that sticks has s = 0, one that slides has mu N
along ``e = t/|t|``, and across e a force that turns it into the direction of s. All points are then solved together,
with their pushes and the body's compliance (`soft_touch`). r is the speed by which a force on the point moves it.
"""

from __future__ import annotations

import numpy as np

from hapnet.checks import Array
from hapnet.ext.soft.soft_body import Marks

FIRM = 1e3
"""A point that sticks moves by a change of its friction as through a damper that is this much firmer than the body."""


_TINY = 1e-300


def across(vectors: Array, normals: Array) -> Array:
    """The parts of vectors (k, 3) across unit normals (k, 3)."""
    found: Array = vectors - (vectors * normals).sum(axis=1)[:, None] * normals
    return found


def linearised(rub: Array, slip: Array, most: Array, give: Array, normals: Array) -> tuple[Array, Array]:
    """``g = g0 + J s``: g0 (k, 3) [N] and J (k, 3, 3) [Ns/m], symmetric and not negative, near these forces and speeds.

    rub, slip : g [N] and s [m/s] of the last round (k, 3). most : mu N [N]. give : r [m/s per N]. normals : of unit
    length (k, 3).
    """
    trial, sizes, sticks = _trial(rub, slip, most, give)
    along = trial / np.maximum(sizes, _TINY)[:, None]
    turns = np.minimum(most / np.maximum(give * (sizes - most), _TINY), FIRM / give)
    planes = _planes(normals)
    slides = turns[:, None, None] * (planes - along[:, :, None] * along[:, None, :])
    given = np.where(sticks[:, None], rub, most[:, None] * along)
    return given, np.where(sticks[:, None, None], (FIRM / give)[:, None, None] * planes, slides)


def damped(rub: Array, slip: Array, most: Array, give: Array, normals: Array, is_whole: bool) -> tuple[Array, Array]:
    """As `linearised`, but a point that slides has g0 = 0 and ``J = mu N/|s|``. It converges from afar, but slowly.

    is_whole : so have all points, and then friction takes energy whatever the speeds are found to be.
    """
    sticks = np.zeros(len(rub), dtype=bool) if is_whole else _trial(rub, slip, most, give)[2]
    drag = most / np.maximum(np.linalg.norm(slip, axis=1), np.maximum(most * give / FIRM, _TINY))
    found = np.where(sticks, FIRM / give, drag)
    return np.where(sticks[:, None], rub, 0.0), found[:, None, None] * _planes(normals)


def errors(rub: Array, slip: Array, most: Array, give: Array) -> Array:
    """``|g - P(g + s/r)|`` (k,) [N]: by how much each point misses Coulomb's law."""
    trial, sizes, sticks = _trial(rub, slip, most, give)
    lawful = np.where(sticks, 1.0, most / np.maximum(sizes, _TINY))[:, None] * trial
    return np.asarray(np.linalg.norm(rub - lawful, axis=1))


def _trial(rub: Array, slip: Array, most: Array, give: Array) -> tuple[Array, Array, Marks]:
    """t = g + s/r, its sizes, and which points stick."""
    trial = rub + slip / give[:, None]
    sizes = np.linalg.norm(trial, axis=1)
    return trial, sizes, np.asarray(sizes <= most)


def _planes(normals: Array) -> Array:
    """``I - n n'`` (k, 3, 3)."""
    found: Array = np.eye(3) - normals[:, :, None] * normals[:, None, :]
    return found
