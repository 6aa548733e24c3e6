"""A wall that is shifted, turned, softened, removed and brought back at stated times.

Its changes have the syntax of a link's: ``at 2s: shift 3mm; at 3s: turn 9deg over 200ms; at 4s: gone; at 5s: back``.
Times count from the world's first step: the clock is the sum of the steps' lengths. The wall stands still during a step
and changes at the onset of the next step. So each step is an exact step of `hapnet.plant.worlds.walls`, and the drive
of the wall supplies the change of its potential at the proxy's position (`supplied_J`; negative where the wall moves
away from the proxy). With f the wall's force, S = `supplied_J` and U = `stored_J`

    -sum f . vhat T + S - (U - U(0)) = what the wall's damper dissipated >= 0
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from math import cos, hypot, inf, isfinite, pi, sin
from typing import NamedTuple

import numpy as np

from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.mechanics.contacts import Inverse, Surroundings
from hapnet.mechanics.plane import Plane
from hapnet.plant.operator import minimum_jerk
from hapnet.plant.worlds.protocol import Surface, WorldDefaults
from hapnet.plant.worlds.scene import STEP_MAX_S, STEP_MIN_S, Scene
from hapnet.plant.worlds.walls import Contacts, Wall
from hapnet.records.vectors import inner
from netem import NetemError
from netem.units import parse_time

_ENTRY = re.compile(r"at\s+([^\s:]+)\s*:\s*(\w+)(?:\s+(?!over\b)(\S+))?(?:\s+over\s+(\S+))?", re.IGNORECASE)
_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)([a-z/]*)", re.IGNORECASE | re.ASCII)
_UNITS = {
    "shift": {"mm": 1e-3, "m": 1.0, "um": 1e-6},
    "turn": {"deg": pi / 180.0, "rad": 1.0},
    "stiffness": {"": 1.0, "n/m": 1.0},
    "damping": {"": 1.0, "ns/m": 1.0},
}
_PRESENCE = {"gone": 0.0, "back": 1.0}
_FORM = (
    "'at TIME: ' and shift 3mm, turn 20deg, stiffness 1000, damping 5, gone or back, with 'over TIME' if it takes time"
)
_SOON_S = 1e-9
"""A change is due this much early [s], as the clock is a sum of rounded steps."""


class Change(NamedTuple):
    """A change of a wall with minimum jerk from one value to another, from `at_s` on; `over_s` 0: at once.

    kind : shift [m], turn [rad], stiffness [N/m], damping [Ns/m], or presence (0: gone, 1: there).
    """

    at_s: float
    over_s: float
    kind: str
    before: float
    after: float

    def value(self, t: float) -> float:
        share = minimum_jerk((t - self.at_s) / self.over_s) if self.over_s else 1.0
        return self.before + share * (self.after - self.before)

    def rate(self, t: float) -> float:
        """The value's change per second."""
        s = (t - self.at_s) / self.over_s if self.over_s else 1.0
        ramp = s * (1.0 - s)
        return 30.0 * ramp * ramp * (self.after - self.before) / self.over_s if ramp > 0.0 else 0.0


