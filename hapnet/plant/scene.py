"""Scenes: which walls stand where, and how long the virtual world takes over a step.

A scene is chosen by name (`make_scene`) or given as ``module:Name``: a class or function in an importable module that
takes keyword arguments and returns a `Scene`, most simply a subclass of it or a function that fills one in:

    def corridor(*, dof: int = 2, width: float = 0.04) -> Scene:
        return Scene("corridor", dof, box_walls(dof, width / 2, 3000.0, 10.0)[:2])
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, field
from math import inf, isfinite
from typing import Any, NamedTuple

import numpy as np

from hapnet import checks
from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.loading import cause, load
from hapnet.params import WorldParams
from hapnet.plant.contact import Contacts, Wall, check_number

_WORLD = WorldParams()
WALL_STIFFNESS, WALL_DAMPING = _WORLD.wall.stiffness, _WORLD.wall.damping
STEP_MIN_S, STEP_MAX_S = _WORLD.step_min_s, _WORLD.step_max_s


class Surface(NamedTuple):
    """A wall perpendicular to an axis, as a plot draws it: a line at one coordinate, hatched on its solid side."""

    axis: int  #: index of the coordinate
    position_m: float
    solid: int  #: +1: solid at greater coordinates, -1: at smaller ones


@dataclass(frozen=True)
class Scene:
    """Walls around a virtual mass of `dof` degrees of freedom, and the time that a step of this world takes.

    Parameters
    ----------
    name : what the scene is called in summaries and figures.
    dof : n, 1 or more.
    walls : see `hapnet.plant.contact`; none for free space.
    min_s, max_s : range of the step time T_k [s].
    start : (n,) where the virtual mass starts [m], outside every wall; the origin by default.

    Raises InvalidParameter.
    """

    name: str
    dof: int
    walls: tuple[Wall, ...] = ()
    min_s: float = STEP_MIN_S
    max_s: float = STEP_MAX_S
    start: Vector = ()
    contacts: Contacts = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if type(self.dof) is not int or self.dof < 1:
            raise InvalidParameter("dof", self.dof, "an integer, 1 or more")
        check_number("step_min_s", self.min_s, "a positive, finite number of seconds", lambda t: 0.0 < t < inf)
        longer = f"{self.min_s} (step_min_s) or more seconds"
        check_number("step_max_s", self.max_s, longer, lambda t: self.min_s <= t < inf)
        start = checks.vector("start", self.start, self.dof) if len(self.start) else (0.0,) * self.dof
        contacts = Contacts(self.walls, self.dof)
        contacts.require_outside(start)
        object.__setattr__(self, "walls", contacts.walls)
        object.__setattr__(self, "start", start)
        object.__setattr__(self, "contacts", contacts)

    def next_step_s(self, rng: np.random.Generator) -> float:
        """Draw how long the next step takes, T_k [s]: uniform in [min_s, max_s]."""
        return min(self.max_s, self.min_s + (self.max_s - self.min_s) * rng.random())

    def towards(self, position: Vector) -> Vector:
        """As far on the straight way from `start` to `position` (n,) [m] as the walls let a mass."""
        share = 1.0
        for wall in self.walls:
            before, after = wall.penetration(self.start), wall.penetration(position)
            if after > 0.0:
                share = min(share, before / (before - after) * (1.0 - 1e-9))
        place = tuple([a + share * (b - a) for a, b in zip(self.start, position, strict=True)])
        return place if all(wall.penetration(place) <= 0.0 for wall in self.walls) else self.start

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """The walls that stand perpendicular to an axis, for drawing; others are left out."""
        return tuple(
            Surface(axis, wall.offset * wall.normal[axis], int(wall.normal[axis]))
            for wall in self.walls
            for axis in range(self.dof)
            if abs(wall.normal[axis]) == 1.0
        )


def free(*, dof: int = 1, step_min_s: float = STEP_MIN_S, step_max_s: float = STEP_MAX_S) -> Scene:
    """Free space."""
    return Scene("free", _dof(dof), (), step_min_s, step_max_s)


def wall(
    *,
    dof: int = 1,
    position: float = _WORLD.wall.position_m,
    stiffness: float = WALL_STIFFNESS,
    damping: float = WALL_DAMPING,
    step_min_s: float = STEP_MIN_S,
    step_max_s: float = STEP_MAX_S,
) -> Scene:
    """Section 4's wall: solid where the first coordinate is beyond `position` [m]."""
    check_number("position", position, "a finite number [m]", isfinite)
    plane = Wall(_axis(_dof(dof), 0, 1.0), position, stiffness, damping)
    return Scene("wall", dof, (plane,), step_min_s, step_max_s)


