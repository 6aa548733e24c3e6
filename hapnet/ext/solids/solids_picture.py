"""The picture of a rigid scene."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from math import hypot

from hapnet.checks import Vector
from hapnet.ext.solids.friction import at
from hapnet.ext.solids.outlines import part_of
from hapnet.ext.solids.rigid_contacts import Solid, padded
from hapnet.ext.solids.shapes import Offset
from hapnet.plant.worlds.picture import Part, StillDefaults, Touch, shared


class SolidsPicture(StillDefaults):
    """Solids that rest."""

    def __init__(self, solids: Sequence[Solid]) -> None:
        self._solids = tuple(solids)

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        return parts_of(self._solids)

    def touches(self, position: Vector, force: Vector) -> list[Touch]:
        """As `hapnet.plant.worlds.picture.Picture`."""
        if not any(force):
            return []
        return shared(padded(force), [found for solid in self._solids if (found := touched(solid, padded(position)))])


def touched(solid: Solid, place: Vector) -> tuple[Vector, Vector, float] | None:
    """Where the surface is in front of a proxy at `place` (3,) [m], the normal there, and mu; None: it is outside."""
    distance, gradient = solid.shape.near(place)
    length = hypot(*gradient)
    if distance > 0.0 or not length:
        return None
    normal = tuple([part / length for part in gradient])
    point = tuple([x - distance / length * n for x, n in zip(place, normal, strict=True)])
    return point, normal, at(solid.friction, place)


def parts_of(solids: Sequence[Solid]) -> tuple[Part, ...]:
    """The parts of solids that rest; those of a kind that nobody knows are left out."""
    outer = [solid.shape for solid in solids if not isinstance(solid.shape, Offset)]  # a layer is not seen
    return tuple([found for shape in outer if (found := part_of(shape)) is not None])