class Schedule:
    """A wall as a function of time.

    wall : at the start. timeline : its changes, as in the module's description; "": none. A `shift` is along the normal
        of that moment, so a positive shift is away from a hand in front of the wall; a `turn` is about the point of the
        first surface that is nearest to the origin, from the first axis towards the second. Both add to earlier ones.

    Raises InvalidParameter: an entry of the timeline is malformed; it names the entry.
    """

    def __init__(self, wall: Wall, timeline: str = "") -> None:
        self.wall = wall
        self._start = {
            "shift": 0.0, "turn": 0.0, "presence": 1.0, "stiffness": wall.stiffness, "damping": wall.damping
        }  # fmt: skip
        self.changes: tuple[Change, ...] = tuple(_changes(timeline, self._start, len(wall.normal)))

    def at(self, t: float) -> Wall | None:
        """The wall at `t` seconds after the world's first step; None while it is gone."""
        now = self._start | {change.kind: change.value(t) for change in self._last(t)}
        if not (present := now["presence"]) > 0.0:
            return None
        normal = _turned(self.wall.normal, now["turn"])
        middle = self.wall.offset * inner(self.wall.normal, normal)
        return Wall(normal, middle + now["shift"], present * now["stiffness"], present * now["damping"])

    def velocity_mps(self, t: float, position: Sequence[float]) -> float:
        """Velocity of the surface along its normal, at the point that is nearest to `position` (n,) [m]."""
        begun = {change.kind: change for change in self._last(t)}
        shifting = begun["shift"].rate(t) if "shift" in begun else 0.0
        if "turn" not in begun or not (turning := begun["turn"].rate(t)):
            return shifting
        along_surface = _turned(self.wall.normal, begun["turn"].value(t) + pi / 2.0)
        arm = [x - self.wall.offset * n for x, n in zip(position, self.wall.normal, strict=True)]
        return float(shifting - turning * inner(along_surface[:2], arm))

    def rests_until(self, t: float) -> float:
        """The time when the wall next differs from its state at `t` [s]: `t` itself during a change."""
        if any(t < change.at_s + change.over_s for change in self._last(t)):
            return t
        return min((change.at_s for change in self.changes if change.at_s > t), default=inf)

    def _last(self, t: float) -> list[Change]:
        """The last change of each kind that has begun by `t`."""
        return list({change.kind: change for change in self.changes if change.at_s <= t}.values())


class MovingWall(WorldDefaults, Surroundings):
    """A world with one wall that changes with time, and its own surroundings. It is used for one run.

    schedule : the wall. min_s, max_s : range of the step time T_k [s], which is drawn uniformly.

    Raises InvalidParameter.
    """

    name, dof, supplied_J = "moving", 1, 0.0

    def __init__(self, schedule: Schedule, min_s: float = STEP_MIN_S, max_s: float = STEP_MAX_S) -> None:
        self.schedule = schedule
        self.dof = len(schedule.wall.normal)
        # A scene with the wall at the start checks the steps' range and draws their lengths.
        self._still = Scene("moving", self.dof, (schedule.wall,), min_s, max_s)
        self.start: Vector = self._still.start
        self._time_s = 0.0
        self._set_wall()

    @property
    def time_s(self) -> float:
        """The sum of the steps' lengths so far [s]."""
        return self._time_s

    @property
    def contacts(self) -> MovingWall:
        return self

    @property
    def walls(self) -> tuple[Wall, ...]:
        """The wall if it never changes; else none, as metrics of a wall assume that it rests."""
        return () if self.schedule.changes else (self.schedule.wall,)

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """The wall where it is at the start."""
        return self._still.surfaces

    def next_step_s(self, rng: np.random.Generator) -> float:
        return self._still.next_step_s(rng)

    def towards(self, position: Vector) -> Vector:
        """The farthest free point from `start` towards `position`; if `start` is in the wall, from its surface."""
        from_ = _pushed_out(self._wall, self.start)
        walls = () if self._wall is None else (self._wall,)
        return Scene("moving", self.dof, walls, start=from_).towards(position)

    def require_outside(self, position: Sequence[float]) -> None:
        self._contacts.require_outside(position)

    def solve(
        self, dt: float, position: Sequence[float], velocity: list[float], inverse: Inverse
    ) -> tuple[Sequence[float], list[float]]:
        """Solve a step with the present wall; the wall changes at the next step's onset."""
        force, vhat = self._contacts.solve(dt, position, velocity, inverse)
        self._time_s += dt
        if self._time_s + _SOON_S >= self._rests_until:
            reached = [p + dt * v for p, v in zip(position, vhat, strict=True)]
            before = self._contacts.stored_J(reached)
            self._set_wall()
            self.supplied_J += self._contacts.stored_J(reached) - before
        return force, vhat

    def penetration(self, position: Sequence[float]) -> float:
        return self._contacts.penetration(position)

    def clearance(self, position: Sequence[float]) -> float:
        return self._contacts.clearance(position)

    def planes(self, position: Sequence[float], reach_m: float) -> tuple[Plane, ...]:
        """The wall at present, if `position` (n,) [m] is inside or less than `reach_m` in front of it; else none."""
        wall = self._wall
        if wall is None or wall.penetration(position) <= -reach_m:
            return ()
        speed = self.schedule.velocity_mps(self._time_s, position)
        return (Plane(wall.normal, wall.offset, wall.stiffness, wall.damping, speed),)

    def stored_J(self, position: Sequence[float]) -> float:
        return self._contacts.stored_J(position)

    def _set_wall(self) -> None:
        now = self._time_s + _SOON_S
        self._wall = self.schedule.at(now)
        self._rests_until = self.schedule.rests_until(now)
        self._contacts = Contacts(() if self._wall is None else (self._wall,), self.dof)


