"""The worlds by name, and the parameters in the text after a name.

A world is given as one of these:

* ``NAME`` of a file in hapnet/plant/scenes/, or of a world that another package publishes as an entry point of
  `hapnet.worlds`; after it the world's own parameters, as in ``box?size=0.02`` (`&` joins several, in SI units);
* a jaw that grips an object, beside flat walls or alone (`hapnet.ext.solids.grip`), such as ``wall + grip:hard``;
* solids (`hapnet.ext.solids.rigid`), such as ``sphere?radius=20mm``, also with a tool that turns in front
  (`hapnet.ext.tools.scene`), a soft body (`hapnet.ext.soft.soft`), such as ``soft:organ``, or
  ``mujoco:FILE.xml``;
* ``module:Name`` of the user's own (`hapnet.ext.engines.own_worlds`), most simply a function that returns a `Scene`:

      def corridor(*, dof: int = 2, width: float = 0.04) -> Scene:
          return Scene("corridor", dof, box_walls(dof, width / 2, 3000.0, 10.0)[:2])
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import partial
from typing import Any

from hapnet.errors import InvalidParameter
from hapnet.loading import WORLDS, extension, published
from hapnet.plant.scenes import SCENES
from hapnet.plant.worlds.protocol import World

GROUP = "hapnet.worlds"
"""The entry points with which other packages publish their worlds under their own names."""


def about(name: str) -> str:
    """Describe a world of hapnet's own in one line."""
    return (inspect.getdoc(SCENES[name]) or "").partition("\n")[0]


def is_own(name: str) -> bool:
    """Whether the world is the user's own, or another package's. Such a world has its own defaults."""
    return name.partition(" + ")[0].partition("?")[0] not in SCENES


def scene_parameters(name: str) -> dict[str, Any]:
    """The keywords and defaults that `make_scene` accepts for scene `name` (`inspect.Parameter.empty`: no default).

    Keywords that the text after the name sets are left out.
    """
    builder = _builder(name)
    given = builder.keywords if isinstance(builder, partial) else {}
    parameters = inspect.signature(builder).parameters.values()
    return {p.name: p.default for p in parameters if p.kind is not p.VAR_KEYWORD and p.name not in given}


def named_parameters(name: str) -> dict[str, Any]:
    """The keywords that the text after the name of one of hapnet's own worlds sets, as in ``box?size=0.02``."""
    plain, words = _plain(name), name.partition("?")[2]
    return _given(name, words, SCENES[plain]) if plain in SCENES and words else {}


def make_scene(name: str, **parameters: object) -> World:
    """Build the scene `name` (see above).

    Raises InvalidParameter if there is no such scene, if it does not accept a parameter, or if a value is not allowed.
    """
    builder = _builder(name)
    try:
        inspect.signature(builder).bind(**parameters)
    except TypeError as error:
        if not parameters:
            allowed = f"a function of position, velocity and time, or a class without required arguments ({error})"
            raise InvalidParameter("scene", name, allowed) from None
        known = ", ".join(scene_parameters(name)) or "nothing"
        raise InvalidParameter(f"scene {name}", parameters, f"this scene's parameters ({known}): {error}") from None
    made: World
    if not is_own(name) or _described(name) is not None:
        made = builder(**parameters)
    else:
        made = extension("own worlds").made(builder, name, parameters)
    return made


def _builder(name: str) -> Callable[..., Any]:
    if (plain := _plain(name)) in SCENES:
        return partial(SCENES[plain], **named_parameters(name)) if "?" in name else SCENES[plain]
    if (described := _described(name)) is not None:
        return described
    kinds = [one for kind in reversed(WORLDS) for one in extension(kind).FIRST_WORDS]
    names = (*SCENES, *kinds, *published(GROUP))
    allowed = f"{', '.join(names)}, mujoco:FILE.xml, or module:Name that can be imported"
    own: Callable[..., Any] = extension("own worlds").builder(published(GROUP).get(name, (name, ""))[0], allowed, names)
    return own


def _plain(name: str) -> str:
    """The name of a world of hapnet's own, without its parameters; of a text with several parts the whole text."""
    return name if " + " in name else name.partition("?")[0]


def _described(name: str) -> Callable[..., Any] | None:
    """Return the function that makes the world that the text `name` describes; None: `name` is not a world of an
    extension.
    """
    found = (extension(kind).builder(name) for kind in WORLDS)
    return next((build for build in found if build is not None), None)


def _given(name: str, spec: str, world: Callable[..., World]) -> dict[str, object]:
    """The parameters that the text after a world's name sets, each of the type of its default."""
    known = {p.name: p.default for p in inspect.signature(world).parameters.values()}
    found: dict[str, object] = {}
    for entry in spec.split("&"):
        key, equals, text = entry.partition("=")
        if not equals or key not in known or key in found:
            shown = ", ".join(f"{key}={default}" for key, default in known.items())
            raise InvalidParameter(f"scene {name}", key, f"KEY=VALUE, each at most once, of {shown}", known)
        try:
            found[key] = type(known[key])(text)
        except ValueError:
            raise InvalidParameter(f"scene {name}", entry, f"a number, such as {key}={known[key]}") from None
    return found
