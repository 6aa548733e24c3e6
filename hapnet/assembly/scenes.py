"""The scene of a run, from its parameters."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from hapnet.assembly.choices import Choice
from hapnet.errors import InvalidParameter
from hapnet.mechanics.pose import DOF
from hapnet.param_sources import SCENE
from hapnet.params import Params
from hapnet.plant.worlds.protocol import World
from hapnet.plant.worlds.registry import is_own, make_scene, named_parameters, scene_parameters
from hapnet.units import POSE

SCENE_PARAMETERS = {
    "stiffness": "world.wall.stiffness",
    "damping": "world.wall.damping",
    "position": "world.wall.position_m",
    "size": "world.wall.half_width_m",
    "timeline": "world.wall.timeline",
    "step_min_s": "world.step_min_s",
    "step_max_s": "world.step_max_s",
}
"""Keywords of scenes, and the parameter for each."""


def scene_defaults(params: Params) -> Choice:
    """Choose the values in the scene's name, and the scene's own defaults for parameters that are not set.

    Raises InvalidParameter: the user set another value than the scene's name does.
    """
    found: dict[str, object] = {}
    for keyword, value in named_parameters(params.scene).items():
        if (name := SCENE_PARAMETERS.get(keyword)) is not None:
            params.require(name, value, f"{value!r}, or left out: the scene {params.scene} sets it")
            found[name] = value
    own = is_own(params.scene)
    for keyword, value in scene_parameters(params.scene).items():
        name = SCENE_PARAMETERS.get(keyword)
        if name is not None and name not in params.given and (own or value != params.get(name)):
            with suppress(InvalidParameter):  # none, or of another type: then the scene uses its own default
                found |= params.typed({name: value})
    return Choice(found, SCENE)


def scene_of(params: Params) -> World:
    """Make the scene of these parameters.

    Raises InvalidParameter: it cannot be made with them, or does not read a parameter that the user set.
    """
    scene = _made(params)
    for name in _unread(params, scene):
        why = f"the scene {params.scene} does not read it; leave it out"
        raise InvalidParameter(name, params.get(name), "", why=why)
    return scene


def for_its_scene(params: Params) -> Params:
    """Return a copy without parameters that were set for another scene. Raises InvalidParameter."""
    if not any(params.asked(name) for name in SCENE_PARAMETERS.values()):
        return params
    return params.unset(*_unread(params, _made(params)))


def _unread(params: Params, scene: World) -> list[str]:
    """The parameters that the user set and the scene does not read."""
    known = {*scene_parameters(params.scene), *named_parameters(params.scene)}
    if scene.steps_between(params.world.step_min_s, params.world.step_max_s):
        known |= {"step_min_s", "step_max_s"}
    return [name for keyword, name in SCENE_PARAMETERS.items() if keyword not in known and params.asked(name)]


def _made(params: Params) -> World:
    known, own = scene_parameters(params.scene), is_own(params.scene)
    values: dict[str, Any] = {"dof": params.dof} if params.dof and "dof" in known else {}
    for keyword, name in SCENE_PARAMETERS.items():
        if keyword not in known or (own and name not in params.given):  # no parameter has the type of its default
            continue
        values[keyword] = params.get(name)
    try:
        scene = make_scene(params.scene, **values)
        if params.dof not in (0, scene.dof, DOF if scene.units == POSE else 0):
            raise InvalidParameter("dof", params.dof, f"0 or {scene.dof}: the scene {params.scene} sets its own")
        return scene
    except InvalidParameter as error:
        keyword, _, entry = error.name.partition(" ")  # a timeline names its entry
        if keyword not in SCENE_PARAMETERS:
            raise
        name = SCENE_PARAMETERS[keyword]
        if entry:
            raise error.renamed(f"{name}, {entry}") from error
        raise error.renamed(name, params.get(name)) from error
