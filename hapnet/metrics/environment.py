"""The force that the true environment would have: the walls, felt at once through the springs that the user gave."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import groupby

import numpy as np

from hapnet.checks import Array
from hapnet.metrics.obstacles import Obstacle


def environment_force(
    position: Array,
    times: Sequence[float],
    walls: Callable[[float], Iterable[Obstacle]],
    stiffness: Callable[[Obstacle], float],
) -> Array:
    """Force of the true environment on a device at `position` (N, n) [m]: (N, n) [N].

    It is what a local, ideal rendering without delay would give there at rest: each wall pushes the device out along
    its normal, with the stiffness of the springs and the wall in series, and free space does nothing. So it is the same
    environment for all couplings (the "transparency" of D. A. Lawrence 1993 is that its force is felt), while drag, lag
    and softness of a coupling all count as its error.

    Parameters
    ----------
    times : of the positions [s]. walls : those that stand at such a time. stiffness : of a wall in series with the
        springs [N/m].
    """
    pieces = []
    first = 0
    for standing, group in groupby(tuple(walls(t)) for t in times):
        piece = slice(first, first := first + sum(1 for _ in group))
        pieces.append(standing_force(position[piece], standing, stiffness))
    return np.concatenate(pieces)


def standing_force(position: Array, walls: Iterable[Obstacle], stiffness: Callable[[Obstacle], float]) -> Array:
    """As `environment_force`, of walls that do not change."""
    force = np.zeros_like(position)
    for wall in walls:
        depth = np.maximum(wall.depths(position), 0.0)
        force -= stiffness(wall) * (depth[:, None] * wall.normals(position))
    return force
