"""A world that lies: it sends a random plane with every answer."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hapnet import Plane
from hapnet.checks import Vector


def lying_planes(rng: np.random.Generator) -> Callable[[Vector, float], tuple[Plane, ...]]:
    """A world's `planes` that gives a random one each time."""

    def planes(position: Vector, reach_m: float) -> tuple[Plane, ...]:
        normal = rng.standard_normal(len(position))
        normal /= np.linalg.norm(normal)
        offset = float(normal @ np.array(position)) + rng.uniform(-0.02, 0.02)
        return (Plane(tuple(normal.tolist()), offset, 10 ** rng.uniform(2.0, 4.5), 10.0),)

    return planes
