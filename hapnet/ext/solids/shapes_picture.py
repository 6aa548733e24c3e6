"""The picture of an engine that says which shapes its bodies have, and how these lie."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from hapnet.checks import Array, Vector
from hapnet.ext.solids.outlines import part_of
from hapnet.ext.solids.rigid_contacts import padded
from hapnet.ext.solids.shapes import Shape
from hapnet.mechanics.plane import Plane
from hapnet.plant.worlds.picture import GREY, Part, StillDefaults, Touch, shared


class ShapesPicture(StillDefaults):
    """Bodies while they move: their `shapes`, a function that gives their `poses` (B, 7), and one that gives the planes
    near a place within a reach [m]."""

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
        """As `hapnet.plant.worlds.picture.Picture`."""
        return np.asarray(self._poses(), dtype=float).reshape(self._bodies, 7)

    def touches(self, position: Vector, force: Vector) -> list[Touch]:
        """Where the proxy is behind a plane."""
        found = []
        for plane in (self._planes(position, 0.0) or ()) if any(force) else ():
            if (depth := plane.depth(position)) >= 0.0:
                point = tuple([x - depth * n for x, n in zip(position, plane.normal, strict=True)])
                found.append((padded(point), padded([-n for n in plane.normal]), plane.friction))
        return shared(padded(force), found) if found else []
