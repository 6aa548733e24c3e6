"""The planes of a soft body for a device: springs in parallel that match the growth of its force on the ball.

The ball's centre moves along a mean normal n, to c. The pushes F then displace the surface's points p:

    p_i = o_i + sum_j G_ij n_j F_j,    F_i = k max(0, r - |p_i - c|),    n_i = (p_i - c)/|p_i - c|

with o their places without these pushes, and G the static compliance of the points by the factor at rest, rotated as
the body is now. The force along n is about convex, as more points touch. So a few planes with the same normal, each
from its own depth on, are its piecewise linear course. The course includes the part before the present depth: there the
device meets the shape without contact. It is computed with the ball at each depth, not at its present place: from
there a ball would have the curvature of its distance.
"""

from __future__ import annotations

from math import hypot
from typing import TYPE_CHECKING

import numpy as np

from hapnet.checks import MOST_PLANES, Array
from hapnet.mechanics.curvature import Curvature, Curvatures, across
from hapnet.mechanics.plane import Plane

if TYPE_CHECKING:
    from hapnet.ext.soft.soft_contacts import SoftContacts

_MOST = 40
_ROUNDS, _TURNS = 12, 2
_AHEAD_M = (0.002, 0.006, 0.015)
"""Depths of the course beyond the present depth, or beyond its beginning if the ball does not touch."""

_BESIDE_M = 0.002
"""Points less deep than the deepest point by up to this have a share in the normal, so the mesh itself is not felt."""

_STIFFENS = 0.12
"""Growth of the material's stiffness with the depth over the ball's radius; the compliance is that at rest."""

_FLAT_PER_M = 2.0
_FACING = 0.8
_SLIGHT, _KNOTS = 0.01, 4
"""A plane that adds less than this share of the stiffness is left out."""


def planes_at(contacts: SoftContacts, centre: Array, reach_m: float) -> tuple[Plane, ...]:
    """The planes for a ball at `centre` (3,) [m] that is less than `reach_m` from the body."""
    found = [*_of_body(contacts, centre, reach_m), *contacts.solids.planes(centre, reach_m)]
    cut = [one for plane in found if (one := _cut(plane, contacts.dof)) is not None]
    return tuple(cut[:MOST_PLANES])


def _of_body(contacts: SoftContacts, centre: Array, reach_m: float) -> list[Plane]:
    ball = slice(0, contacts.points)
    depths, normals = contacts.gaps(contacts.places(contacts.body.x)[ball], centre, ball)
    deepest = int(depths.argmax())
    if not depths[deepest] > -reach_m:
        return []
    n = np.maximum(depths + max(0.0, _BESIDE_M - depths[deepest]), 0.0) @ normals
    if not (size := float(np.linalg.norm(n))) > 0.0:
        return []  # between two faces that face each other
    n = n / size
    course = Course(contacts, depths, normals, centre, n)
    if (begin := course.begin()) == np.inf:
        return []
    first = [begin] if begin >= 0.0 else [begin, 0.0]
    knots = np.array([*first, *(first[-1] + ahead for ahead in _AHEAD_M)])[:_KNOTS]
    forces = np.array([0.0, *(course.force(delta) for delta in knots[1:].tolist())])
    slopes = np.maximum.accumulate(np.maximum(np.diff(forces) / np.diff(knots), 0.0))
    more = np.diff(slopes, prepend=0.0)
    skin, bends = contacts.skin, _curvatures(contacts, deepest, n)
    unit, along, beta = tuple(n.tolist()), float(n @ centre), contacts.body.beta_s
    return [
        Plane(unit, along + knot, k, beta * k, 0.0, bends, skin.friction)
        for knot, k in zip(knots.tolist(), more.tolist(), strict=False)
        if k > _SLIGHT * slopes[-1]
    ]


def _cut(plane: Plane, dof: int) -> Plane | None:
    """The plane for a ball with fewer axes, projected on these; None: almost nothing is left."""
    unit = plane.normal[:dof]
    if dof == 3 or (size := hypot(*unit)) < 0.1:
        return plane if dof == 3 else None
    return plane._replace(
        normal=tuple([part / size for part in unit]), offset_m=plane.offset_m / size,
        stiffness=plane.stiffness * size * size, damping=plane.damping * size * size, curvatures=(), effects=None,
    )  # fmt: skip


