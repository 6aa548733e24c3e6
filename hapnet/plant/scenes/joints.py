"""A world of joints with stops."""

from __future__ import annotations

from hapnet.params import WallParams
from hapnet.plant.scenes.box import box_walls
from hapnet.plant.worlds.scene import STEP_MAX_S, STEP_MIN_S, Scene
from hapnet.plant.worlds.walls import WALL_DAMPING, WALL_STIFFNESS
from hapnet.units import RADIANS


def joints(
    *,
    dof: int = 3,
    size: float = WallParams().half_width_m,
    stiffness: float = WALL_STIFFNESS,
    damping: float = WALL_DAMPING,
    step_min_s: float = STEP_MIN_S,
    step_max_s: float = STEP_MAX_S,
) -> Scene:
    """Joints that turn freely between stops at +-`size` [rad], for arms with ?axes=joints; Nm/rad and kg m^2."""
    return Scene("joints", dof, box_walls(dof, size, stiffness, damping), step_min_s, step_max_s, units=RADIANS)
