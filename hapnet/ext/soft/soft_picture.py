"""The picture of a soft body: its surface, coloured by strain, and the ball.

Each colour is a separate shell: it lies slightly outside the surface where the strain is larger than the colour's
strain, and slightly inside where it is smaller. So only vertices have to be sent to move the lines between colours.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.ext.soft.soft_body import corner_normals
from hapnet.ext.soft.soft_contacts import SoftContacts
from hapnet.ext.soft.soft_linear import Indices
from hapnet.ext.solids.outlines import part_of
from hapnet.ext.solids.shapes import Sphere
from hapnet.ext.solids.shapes_picture import parts_of
from hapnet.plant.worlds.picture import SOFT, Color, Part, Touch, at_rest, part

COLORS: tuple[tuple[float, Color], ...] = (
    (0.0, (226, 150, 140, 255)), (0.05, (240, 190, 90, 255)), (0.1, (235, 125, 50, 255)), (0.2, (200, 40, 40, 255)),
)  # fmt: skip
"""Each colour with the strain from which on it is visible."""

_BALL: Color = (51, 102, 170, 255)
_HAIR_M = 2e-4
_SHARP, _INSIDE = 40.0, -6.0


class SoftPicture:
    """The picture of this body and ball."""

    def __init__(self, contacts: SoftContacts) -> None:
        self._contacts = contacts
        self._used, numbers = np.unique(contacts.body.surface, return_inverse=True)
        self._triangles = numbers.reshape(-1, 3)

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        places = self._contacts.body.x[self._used]
        ball = part_of(Sphere((0.0, 0.0, 0.0), self._contacts.skin.radius), _BALL, 0)
        shells = [part(places, self._triangles, color, SOFT, smooth=True) for _, color in COLORS]
        return (*shells, *(() if ball is None else (ball,)), *parts_of(self._contacts.solids.solids))

    def poses(self) -> Array:
        """The ball's pose."""
        return at_rest([self._contacts.centre.tolist()])

    def soft(self) -> Array:
        """The vertices of all shells, one after another."""
        contacts = self._contacts
        strains, normals = contacts.body.nodal_strains()[self._used], contacts.body.turned_normals()[self._used]
        places = contacts.body.x[self._used]
        hairs = [np.clip(_SHARP * (strains - least), _INSIDE, 1.0) if least else 0.0 * strains for least, _ in COLORS]
        shells = [places + (_HAIR_M * i * hair)[:, None] * normals for i, hair in enumerate(hairs)]
        return np.concatenate(shells)

    def touches(self, position: Vector, force: Vector) -> list[Touch]:
        """Return the contacts that push the ball: points of the body, and solids."""
        contacts, first = self._contacts, self._contacts.points
        which = np.flatnonzero(contacts.forces.any(axis=1) & (contacts.by_ball > 0.0))
        body, solids = which[which < first], which[which >= first]
        points, normals = contacts.places(contacts.body.x)[body], contacts.outward()[body]
        centres = np.tile(contacts.centre, (len(solids), 1))
        depths, into = contacts.solids.tangents(solids - first, centres)
        places = [*points.tolist(), *(centres + (contacts.skin.radius - depths)[:, None] * into).tolist()]
        mu = contacts.friction(which, np.concatenate([points, centres])).tolist()
        pushes = (-contacts.forces[which]).tolist()
        return [
            Touch(tuple(place), tuple(normal), each, tuple(push))
            for place, normal, each, push in zip(
                places, [*normals.tolist(), *(-into).tolist()], mu, pushes, strict=True
            )
        ]


def strains_shown(shells: Array, triangles: Indices) -> Array:
    """The strains (V,) that the shells (4, V, 3) show, from their distances to the surface: up to some 22 %."""
    normals, found = corner_normals(shells[0], triangles), np.zeros(len(shells[0]))
    for i, (least, _) in enumerate(COLORS[1:], 1):
        hairs = ((shells[i] - shells[0]) * normals).sum(axis=1) / (_HAIR_M * i)
        found = np.where(hairs > _INSIDE + 0.5, np.maximum(found, least + hairs / _SHARP), found)
    return np.maximum(found, 0.0)
