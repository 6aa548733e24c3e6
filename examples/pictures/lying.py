"""A world with false planes: it sends a random plane with every answer.

hapnet compare --bench hands --set scene=examples.pictures.lying:liar --link 4g --coupling pspm,zoh
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hapnet import Plane
from hapnet.checks import Vector
from hapnet.plant.worlds.moving_wall import MovingWall, Schedule
from hapnet.plant.worlds.scene import along, checked_dof
from hapnet.plant.worlds.walls import WALL_STIFFNESS, Wall


def lying_planes(rng: np.random.Generator) -> Callable[[Vector, float], tuple[Plane, ...]]:
    """A world's method `planes` that returns a random plane each time."""

    def planes(position: Vector, reach_m: float) -> tuple[Plane, ...]:
        normal = rng.standard_normal(len(position))
        normal /= np.linalg.norm(normal)
        offset = float(normal @ np.array(position)) + rng.uniform(-0.02, 0.02)
        return (Plane(tuple(normal.tolist()), offset, 10 ** rng.uniform(2.0, 4.5), 10.0),)

    return planes


class Liar(MovingWall):
    """A resting wall that sends false planes. `rng` draws them."""

    def __init__(self, wall: Wall, rng: np.random.Generator) -> None:
        super().__init__(Schedule(wall))
        self._lies = lying_planes(rng)

    def planes(self, position: Sequence[float], reach_m: float) -> tuple[Plane, ...]:
        return self._lies(tuple(position), reach_m)


def liar(*, dof: int = 1, position: float = 0.02, seed: int = 0) -> Liar:
    """The scene `wall` with false planes."""
    return Liar(Wall(along(checked_dof(dof), 0, 1.0), position, WALL_STIFFNESS), np.random.default_rng(seed))
