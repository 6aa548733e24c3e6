"""A wall that a timeline moves."""

from __future__ import annotations

from math import isfinite

from hapnet.params import WallParams
from hapnet.plant.worlds.moving_wall import MovingWall, Schedule
from hapnet.plant.worlds.scene import STEP_MAX_S, STEP_MIN_S, along, checked_dof
from hapnet.plant.worlds.walls import WALL_DAMPING, WALL_STIFFNESS, Wall, check_number


def moving(
    *,
    dof: int = 1,
    position: float = WallParams().position_m,
    stiffness: float = WALL_STIFFNESS,
    damping: float = WALL_DAMPING,
    timeline: str = WallParams().timeline,
    step_min_s: float = STEP_MIN_S,
    step_max_s: float = STEP_MAX_S,
) -> MovingWall:
    """The scene `wall`, moved by `timeline`."""
    check_number("position", position, "a finite number [m]", isfinite)
    wall = Wall(along(checked_dof(dof), 0, 1.0), position, stiffness, damping)
    return MovingWall(Schedule(wall, timeline), step_min_s, step_max_s)
