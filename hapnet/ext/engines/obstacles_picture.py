"""The picture of a user-defined world: the shapes of its obstacles.

An obstacle without a shape is drawn as a small ball if it moves; if it rests, as the surface that its planes touch, or
its force as a field of arrows.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.ext.engines.obstacle import ObstacleState
from hapnet.ext.solids.field_picture import field, surface
from hapnet.ext.solids.outlines import part_of
from hapnet.ext.solids.rigid_contacts import Solid, padded
from hapnet.ext.solids.shapes import Sphere
from hapnet.ext.solids.shapes_picture import touched
from hapnet.plant.worlds.picture import GREY, RESTS, Color, Part, StillDefaults, Touch, at_rest, shared

_MOVES: Color = (202, 138, 4, 204)
_MARK = Sphere((0.0, 0.0, 0.0), 0.003)


class ObstaclesPicture(StillDefaults):
    """The picture of moving obstacles."""

    def __init__(self, obstacles: Sequence[ObstacleState], dof: int) -> None:
        self._shaped = [body for body in obstacles if body.obstacle.shape is not None]
        self._moving = [body for body in obstacles if body.obstacle.motion is not None or body.obstacle.mass]
        parts: list[Part | None] = []
        for body in obstacles:
            number = self._moving.index(body) if body in self._moving else RESTS
            shape = body.obstacle.shape or (None if number == RESTS else _MARK)
            if shape is not None:
                parts.append(part_of(shape, GREY if number == RESTS else _MOVES, number))
            else:
                parts += _drawn(body, dof)
        self.parts: tuple[Part, ...] = tuple([found for found in parts if found is not None])

    def poses(self) -> Array:
        """The poses of the moving bodies (B, 7): place [m], and unit quaternion w, x, y, z."""
        return at_rest([body.position.tolist() for body in self._moving])

    def touches(self, position: Vector, force: Vector) -> list[Touch]:
        """The places where the proxy is in an obstacle's shape, without friction, as a force law has none."""
        found = []
        for body in self._shaped:
            shape, place = body.obstacle.shape, np.array(padded(body.position.tolist()))
            if shape is None or not any(force):
                continue
            seen = tuple((np.array(padded(position)) - place).tolist())
            if (touch := touched(Solid(shape), seen)) is not None:
                point, normal, friction = touch
                found.append((tuple((np.array(point) + place).tolist()), normal, friction))
        return shared(padded(force), found) if found else []


def _drawn(body: ObstacleState, dof: int) -> tuple[Part, ...]:
    """The picture of an obstacle at rest without a shape."""
    if body.obstacle.planes is not None:
        return surface(lambda place, reach: body.planes(place, 0.0), dof)
    return field(lambda place: body.obstacle.force(place, (0.0,) * dof, 0.0), dof)
