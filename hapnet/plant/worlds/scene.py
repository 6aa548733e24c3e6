"""A world of walls at rest: where the walls are, and how long a step takes."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf

import numpy as np

from hapnet import checks
from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.params import WorldParams
from hapnet.plant.worlds.protocol import Surface, WorldDefaults
from hapnet.plant.worlds.walls import Contacts, Wall, check_number
from hapnet.records.vectors import inner
from hapnet.units import METRES, units_of

_WORLD = WorldParams()
STEP_MIN_S, STEP_MAX_S = _WORLD.step_min_s, _WORLD.step_max_s


@dataclass(frozen=True)
class Scene(WorldDefaults):
    """Walls around a virtual mass of `dof` degrees of freedom, and the duration of this world's steps.

    name : the scene's name in summaries and figures.
    dof : n, 1 to 64.
    walls : see `hapnet.plant.worlds.walls`; none for free space.
    min_s, max_s : range of the step time T_k [s].
    start : (n,) where the virtual mass starts [m], outside every wall; the origin by default.
    units : of the axes, as in `hapnet.units`.

    Raises InvalidParameter.
    """

    name: str
    dof: int
    walls: tuple[Wall, ...] = ()
    min_s: float = STEP_MIN_S
    max_s: float = STEP_MAX_S
    start: Vector = ()
    units: str = METRES
    contacts: Contacts = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if type(self.dof) is not int or not 1 <= self.dof <= checks.MAX_DOF:
            raise InvalidParameter("dof", self.dof, f"an integer, 1 to {checks.MAX_DOF}")
        check_number("step_min_s", self.min_s, "a positive, finite number of seconds", lambda t: 0.0 < t < inf)
        longer = f"{self.min_s} (step_min_s) or more seconds"
        check_number("step_max_s", self.max_s, longer, lambda t: self.min_s <= t < inf)
        units_of(self.units, self.dof)
        start = checks.vector("start", self.start, self.dof) if len(self.start) else (0.0,) * self.dof
        contacts = Contacts(self.walls, self.dof)
        contacts.require_outside(start)
        object.__setattr__(self, "walls", contacts.walls)
        object.__setattr__(self, "start", start)
        object.__setattr__(self, "contacts", contacts)

    def next_step_s(self, rng: np.random.Generator) -> float:
        """Draw the duration of the next step, T_k [s]: uniform in [min_s, max_s]."""
        return min(self.max_s, self.min_s + (self.max_s - self.min_s) * rng.random())

    def next_steps_s(self, rng: np.random.Generator, count: int) -> checks.Array:
        """The next `count` durations (count,) [s]: the same values as from `next_step_s`, bit by bit."""
        return np.minimum(self.max_s, self.min_s + (self.max_s - self.min_s) * rng.random(count))

    def towards(self, position: Vector) -> Vector:
        """The farthest point on the straight line from `start` to `position` (n,) [m] that is outside every wall."""
        share = 1.0
        for wall in self.walls:
            before, after = wall.penetration(self.start), wall.penetration(position)
            if after > 0.0:
                share = min(share, before / (before - after) * (1.0 - 1e-9))
        place = tuple([a + share * (b - a) for a, b in zip(self.start, position, strict=True)])
        return place if all(wall.penetration(place) <= 0.0 for wall in self.walls) else self.start

    def for_hand_at(self, at: Vector) -> Scene | None:
        """These walls for a hand whose device's origin is at `at` (n,) [m]: nothing moves, so each hand has its own."""
        walls = [Wall(w.normal, w.offset - inner(w.normal, at), w.stiffness, w.damping) for w in self.walls]
        return Scene(self.name, self.dof, tuple(walls), self.min_s, self.max_s, self.start, self.units)

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """The walls perpendicular to an axis, for plots; others are left out."""
        return tuple(
            Surface(axis, wall.offset * wall.normal[axis], int(wall.normal[axis]))
            for wall in self.walls
            for axis in range(self.dof)
            if abs(wall.normal[axis]) == 1.0
        )


def checked_dof(dof: int) -> int:
    """`dof` unchanged, if it is an allowed number of axes; else raises InvalidParameter."""
    if type(dof) is not int or not 1 <= dof <= 3:
        turns = ", or 6 with a tool that turns, as in the scene tool:box" if dof == 6 else ""
        raise InvalidParameter("dof", dof, f"1, 2 or 3{turns}")
    return dof


def along(dof: int, axis: int, side: float) -> Vector:
    """The unit vector along an axis; `side` is its sign, +1 or -1."""
    return tuple(side if i == axis else 0.0 for i in range(dof))
