"""Worlds with a jaw: an object between two jaws, alone or beside flat walls, as in ``wall + grip:hard?size=30mm``.

The last axis is the opening of the jaw, 0 where it is closed; the object is solid where the opening is below its size.
It is an axis like the others: the coupling, its energy and its account contain it. For joints it is an angle.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from math import inf
from typing import NamedTuple

from hapnet.assembly.units import LEVER_M
from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.solids.properties import UNITS, Properties, kind_of
from hapnet.ext.solids.rigid import parts_in
from hapnet.plant.worlds.registry import make_scene, scene_parameters
from hapnet.plant.worlds.scene import STEP_MAX_S, STEP_MIN_S, Scene
from hapnet.plant.worlds.walls import WALL_DAMPING, WALL_STIFFNESS, Wall
from hapnet.units import METRES, RADIANS, units_of

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


class Object(NamedTuple):
    """The object between the jaws. size, gap : its size, and the way of the open jaw to it. is_there : False: none."""

    size: float
    gap: float
    stiffness: float
    damping: float
    is_there: bool

    def beside(self, name: str, point: Scene) -> GripScene:
        """The scene of a point, with the jaw's opening as a further axis, and the object on it."""
        dof, unit = point.dof + 1, units_of(point.units, point.dof)[0]
        walls = [Wall((*one.normal, 0.0), one.offset, one.stiffness, one.damping) for one in point.walls]
        return self._scene(name, dof, tuple(walls), point.min_s, point.max_s, point.start, unit)

    def alone(self, name: str, min_s: float, max_s: float) -> GripScene:
        """The jaw and the object only."""
        return self._scene(name, 1, (), min_s, max_s, (), METRES)

    def _scene(
        self, name: str, dof: int, walls: tuple[Wall, ...], min_s: float, max_s: float, start: Vector, unit: str
    ) -> GripScene:
        closing = (*(0.0,) * (dof - 1), -1.0)
        if self.is_there:
            walls = (*walls, Wall(closing, -self.size, self.stiffness, self.damping))
        return GripScene(name, dof, walls, min_s, max_s, (*start, self.size + self.gap), unit)


def builder(text: str) -> Callable[..., GripScene] | None:
    """A function that makes the world that `text` describes; None: the text describes no jaw.

    Its default for `stiffness` is that of the object. Walls have their own.

    Raises InvalidParameter.
    """
    *others, last = parts_in(text)
    if KIND not in [kind_of(part)[0] for part in (*others, last)]:
        return None
    if len(others) > 1 or kind_of(last)[0] != KIND or any(kind_of(part)[0] == KIND for part in others):
        raise InvalidParameter("scene", text, "a scene and the jaw last, as in wall + grip, or grip alone")
    if not others:
        return _builder(text, last, METRES, _alone)
    unit = units_of((point := _point(text, others[0], {})).units, point.dof)[0]
    return _builder(text, last, unit, partial(_beside, others[0]))


Made = Callable[[str, Object, int, float, float], GripScene]


def _builder(text: str, spec: str, unit: str, made: Made) -> Callable[..., GripScene]:
    thing, sets = _object(spec, unit), "stiffness=" in spec

    def grip(
        *,
        dof: int = 0,
        stiffness: float = thing.stiffness,
        damping: float = thing.damping,
        step_min_s: float = STEP_MIN_S,
        step_max_s: float = STEP_MAX_S,
    ) -> GripScene:
        if sets and stiffness != thing.stiffness:
            raise InvalidParameter(
                "stiffness", stiffness, f"{thing.stiffness:g}, or left out: the scene {text} sets it"
            )
        return made(text, thing._replace(stiffness=stiffness, damping=damping), dof, step_min_s, step_max_s)

    return grip


def _alone(text: str, thing: Object, dof: int, min_s: float, max_s: float) -> GripScene:
    if dof not in (0, 1):
        raise InvalidParameter("dof", dof, "1: the opening of the jaw; more with a scene, as in wall + grip")
    return thing.alone(text, min_s, max_s)


def _beside(name: str, text: str, thing: Object, dof: int, min_s: float, max_s: float) -> GripScene:
    try:
        point = _point(text, name, {"step_min_s": min_s, "step_max_s": max_s, **({"dof": dof - 1} if dof else {})})
    except InvalidParameter as error:
        if error.name != "dof":
            raise
        raise InvalidParameter("dof", dof, f"the axes of {name}, and one more for the jaw") from error
    if dof not in (0, point.dof + 1):
        raise InvalidParameter("dof", dof, f"0 or {point.dof + 1}: the axes of {name}, and one more for the jaw")
    return thing.beside(text, point)


def _point(text: str, name: str, given: Mapping[str, float]) -> Scene:
    """The scene before the jaw, whose walls have their own stiffness and damping. Raises InvalidParameter."""
    taken = scene_parameters(name)
    used = {key: one for key, one in given.items() if key in taken}
    scene = make_scene(name, **used)
    if RADIANS in (units := set(units_of(scene.units, scene.dof))):
        at_lever = {"stiffness": WALL_STIFFNESS * LEVER_M**2, "damping": WALL_DAMPING * LEVER_M**2}
        scene = make_scene(name, **{key: one for key, one in at_lever.items() if key in taken}, **used)
    if not isinstance(scene, Scene) or len(units) > 1:
        raise InvalidParameter("scene", text, "flat walls at rest before + grip: free, wall, box, paper or joints")
    return scene


def _object(spec: str, unit: str) -> Object:
    """The object that a text such as ``grip:hard?size=30mm`` describes. Raises InvalidParameter."""
    _, name, words = kind_of(spec)
    if name not in ("", *OBJECTS, EMPTY):
        raise InvalidParameter(f"scene {spec}", name, f"grip, or grip: and one of {', '.join((*OBJECTS, EMPTY))}")
    properties, square = Properties(spec, words), 1.0 if unit == METRES else LEVER_M**2
    units = UNITS if unit == METRES else None
    size = properties.numbers("size", (_SIZE[unit],), units)[0]
    gap = properties.numbers("gap", (_GAP[unit],), units)[0]
    stiffness = properties.number("stiffness", square * OBJECTS.get(name, WALL_STIFFNESS))
    damping = properties.number("damping", square * WALL_DAMPING)
    properties.finish(_WORDS)
    for key, value in (("size", size), ("gap", gap), ("stiffness", stiffness)):
        if not 0.0 < value < inf:
            raise properties.error(f"{key}={value:g}", f"{key}: above 0, or {KIND}:{EMPTY} without an object")
    if not 0.0 <= damping < inf:
        raise properties.error(f"damping={damping:g}", "damping: 0 or above")
    return Object(size, gap, stiffness, damping, name != EMPTY)
