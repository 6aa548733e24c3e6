"""Pictures of solids: of a rigid scene at rest, and of an engine's bodies with their poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from math import hypot

import numpy as np
from numpy.typing import ArrayLike

from hapnet.checks import Array, Vector
from hapnet.ext.solids.friction import at
from hapnet.ext.solids.outlines import part_of
from hapnet.ext.solids.rigid_contacts import Solid, padded
from hapnet.ext.solids.shapes import Offset, Shape
from hapnet.mechanics.plane import Plane
from hapnet.plant.worlds.picture import GREY, Part, StillDefaults, Touch, shared


class ShapesPicture(StillDefaults):
    """Moving bodies: their `shapes`, a function that returns their `poses` (B, 7), and a function that returns the
    planes near a place within a reach [m]."""

    def __init__(
        self,
        shapes: Sequence[Shape],
        poses: Callable[[], ArrayLike],
        planes: Callable[[Vector, float], Sequence[Plane] | None],
    ) -> None:
        parts = [part_of(shape, GREY, body) for body, shape in enumerate(shapes)]
        self.parts: tuple[Part, ...] = tuple([found for found in parts if found is not None])
        self._poses, self._planes, self._bodies = poses, planes, len(shapes)

    def poses(self) -> Array:
        """The poses of the moving bodies (B, 7): place [m], and unit quaternion w, x, y, z."""
        return np.asarray(self._poses(), dtype=float).reshape(self._bodies, 7)

    def touches(self, position: Vector, force: Vector) -> list[Touch]:
        """The contacts of the proxy with planes that it is behind."""
        found = []
        for plane in (self._planes(position, 0.0) or ()) if any(force) else ():
            if (depth := plane.depth(position)) >= 0.0:
                point = tuple([x - depth * n for x, n in zip(position, plane.normal, strict=True)])
                found.append((padded(point), padded([-n for n in plane.normal]), plane.friction))
        return shared(padded(force), found) if found else []


class SolidsPicture(StillDefaults):
    """Solids at rest."""

    def __init__(self, solids: Sequence[Solid]) -> None:
        self._solids = tuple(solids)

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        return parts_of(self._solids)

    def touches(self, position: Vector, force: Vector) -> list[Touch]:
        """The contacts of a proxy at `position` (n,) [m] with `force` (n,) [N] in all."""
        if not any(force):
            return []
        return shared(padded(force), [found for solid in self._solids if (found := touched(solid, padded(position)))])


def touched(solid: Solid, place: Vector) -> tuple[Vector, Vector, float] | None:
    """The surface point nearest to a proxy at `place` (3,) [m], the normal there, and mu; None: it is outside."""
    distance, gradient = solid.shape.near(place)
    length = hypot(*gradient)
    if distance > 0.0 or not length:
        return None
    normal = tuple([part / length for part in gradient])
    point = tuple([x - distance / length * n for x, n in zip(place, normal, strict=True)])
    return point, normal, at(solid.friction, place)


def parts_of(solids: Sequence[Solid]) -> tuple[Part, ...]:
    """The parts of solids at rest; solids of a kind without an outline are left out."""
    outer = [solid.shape for solid in solids if not isinstance(solid.shape, Offset)]  # a layer is not drawn
    return tuple([found for shape in outer if (found := part_of(shape)) is not None])