def _changes(timeline: str, start: dict[str, float], dof: int) -> Iterator[Change]:
    now, ends_s = dict(start), dict.fromkeys(start, 0.0)
    last_s = 0.0
    for number, text in enumerate(filter(None, (entry.strip() for entry in re.split(r"[;\n]", timeline))), start=1):
        name = f"timeline entry {number}"
        match = _ENTRY.fullmatch(text)
        word = match[2].lower() if match else ""
        if match is None or word not in {*_UNITS, *_PRESENCE} or (match[3] is None) is (word in _UNITS):
            raise InvalidParameter(name, text, _FORM)
        try:
            at_s, over_s = (parse_time(name, part or "0") * 1e-9 for part in (match[1], match[4]))
        except NetemError as error:
            raise InvalidParameter(name, text, f"a time with its unit, such as 2s or 200ms ({error})") from None
        kind = "presence" if word in _PRESENCE else word
        if at_s < max(last_s, ends_s[kind]):
            why = f"an earlier change ends at {max(last_s, ends_s[kind]):g}s; begin then or later"
            raise InvalidParameter(name, text, "", why=why)
        if kind == "turn" and dof == 1:
            raise InvalidParameter(name, text, "", why="a wall cannot turn with one degree of freedom")
        given = _PRESENCE[word] if kind == "presence" else _amount(name, kind, match[3])
        after = now[kind] + given if kind in ("shift", "turn") else given
        yield Change(at_s, over_s, kind, now[kind], after)
        now[kind], ends_s[kind], last_s = after, at_s + over_s, at_s


def _amount(name: str, kind: str, text: str) -> float:
    units = _UNITS[kind]
    match = _NUMBER.fullmatch(text)
    unit = match[2].lower() if match else ""
    if match is None or unit not in units:
        words = " or ".join(units) if "" not in units else "no unit"
        raise InvalidParameter(name, f"{kind} {text}", f"a number with {words}")
    value = float(match[1]) * units[unit]
    minimum = {"stiffness": "above 0", "damping": "of 0 or more"}.get(kind)
    if not isfinite(value) or (minimum and value < 0.0) or (kind == "stiffness" and not value):
        raise InvalidParameter(name, f"{kind} {text}", f"a finite number {minimum or ''}".rstrip())
    return value


def _turned(normal: Vector, angle: float) -> Vector:
    """`normal` turned in the plane of the first two axes [rad]."""
    if len(normal) == 1 or not angle:
        return normal
    c, s = cos(angle), sin(angle)
    return (c * normal[0] - s * normal[1], s * normal[0] + c * normal[1], *normal[2:])


def _pushed_out(wall: Wall | None, position: Vector) -> Vector:
    """`position`, or the point of the surface that is nearest to it if it is inside."""
    if wall is None or (depth := wall.penetration(position)) <= 0.0:
        return position
    back = depth + 1e-9 * (hypot(*position) + abs(wall.offset))
    return tuple([x - back * n for x, n in zip(position, wall.normal, strict=True)])