class Course:
    """The force on the ball as it goes further in, from `centre` along n (3,).

    depths, normals : of all points at present.
    """

    def __init__(self, contacts: SoftContacts, depths: Array, normals: Array, centre: Array, n: Array) -> None:
        radius, body = contacts.skin.radius, contacts.body
        away = contacts.places(body.x)[: contacts.points] - centre
        ahead = away @ n
        aside = (away * away).sum(axis=1) - ahead * ahead
        early = ahead - np.sqrt(np.maximum(radius * radius - aside, 0.0))
        early[(aside > radius * radius) | (depths < -1.0)] = np.inf  # points that the ball misses, or that face away
        near = np.argsort(early)[:_MOST]
        near = np.sort(near[early[near] < np.inf])
        self._k, self._layer, self._factor = contacts.firm[near], contacts.layer, contacts.layer.factor(0.0)
        self._radius, self._centre, self._n, self._first = radius, centre, n, 0.0
        self._G = contacts.compliance(near)
        self._apart = away[near]
        if contacts.still is not None:
            self._still = contacts.still[near] - centre
        else:
            push = (contacts.stiffness[near] * np.maximum(depths[near], 0.0))[:, None] * normals[near]
            moving = body.beta_s * contacts.places(body.mean)[near]
            self._still = self._apart + moving - (self._G @ push.ravel()).reshape(-1, 3)

    def begin(self) -> float:
        """The delta at which the ball first touches the body's shape without the ball [m]."""
        ahead = self._still @ self._n
        aside = (self._still**2).sum(axis=1) - ahead * ahead
        early = ahead - np.sqrt(np.maximum(self._radius**2 - aside, 0.0))
        self._first = float(early.min(initial=np.inf))
        return self._first

    def force(self, delta: float) -> float:
        """The force [N] along n; call it with increasing deltas, as each call begins with the last call's places."""
        c = delta * self._n
        pushes = np.zeros(len(self._still))
        for _ in range(_TURNS):
            n = self._apart - c
            n /= np.maximum(np.linalg.norm(n, axis=1), 1e-9)[:, None]
            wanted = self._radius - ((self._still - c) * n).sum(axis=1)
            k = len(n)
            moves = (self._G.reshape(3 * k, k, 3) * n).sum(axis=2).reshape(k, 3, k)
            along = (n[:, :, None] * moves).sum(axis=1)
            pushes = one_sided(along + np.diag(1.0 / (self._factor * self._k)), wanted)
            self._factor = self._layer.factor(float(pushes.sum()))
            self._apart = self._still + (self._G @ (pushes[:, None] * n).ravel()).reshape(-1, 3)
        return float(pushes @ (n @ self._n)) * (
            1.0 + _STIFFENS * max(0.0, delta - max(0.0, self._first)) / self._radius
        )


def one_sided(matrix: Array, wanted: Array) -> Array:
    """The pushes F >= 0 (k,) with ``matrix F >= wanted``, and equal where F > 0, by a semismooth Newton's method."""
    active, pushes = wanted > 0.0, np.zeros(len(wanted))
    for _ in range(_ROUNDS):
        pushes[:] = 0.0
        which = np.flatnonzero(active)
        pushes[which] = np.linalg.solve(matrix[np.ix_(which, which)], wanted[which])
        changed = np.where(active, pushes > 0.0, wanted - matrix @ pushes > 1e-9)
        if np.array_equal(changed, active):
            break
        active = changed
    return np.maximum(pushes, 0.0)


def _curvatures(contacts: SoftContacts, first: int, n: Array) -> Curvatures:
    """The curvatures of the surface without a ball, from the normals at rest around the point, over the ball's width.

    The surface for the ball's centre is offset by its radius: ``k/(1 + k r)``.
    """
    rest, outward = contacts.rest[: contacts.points], contacts.outward_at_rest[: contacts.points]
    facing = outward[first]
    near = ((rest - rest[first]) ** 2).sum(axis=1) < (1.5 * contacts.skin.radius) ** 2
    near = np.flatnonzero(near & (outward @ facing > _FACING))
    basis = np.array(across(tuple(facing.tolist())))
    travel = (rest[near] - rest[first]) @ basis.T
    height = (rest[near] - rest[first]) @ facing
    a, b = travel.T
    (_, _, aa, ab, bb), *_ = np.linalg.lstsq(
        np.stack([a, b, -0.5 * a * a, -a * b, -0.5 * b * b], axis=1), height, rcond=None
    )
    shape = np.array([[aa, ab], [ab, bb]])
    values, directions = np.linalg.eigh(shape)
    found = []
    for k, (a, b) in zip(values.tolist(), directions.T.tolist(), strict=True):
        if not _FLAT_PER_M < abs(k) < 1.0 / contacts.skin.radius:
            continue
        direction = contacts.turn_of(first) @ (a * basis[0] + b * basis[1])
        direction -= (direction @ n) * n
        size = float(np.linalg.norm(direction))
        if size > 0.5:
            found.append(Curvature(tuple((direction / size).tolist()), k / (1.0 + k * contacts.skin.radius)))
    return tuple(found) if len(found) < 2 else _apart(found, n)


def _apart(found: list[Curvature], n: Array) -> Curvatures:
    """Make the second direction perpendicular to the first."""
    first = np.array(found[0].direction)
    second = np.cross(n, first)
    return (found[0], Curvature(tuple((second / np.linalg.norm(second)).tolist()), found[1].per_m))
