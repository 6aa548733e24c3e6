"""The planes that a device renders of a soft body: how its force grows where the ball presses, as springs in parallel.

For the ball a little further in, by delta along the mean normal n, the points' pushes F >= 0 solve

    F_i / k = max(0, d_i + delta n_i . n - sum_j G_ij (F_j - F0_j))

with the present depths d and pushes F0, and G the static compliance of the points along their normals, by the factor at
rest, turned as the body is now. The force along n is convex in delta: more points touch. So a few planes with the same
normal, each from its own depth on, are its piecewise linear course, the part before the present depth too: there the
device meets a body that is still in the shape in which it was not touched.
"""

from __future__ import annotations

from math import hypot
from typing import TYPE_CHECKING

import numpy as np

from hapnet.checks import MOST_PLANES, Array
from hapnet.mechanics.curvature import Curvature, Curvatures, across
from hapnet.mechanics.plane import Plane

if TYPE_CHECKING:
    from hapnet.plant.worlds.soft_contacts import SoftContacts
    from hapnet.plant.worlds.soft_linear import Indices

_MOST = 24
_ROUNDS = 30
_AHEAD_M = (0.0, 0.002, 0.006)
"""Where the course is computed, besides where it begins."""

_FLAT_PER_M = 2.0
_SLIGHT = 0.01
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
    near = np.argsort(-depths)[:_MOST]
    near = near[depths[near] > depths[deepest] - 0.5 * contacts.skin.radius]
    weight = np.maximum(depths[near], 0.0)
    n = weight @ normals[near] if weight.any() else normals[deepest]
    n = n / np.linalg.norm(n)
    slant = normals[near] @ n
    near, slant = near[slant > 0.1], slant[slant > 0.1]
    course = Course(contacts, near, normals[near], depths[near], slant)
    begin = course.begin()
    knots = np.array(sorted({begin, *(begin + ahead if begin > 0.0 else ahead for ahead in _AHEAD_M)}))
    forces = np.array([course.force(delta) for delta in knots])
    slopes = np.maximum.accumulate(np.diff(forces) / np.diff(knots))
    more = np.diff(slopes, prepend=0.0)
    skin, bends = contacts.skin, _curvatures(contacts, int(near[0]), n)
    unit, along, beta = tuple(n.tolist()), float(n @ centre), contacts.body.beta_s
    return [
        Plane(unit, along + knot, k, beta * k, 0.0, bends, skin.friction)
        for knot, k in zip(knots.tolist(), more.tolist(), strict=False)
        if k > _SLIGHT * slopes[-1]
    ]


def _cut(plane: Plane, dof: int) -> Plane | None:
    """The plane for a ball with fewer axes, which feels what is along them; None: next to nothing."""
    unit = plane.normal[:dof]
    if dof == 3 or (size := hypot(*unit)) < 0.1:
        return plane if dof == 3 else None
    return plane._replace(
        normal=tuple([part / size for part in unit]), offset_m=plane.offset_m / size,
        stiffness=plane.stiffness * size * size, damping=plane.damping * size * size, curvatures=(), effects=None,
    )  # fmt: skip


class Course:
    """The force on the ball as it goes further in."""

    def __init__(self, contacts: SoftContacts, points: Indices, normals: Array, depths: Array, slant: Array) -> None:
        compliance = contacts.compliance(points, normals)
        self._depths, self._slant = depths, slant
        self._pushes = contacts.skin.stiffness * np.maximum(depths, 0.0)
        self._still = depths + compliance @ self._pushes  # depths in the shape without these contacts
        self._matrix = compliance + np.eye(len(points)) / contacts.skin.stiffness

    def begin(self) -> float:
        """The delta at which the first point touches the body as it is without the ball [m]."""
        return float((-self._still / self._slant).min())

    def force(self, delta: float) -> float:
        """[N] along n, by a semismooth Newton's method for the pushes."""
        wanted = self._still + delta * self._slant
        active = wanted > 0.0
        pushes = np.zeros(len(wanted))
        for _ in range(_ROUNDS):
            pushes[:] = 0.0
            which = np.flatnonzero(active)
            pushes[which] = np.linalg.solve(self._matrix[np.ix_(which, which)], wanted[which])
            left = wanted - self._matrix @ pushes
            changed = np.where(active, pushes > 0.0, left > 1e-9)
            if np.array_equal(changed, active):
                break
            active = changed
        return float(np.maximum(pushes, 0.0) @ self._slant)


def _curvatures(contacts: SoftContacts, first: int, n: Array) -> Curvatures:
    """How the surface bends where no ball is: by the normals at rest around the point, as far as the ball is wide.

    What touches the ball's centre is the surface moved by its radius: ``k/(1 + k r)``.
    """
    rest = contacts.rest[: contacts.points]
    near = np.flatnonzero(((rest - rest[first]) ** 2).sum(axis=1) < (1.5 * contacts.skin.radius) ** 2)
    facing = contacts.outward_at_rest[first]
    basis = np.array(across(tuple(facing.tolist())))
    way = (rest[near] - rest[first]) @ basis.T
    change = (contacts.outward_at_rest[near] - facing) @ basis.T
    shape, *_ = np.linalg.lstsq(way, change, rcond=None)
    values, directions = np.linalg.eigh(0.5 * (shape + shape.T))
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
    """The second direction is across the first one."""
    first = np.array(found[0].direction)
    second = np.cross(n, first)
    return (found[0], Curvature(tuple((second / np.linalg.norm(second)).tolist()), found[1].per_m))
