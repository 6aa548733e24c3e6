"""The scene of a run, from its parameters."""

from __future__ import annotations

from typing import Any

from hapnet.errors import InvalidParameter
from hapnet.mechanics.pose import DOF
from hapnet.params import Params
from hapnet.plant.worlds.protocol import World
from hapnet.plant.worlds.registry import is_own, make_scene, scene_parameters
from hapnet.units import POSE

_DEFAULTS = Params()

SCENE_PARAMETERS = {
    "stiffness": "world.wall.stiffness",
    "damping": "world.wall.damping",
    "position": "world.wall.position_m",
    "size": "world.wall.half_width_m",
    "timeline": "world.wall.timeline",
    "step_min_s": "world.step_min_s",
    "step_max_s": "world.step_max_s",
}
"""A scene's keyword, and the parameter that it gets."""


def scene_of(params: Params) -> tuple[World, list[str]]:
    """The scene, and a warning for each parameter that was set but that the scene does not read."""
    known, named = scene_parameters(params.scene), not is_own(params.scene)
    values: dict[str, Any] = {"dof": params.dof} if params.dof and "dof" in known else {}
    warnings = {}
    for keyword, name in SCENE_PARAMETERS.items():
        value = params.get(name)
        changed = value != _DEFAULTS.get(name)
        if keyword in known:
            if named or changed:  # a scene of the user's own has defaults of its own
                values[keyword] = value
        elif changed:
            shown = repr(value) if isinstance(value, str) else f"{value:g}"
            warnings[keyword] = f"{name} is {shown}, but the scene {params.scene} does not read it"
    try:
        scene = make_scene(params.scene, **values)
        if params.dof not in (0, scene.dof, DOF if scene.units == POSE else 0):
            raise InvalidParameter("dof", params.dof, f"0 or {scene.dof}: the scene {params.scene} sets its own")
        if scene.steps_between(params.world.step_min_s, params.world.step_max_s):
            warnings = {keyword: one for keyword, one in warnings.items() if not keyword.startswith("step_")}
        return scene, [*warnings.values()]
    except InvalidParameter as error:
        keyword, _, entry = error.name.partition(" ")  # a timeline names its entry
        if keyword not in SCENE_PARAMETERS:
            raise
        name = SCENE_PARAMETERS[keyword]
        if entry:
            raise InvalidParameter(f"{name}, {entry}", error.value, error.allowed) from error
        raise InvalidParameter(name, params.get(name), error.allowed) from error
