"""A sheet of paper to write on."""

from __future__ import annotations

from math import isfinite

from hapnet.errors import InvalidParameter
from hapnet.plant.worlds.scene import STEP_MAX_S, STEP_MIN_S, Scene
from hapnet.plant.worlds.walls import WALL_DAMPING, WALL_STIFFNESS, Wall, check_number


def paper(
    *,
    dof: int = 3,
    height: float = 0.0,
    stiffness: float = WALL_STIFFNESS,
    damping: float = WALL_DAMPING,
    step_min_s: float = STEP_MIN_S,
    step_max_s: float = STEP_MAX_S,
) -> Scene:
    """A horizontal surface to write on: free where z is above `height` [m]. The mass starts on it."""
    if dof != 3:
        raise InvalidParameter("dof", dof, "3: x and y to write along the paper, z to touch it")
    check_number("height", height, "a finite number [m]", isfinite)
    sheet = Wall((0.0, 0.0, -1.0), -height, stiffness, damping)
    return Scene("paper", dof, (sheet,), step_min_s, step_max_s, (0.0, 0.0, height))