def box(
    *,
    dof: int = 3,
    size: float = _WORLD.wall.half_width_m,
    stiffness: float = WALL_STIFFNESS,
    damping: float = WALL_DAMPING,
    step_min_s: float = STEP_MIN_S,
    step_max_s: float = STEP_MAX_S,
) -> Scene:
    """The inside of a box around the origin with half-width `size` [m], all its faces solid."""
    return Scene("box", dof, box_walls(_dof(dof), size, stiffness, damping), step_min_s, step_max_s)


def paper(
    *,
    dof: int = 3,
    position: float = 0.0,
    stiffness: float = WALL_STIFFNESS,
    damping: float = WALL_DAMPING,
    step_min_s: float = STEP_MIN_S,
    step_max_s: float = STEP_MAX_S,
) -> Scene:
    """A horizontal surface to write on: free where z is above `position` [m]. The mass starts on it."""
    if dof != 3:
        raise InvalidParameter("dof", dof, "3: the paper is written on in x and y and touched in z")
    check_number("position", position, "a finite number [m]", isfinite)
    sheet = Wall((0.0, 0.0, -1.0), -position, stiffness, damping)
    return Scene("paper", dof, (sheet,), step_min_s, step_max_s, (0.0, 0.0, position))


def box_walls(dof: int, half_width: float, stiffness: float, damping: float) -> tuple[Wall, ...]:
    """Both faces of each axis at ``+-half_width`` [m], axis by axis."""
    check_number("size", half_width, "a positive half-width [m]", lambda size: 0.0 < size < inf)
    return tuple(
        Wall(_axis(dof, axis, side), half_width, stiffness, damping) for axis in range(dof) for side in (1.0, -1.0)
    )


SCENES: dict[str, Callable[..., Scene]] = {"free": free, "wall": wall, "box": box, "paper": paper}


def scene_parameters(name: str) -> dict[str, Any]:
    """What `make_scene` takes for scene `name`: keyword and default (`inspect.Parameter.empty` where there is none)."""
    parameters = inspect.signature(_builder(name)).parameters.values()
    return {p.name: p.default for p in parameters if p.kind is not p.VAR_KEYWORD}


def make_scene(name: str, **parameters: Any) -> Scene:
    """Build the scene called `name`: one of `SCENES`, or a user's own given as ``module:Name`` (see above).

    Raises InvalidParameter if there is no such scene, it does not take one of the parameters, or one has a value that
    is not allowed.
    """
    builder = _builder(name)
    try:
        inspect.signature(builder).bind(**parameters)
    except TypeError as error:
        known = ", ".join(scene_parameters(name)) or "nothing"
        raise InvalidParameter(f"scene {name}", parameters, f"parameters of this scene ({known}): {error}") from None
    if name in SCENES:
        scene: object = builder(**parameters)
    else:
        try:
            scene = builder(**parameters)
        except Exception as error:
            raise InvalidParameter("scene", name, f"a scene that can be made ({cause(error)})") from error
    if not isinstance(scene, Scene):
        raise InvalidParameter(f"scene {name}", scene, "a class or function that gives a hapnet.plant.scene.Scene")
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


def _dof(dof: int) -> int:
    if type(dof) is not int or not 1 <= dof <= 3:
        raise InvalidParameter("dof", dof, "1, 2 or 3")
    return dof


def _axis(dof: int, axis: int, side: float) -> Vector:
    return tuple(side if i == axis else 0.0 for i in range(dof))
