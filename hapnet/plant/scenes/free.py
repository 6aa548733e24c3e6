"""Free space."""

from __future__ import annotations

from hapnet.plant.worlds.scene import STEP_MAX_S, STEP_MIN_S, Scene, checked_dof


def free(*, dof: int = 1, step_min_s: float = STEP_MIN_S, step_max_s: float = STEP_MAX_S) -> Scene:
    """Free space."""
    return Scene("free", checked_dof(dof), (), step_min_s, step_max_s)
