"""The worlds by name.

A world is chosen by name (`make_scene`) or given as ``module:Name``: a class or function in an importable module that
takes keyword arguments and returns a world (`hapnet.plant.worlds.protocol`), most simply a `Scene` of walls:

    def corridor(*, dof: int = 2, width: float = 0.04) -> Scene:
        return Scene("corridor", dof, box_walls(dof, width / 2, 3000.0, 10.0)[:2])

or a `ForceWorld` with obstacles that move. ``module:name`` may also be the force itself, a function of position,
velocity and time, or give an object that steps by itself (`hapnet.plant.worlds.own_worlds.Stepping`). An observer
watches both.

A built-in world is a file in this package and a line in `SCENES`. Rigid scenes are words (`hapnet.plant.worlds.rigid`).
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import partial
from typing import Any

from hapnet.errors import InvalidParameter
from hapnet.loading import published
from hapnet.plant.worlds import own_worlds, rigid
from hapnet.plant.worlds.box import box
from hapnet.plant.worlds.moving_wall import moving
from hapnet.plant.worlds.mujoco_model import PREFIX as MUJOCO
from hapnet.plant.worlds.mujoco_world import MujocoWorld
from hapnet.plant.worlds.protocol import World
from hapnet.plant.worlds.scene import STEP_MAX_S, STEP_MIN_S
from hapnet.plant.worlds.wall import free, paper, wall

GROUP = "hapnet.worlds"
"""The entry points by which other packages publish their worlds under names of their own."""

SCENES: dict[str, Callable[..., World]] = {"free": free, "wall": wall, "box": box, "paper": paper, "moving": moving}


def scene_parameters(name: str) -> dict[str, Any]:
    """The keywords and defaults that `make_scene` accepts for scene `name` (`inspect.Parameter.empty`: no default)."""
    parameters = inspect.signature(_builder(name)).parameters.values()
    return {p.name: p.default for p in parameters if p.kind is not p.VAR_KEYWORD}


def make_scene(name: str, **parameters: Any) -> World:
    """Build the scene `name`: one of `SCENES`, or a user's own given as ``module:Name`` (see above).

    Raises InvalidParameter if there is no such scene, if it does not accept a parameter, or if a value is not allowed.
    """
    builder = _builder(name)
    try:
        inspect.signature(builder).bind(**parameters)
    except TypeError as error:
        known = ", ".join(scene_parameters(name)) or "nothing"
        raise InvalidParameter(f"scene {name}", parameters, f"this scene's parameters ({known}): {error}") from None
    if name in SCENES or name.startswith(MUJOCO) or rigid.builder(name) is not None:
        world: World = builder(**parameters)
        return world
    return own_worlds.made(builder, name, parameters)


def _builder(name: str) -> Callable[..., Any]:
    if name in SCENES:
        return SCENES[name]
    if name.startswith(MUJOCO):
        return partial(_mujoco, name)
    if (from_words := rigid.builder(name)) is not None:
        return from_words
    names = (*SCENES, *rigid.KINDS, *published(GROUP))
    allowed = f"{', '.join(names)}, mujoco:FILE.xml, or module:Name that can be imported"
    return own_worlds.builder(published(GROUP).get(name, (name, ""))[0], allowed, names)


def _mujoco(
    name: str, /, *, dof: int = 3, step_min_s: float = STEP_MIN_S, step_max_s: float = STEP_MAX_S
) -> MujocoWorld:
    return MujocoWorld(name, dof, step_min_s, step_max_s)
