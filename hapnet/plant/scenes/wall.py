"""A flat wall."""

from __future__ import annotations

from math import isfinite

from hapnet.params import WallParams
from hapnet.plant.worlds.scene import STEP_MAX_S, STEP_MIN_S, Scene, along, checked_dof
from hapnet.plant.worlds.walls import WALL_DAMPING, WALL_STIFFNESS, Wall, check_number


def wall(
    *,
    dof: int = 1,
    position: float = WallParams().position_m,
    stiffness: float = WALL_STIFFNESS,
    damping: float = WALL_DAMPING,
    step_min_s: float = STEP_MIN_S,
    step_max_s: float = STEP_MAX_S,
) -> Scene:
    """The paper's wall (section 4): solid where the first coordinate is beyond `position` [m]."""
    check_number("position", position, "a finite number [m]", isfinite)
    plane = Wall(along(checked_dof(dof), 0, 1.0), position, stiffness, damping)
    return Scene("wall", dof, (plane,), step_min_s, step_max_s)
