"""Worlds with a jaw: an object between two jaws, alone or beside flat walls, as in ``wall + grip:hard?size=30mm``.

The last axis is the opening of the jaw, 0 where it is closed; the object is solid where the opening is below its size.
It is an axis like the others: the coupling, its energy and its account contain it. For joints it is an angle.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import inf

from hapnet.assembly.units import LEVER_M
from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.solids.properties import UNITS, Properties, kind_of
from hapnet.ext.solids.rigid import parts_in
from hapnet.plant.worlds.protocol import World
from hapnet.plant.worlds.registry import make_scene, scene_parameters
from hapnet.plant.worlds.scene import STEP_MAX_S, STEP_MIN_S, Scene
from hapnet.plant.worlds.walls import WALL_DAMPING, WALL_STIFFNESS, Wall
from hapnet.units import METRES, RADIANS, text_of, units_of

KIND = "grip"
FIRST_WORDS = (KIND,)
"""The first words of texts that describe such a world."""

OBJECTS = {"soft": 500.0, "hard": 5000.0}
"""Objects by name, and their stiffness [N/m]; for an angle at a lever of 0.1 m."""
EMPTY = "empty"
"""The name of a jaw without an object, for a robot whose surroundings are not known."""

_WORDS = "size=30mm, stiffness=N/m, damping=Ns/m, gap=20mm (between the open jaw and the object)"
OFFERED = tuple((f"{KIND}:{name}", _WORDS) for name in (*OBJECTS, EMPTY))
"""The worlds that need no file, each with the help on its properties."""

_SIZE, _GAP = {METRES: 0.03, RADIANS: 0.3}, {METRES: 0.02, RADIANS: 0.2}


@dataclass(frozen=True)
class GripScene(Scene):
    """A scene whose last axis is the opening of a jaw; it starts open, and a simulated hand closes it."""

    @property
    def jaw(self) -> bool:
        return True

    @property
    def rest(self) -> Vector:
        return (*(0.0,) * (self.dof - 1), self.start[-1])

    @property
    def pressed(self) -> Vector:
        first = next((wall.normal for wall in self.walls if not wall.normal[-1]), (0.0,) * self.dof)
        return (*first[:-1], -1.0)

    def for_hand_at(self, at: Vector) -> None:
        """None: it has room for one hand only."""
        return


@dataclass(frozen=True)
class Object:
    """An object between the jaws. size, gap : its size, and the way of the open jaw to it. stiffness : 0: no object."""

    size: float
    gap: float
    stiffness: float
    damping: float

    def wall(self, dof: int) -> tuple[Wall, ...]:
        """Its surface, in a scene of `dof` axes with the opening as the last."""
        closing = (*(0.0,) * (dof - 1), -1.0)
        return (Wall(closing, -self.size, self.stiffness, self.damping),) if self.stiffness else ()


def grip_scene(
    text: str,
    *,
    dof: int = 0,
    stiffness: float = WALL_STIFFNESS,
    damping: float = WALL_DAMPING,
    step_min_s: float = STEP_MIN_S,
    step_max_s: float = STEP_MAX_S,
) -> GripScene:
    """The world that `text` describes (see above); `stiffness` and `damping` are the defaults of an object without a
    name, and of walls.

    Raises InvalidParameter.
    """
    *others, last = parts_in(text)
    if not others:
        if dof not in (0, 1):
            raise InvalidParameter("dof", dof, "1: the opening of the jaw; more with a scene, as in wall + grip")
        between = _object(last, METRES, stiffness, damping)
        return _with(Scene(text, 1, (), step_min_s, step_max_s), between, text)
    name = others[0]
    given = {"dof": dof - 1, "stiffness": stiffness, "damping": damping}
    known = {"step_min_s": step_min_s, "step_max_s": step_max_s}
    known |= {key: value for key, value in given.items() if value != -1 and (key != "dof" or dof)}
    taken = scene_parameters(name)
    point: World = make_scene(name, **{key: value for key, value in known.items() if key in taken})
    if not isinstance(point, Scene) or len(set(units_of(point.units, point.dof))) > 1:
        allowed = "flat walls at rest before + grip, such as free, wall, box, paper or joints"
        raise InvalidParameter("scene", text, allowed)
    if dof and dof != point.dof + 1:
        raise InvalidParameter("dof", dof, f"0 or {point.dof + 1}: the axes of {name}, and the opening of the jaw")
    return _with(point, _object(last, units_of(point.units, point.dof)[0], stiffness, damping), text)


def _with(point: Scene, between: Object, text: str) -> GripScene:
    """The scene of the point (without walls for a jaw alone), and the jaw as its last axis."""
    alone = text.lstrip().startswith(KIND)
    count = 0 if alone else point.dof
    walls = [] if alone else [dataclasses.replace(wall, normal=(*wall.normal, 0.0)) for wall in point.walls]
    unit = units_of(point.units, point.dof)[0]
    start = () if alone else point.start
    return GripScene(
        text,
        count + 1,
        (*walls, *between.wall(count + 1)),
        point.min_s,
        point.max_s,
        (*start, between.size + between.gap),
        text_of((unit,) * (count + 1)),
    )


def _object(spec: str, unit: str, stiffness: float, damping: float) -> Object:
    """The object that a text such as ``grip:hard?size=30mm`` describes. Raises InvalidParameter."""
    _, name, words = kind_of(spec)
    if name not in ("", *OBJECTS, EMPTY):
        raise InvalidParameter(f"scene {spec}", name, f"grip, or grip: and one of {', '.join((*OBJECTS, EMPTY))}")
    properties = Properties(spec, words)
    own = OBJECTS if unit == METRES else {each: k * LEVER_M**2 for each, k in OBJECTS.items()}
    units = UNITS if unit == METRES else None
    size, gap = (
        properties.numbers(key, (default[unit],), units)[0] for key, default in (("size", _SIZE), ("gap", _GAP))
    )
    k = properties.number("stiffness", 0.0 if name == EMPTY else own.get(name, stiffness))
    b = properties.number("damping", damping)
    properties.finish(_WORDS)
    for key, value in (("size", size), ("gap", gap)):
        if not 0.0 < value < inf:
            raise properties.error(f"{key}={value:g}", f"{key}: above 0, such as {key}=30mm")
    if name != EMPTY and not 0.0 < k < inf:
        raise properties.error(f"stiffness={k:g}", f"stiffness: above 0, or {KIND}:{EMPTY} without an object")
    if not 0.0 <= b < inf:
        raise properties.error(f"damping={b:g}", "damping: 0 or above")
    return Object(size, gap, k, b)


def builder(text: str) -> Callable[..., GripScene] | None:
    """A function that makes the world that `text` describes; None: the text describes no jaw."""
    kinds = [kind_of(part)[0] for part in parts_in(text)]
    if KIND not in kinds:
        return None
    if len(kinds) > 2 or kinds[-1] != KIND or kinds.count(KIND) > 1:
        raise InvalidParameter("scene", text, "a scene and the jaw last, as in wall + grip, or grip alone")
    return partial(grip_scene, text)
