"""A block with a round hole."""

from __future__ import annotations

from math import hypot, sqrt

import numpy as np

from hapnet import checks
from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.solids.shapes import Near
from hapnet.mechanics.curvature import across
from hapnet.records.vectors import inner


class Hole:
    """The half space behind a plane, with a round hole whose mouth is chamfered.

    at : the middle of the mouth (3,) [m]. normal : into the hole (3,). radius [m]. chamfer : its depth [m]; 0: none.

    Raises InvalidParameter.
    """

    def __init__(self, at: Vector, normal: Vector, radius: float, chamfer: float = 0.0) -> None:
        self.at, direction = checks.vector("at", at, 3), checks.vector("normal", normal, 3)
        size = hypot(*direction)
        if not size > 0.0:
            raise InvalidParameter("normal", normal, "a direction")
        self.normal: Vector = tuple([part / size for part in direction])
        self.radius, self.chamfer = checks.positive("radius", radius), checks.non_negative("chamfer", chamfer)

    @property
    def slope(self) -> float:
        return 1.0

    def near(self, position: Vector) -> Near:
        """Distance [m] and gradient: of the plane, the hole's side or the chamfer, whichever is nearest in front."""
        away = [a - b for a, b in zip(position, self.at, strict=True)]
        deep = inner(away, self.normal)
        aside = [a - deep * n for a, n in zip(away, self.normal, strict=True)]
        out = hypot(*aside)
        inwards = tuple([-part / out for part in aside]) if out else _ANY
        plane = Near(-deep, tuple([-n for n in self.normal]))
        side = Near(self.radius - out, inwards)
        slant = Near(
            (self.radius + self.chamfer - deep - out) / sqrt(2.0),
            tuple([(a - n) / sqrt(2.0) for a, n in zip(inwards, self.normal, strict=True)]),
        )
        return max(plane, side, slant, key=lambda one: one.distance_m)

    @property
    def outline(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices (N, 3) [m] and triangles (M, 3): the plane round the mouth, and the hole's side."""
        n, basis = np.array(self.normal), np.array(across(self.normal))
        turns = np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
        ring = np.stack([np.cos(turns), np.sin(turns)], axis=1) @ basis
        wide = self.radius + self.chamfer
        rows = [4.0 * wide * ring, wide * ring, self.radius * ring + self.chamfer * n]
        rows.append(self.radius * ring + (self.chamfer + 6.0 * self.radius) * n)
        vertices = np.concatenate(rows) + np.array(self.at)
        k = np.arange(_SIDES)
        after = (k + 1) % _SIDES
        faces = []
        for level in range(len(rows) - 1):
            a, b = level * _SIDES, (level + 1) * _SIDES
            faces += [np.stack([a + k, a + after, b + k], 1), np.stack([a + after, b + after, b + k], 1)]
        return vertices, np.concatenate(faces)


_SIDES = 48

_ANY: Vector = (1.0, 0.0, 0.0)
