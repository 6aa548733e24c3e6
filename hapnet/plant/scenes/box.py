"""The inside of a box."""

from __future__ import annotations

from math import inf

from hapnet.params import WallParams
from hapnet.plant.worlds.scene import STEP_MAX_S, STEP_MIN_S, Scene, along, checked_dof
from hapnet.plant.worlds.walls import WALL_DAMPING, WALL_STIFFNESS, Wall, check_number


def box(
    *,
    dof: int = 3,
    size: float = WallParams().half_width_m,
    stiffness: float = WALL_STIFFNESS,
    damping: float = WALL_DAMPING,
    step_min_s: float = STEP_MIN_S,
    step_max_s: float = STEP_MAX_S,
) -> Scene:
    """The inside of a box around the origin with half-width `size` [m]; all its faces are solid."""
    return Scene("box", dof, box_walls(checked_dof(dof), size, stiffness, damping), step_min_s, step_max_s)


def box_walls(dof: int, half_width: float, stiffness: float, damping: float) -> tuple[Wall, ...]:
    """Both faces of each axis at ``+-half_width`` [m], axis by axis."""
    check_number("size", half_width, "a positive half-width [m]", lambda size: 0.0 < size < inf)
    return tuple(
        Wall(along(dof, axis, side), half_width, stiffness, damping) for axis in range(dof) for side in (1.0, -1.0)
    )
