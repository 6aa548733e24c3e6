"""The worlds by name.

A world is chosen by name (`make_scene`) or given as ``module:Name``: a class or function in an importable module that
takes keyword arguments and returns a world (`hapnet.plant.worlds.protocol`), most simply a `Scene` of walls:

    def corridor(*, dof: int = 2, width: float = 0.04) -> Scene:
        return Scene("corridor", dof, box_walls(dof, width / 2, 3000.0, 10.0)[:2])

A built-in world is a file in this package and a line in `SCENES`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from hapnet.errors import InvalidParameter
from hapnet.loading import cause, load
from hapnet.plant.worlds.box import box
from hapnet.plant.worlds.moving_wall import moving
from hapnet.plant.worlds.protocol import World
from hapnet.plant.worlds.wall import free, paper, wall

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
    if name in SCENES:
        scene: object = builder(**parameters)
    else:
        try:
            scene = builder(**parameters)
        except Exception as error:
            raise InvalidParameter("scene", name, f"a scene that can be built ({cause(error)})") from error
    if not isinstance(scene, World):
        allowed = "a class or function that returns a world, such as a hapnet.plant.worlds.scene.Scene"
        raise InvalidParameter(f"scene {name}", scene, allowed)
    return scene


def _builder(name: str) -> Callable[..., Any]:
    if name in SCENES:
        return SCENES[name]
    builder = load("scene", name, f"{', '.join(SCENES)}, or module:Name that can be imported")
    try:
        inspect.signature(builder)
    except (TypeError, ValueError):
        raise InvalidParameter("scene", name, "module:Name of a class or function with named parameters") from None
    checked: Callable[..., Any] = builder
    return checked
