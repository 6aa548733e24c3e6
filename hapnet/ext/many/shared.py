"""Worlds with blocks that several hands push: ``shared:block?mass=0.2 + block?at=120mm,0,0&mass=0``.

Each hand has a seat: its own proxy, virtual coupling, reservoir and link. A run with one hand uses the scene as any
other; `hapnet simulate --graph` gives each device of a graph a seat in the same world. A block of mass 0 is fixed.

Seats get no planes of the blocks: a plane that another hand moves has moved on when it arrives. Measured with two hands
on 0.2 kg over 40 ms, the force error was 0.09 N without planes and 0.80 N with planes that move at the block's
velocity.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from math import hypot

import numpy as np
from numpy.typing import ArrayLike

from hapnet.checks import Array, Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.many.blocks import Block, Blocks, Free
from hapnet.ext.many.joint import JointSeat, JointWorld, Push, dissipated_J
from hapnet.ext.many.turning import TurningBlocks
from hapnet.ext.solids.outlines import part_of
from hapnet.ext.solids.properties import Properties, kind_of
from hapnet.ext.solids.rigid import parts_in
from hapnet.ext.solids.shapes import Cuboid
from hapnet.mechanics.contacts import Inverse, Surroundings
from hapnet.mechanics.plane import Plane
from hapnet.plant.integrator import OWN, PassiveIntegrator, carry_on, drive, factored, solve
from hapnet.plant.worlds.picture import GREY, Part, Touch, at_rest, shared
from hapnet.plant.worlds.scene import STEP_MAX_S, STEP_MIN_S, Scene, checked_dof
from hapnet.plant.worlds.walls import WALL_DAMPING, WALL_STIFFNESS
from hapnet.records.vectors import added

WORD = "shared"
FIRST_WORDS = (f"{WORD}:block",)
"""First words of texts that describe such a world."""
WORDS = (
    "mass=0.2 (kg; 0: fixed), size=60mm,60mm,60mm, at=X,Y,Z (its centre; by default 20 mm in front of the start), "
    "drag=1 (Ns/m), spring=5 (N/m, to its place), limit=10 (N, the most with which a hand pushes it), friction=0 "
    "(Coulomb's mu), gravity=0 (m/s^2, against the last axis), turns=no (or yes, with three axes)"
)
_NUMBERS = {"mass": 0.2, "drag": 1.0, "spring": 5.0, "limit": 10.0, "friction": 0.0, "gravity": 0.0}
_UNITS = {"mass": "_kg", "drag": "_Ns_m", "spring": "_N_m", "limit": "_N"}
"""The ends of their names in `Block`."""
_FRONT_M = 0.02
_SIZE_M = 0.06
_STEP_M = 5e-4


class SharedWorld(JointWorld):
    """The blocks, the seats of the hands, and one environment account for all hands."""

    def __init__(self, blocks: Blocks) -> None:
        self.blocks = blocks
        self._answers: dict[int, Vector] = {}
        super().__init__(blocks.n)

    def begin_step(self, dt: float, moved_by: Mapping[JointSeat, Vector | Push]) -> None:
        free: dict[int, Free] = {}
        self._answers = {}
        for seat, cause in moved_by.items():
            if not isinstance(seat, Seat):
                continue
            if not seat.is_here:
                self.blocks.let_go(seat.number)
                self._answers[seat.number] = (0.0,) * seat.dof
                continue
            mass = seat.mass
            if isinstance(cause, Push):
                factored(mass, dt, cause.drag)
                carry_on(mass, dt)
                mass.c[:] = [carried + push for carried, push in zip(mass.c, cause.push, strict=True)]
            else:
                factored(mass, dt, OWN)
                drive(mass, dt, cause)
            solve(mass, mass.c, mass.vhat)
            resistance = tuple([1.0 / pivot for pivot in mass.inverse_pivots])
            free[seat.number] = Free(seat.in_world(mass.x), tuple(mass.vhat), resistance)
        self._answers |= self.blocks.solve(dt, free)

    def force(self, seat: Seat, dt: float, position: Sequence[float], velocity: Vector, inverse: Inverse) -> Vector:
        """The force of the step on this seat's proxy (n,) [N]. Without `begin_step` its hand is alone in this step."""
        if seat.number in self._answers:
            return self._answers.pop(seat.number)
        if not seat.may_touch:
            return (0.0,) * seat.dof
        n = self.blocks.n
        units = [tuple([float(i == k) for k in range(n)]) for i in range(n)]
        resistance = tuple([1.0 / inverse(unit)[k] for k, unit in enumerate(units)])
        return self.blocks.solve(dt, {seat.number: Free(seat.in_world(position), velocity, resistance)})[seat.number]

    def bodies(self, seen_by: JointSeat) -> Sequence[int]:
        first, own = len(self.blocks.x), self.seats.index(seen_by)
        return [first + number - (number > own) for number in range(len(self.seats))]

    @property
    def stored_J(self) -> float:
        robots = [seat.mass.kinetic_J for seat in self.seats if isinstance(seat, Seat) and seat.has_robot]
        return self.blocks_J + added(robots)

    @property
    def blocks_J(self) -> float:
        """The energy in the motion of all blocks, and in all springs."""
        seats = [seat for seat in self.seats if isinstance(seat, Seat)]
        return self.blocks.stored_J({seat.number: seat.in_world(seat.mass.x) for seat in seats})

    @property
    def dissipated_J(self) -> float:
        """The energy that drag, contacts and friction have dissipated, beside what the seats have got."""
        return dissipated_J(self.account, added([seat.work for seat in self.seats]))


class Seat(JointSeat):
    """The blocks as one hand has them. mass : its proxy.

    at : where its device's origin is in the world (n,) [m]. All other positions are the device's.
    """

    shared: SharedWorld

    def __init__(self, shared: SharedWorld, name: str, min_s: float, max_s: float, at: Vector = ()) -> None:
        super().__init__(0)
        self.shared, self.name, self.dof = shared, name, shared.blocks.n
        self.at = at or (0.0,) * self.dof
        self._steps = Scene(name, self.dof, (), min_s, max_s)
        self.start: Vector = self._steps.start
        self.contacts = _Around(self)
        self.mass = PassiveIntegrator(1.0, 1.0, 1.0, self.start)

    def for_hand_at(self, at: Vector) -> Seat:
        return Seat(self.shared, self.name, self._steps.min_s, self._steps.max_s, at)

    def in_world(self, position: Sequence[float]) -> Vector:
        """A position of the device (n,) [m] in the world's coordinates."""
        return tuple([x + there for x, there in zip(position, self.at, strict=True)])

    @property
    def stiffnesses(self) -> tuple[float, ...]:
        """None: without planes a block is not felt as its own stiffness, but through the delayed proxy."""
        return ()

    def proxy(self, mass: ArrayLike, damping: ArrayLike, stiffness: ArrayLike) -> PassiveIntegrator:
        self.mass = PassiveIntegrator(mass, damping, stiffness, self.start)
        if not self.mass.diagonal:
            raise InvalidParameter("mass", mass, "a number, or one for each axis: the axes must be independent")
        if self not in self.shared.seats:
            self.number = len(self.shared.seats)
            self.shared.seats.append(self)
        return self.mass

    def next_step_s(self, rng: np.random.Generator) -> float:
        """T_k [s], drawn uniformly. In real time a step lasts longer if its computation does."""
        return self._steps.next_step_s(rng)

    def towards(self, position: Vector) -> Vector:
        """The farthest point on the straight line from `start` to `position` (n,) [m] before the first block."""
        path = tuple([b - a for a, b in zip(self.start, position, strict=True)])
        place = self.start
        for share in np.linspace(0.0, 1.0, 2 + int(hypot(*path) / _STEP_M))[1:].tolist():
            there = tuple([a + share * b for a, b in zip(self.start, path, strict=True)])
            if self.contacts.clearance(there) <= 0.0:
                break
            place = there
        return place

    def picture(self) -> _SharedPicture:
        return _SharedPicture(self)


class _Around(Surroundings):
    """The surroundings of one hand's proxy."""

    def __init__(self, seat: Seat) -> None:
        self._seat = seat

    @property
    def dof(self) -> int:
        return self._seat.dof

    def solve(
        self, dt: float, position: Sequence[float], velocity: list[float], inverse: Inverse
    ) -> tuple[Vector, list[float]]:
        force = self._seat.shared.force(self._seat, dt, position, tuple(velocity), inverse)
        return force, [v + more for v, more in zip(velocity, inverse(force), strict=True)]

    def stored_J(self, position: Sequence[float]) -> float:
        return self._seat.shared.blocks_J

    def require_outside(self, position: Sequence[float]) -> None:
        if self.clearance(position) < 0.0:
            place = self._seat.in_world(position)
            raise InvalidParameter(f"scene {self._seat.name}: start", place, "a place outside the blocks")

    def clearance(self, position: Sequence[float]) -> float:
        return self._seat.shared.blocks.clearance(self._seat.in_world(position))

    def planes(self, position: Sequence[float], reach_m: float) -> tuple[Plane, ...] | None:
        return None

    def penetration(self, position: Sequence[float]) -> float:
        return max(0.0, -self.clearance(position))


class _SharedPicture:
    """The blocks, and the proxies of the other hands as small cubes."""

    def __init__(self, seat: Seat) -> None:
        self._seat = seat
        blocks, others = seat.shared.blocks.blocks, self._others
        shapes = [Cuboid(_padded((0.0,) * seat.dof), _padded([2.0 * h for h in b.half], 0.06)) for b in blocks]
        shapes += [Cuboid((0.0, 0.0, 0.0), (0.006,) * 3) for _ in others]
        parts = [part_of(shape, GREY, body) for body, shape in enumerate(shapes)]
        self.parts: tuple[Part, ...] = tuple([part for part in parts if part is not None])

    @property
    def _others(self) -> list[Seat]:
        return [one for one in self._seat.shared.seats if isinstance(one, Seat) and one is not self._seat]

    def poses(self) -> Array:
        places = [*self._seat.shared.blocks.x, *(one.in_world(one.mass.x) for one in self._others)]
        poses = at_rest([[x - there for x, there in zip(place, self._seat.at, strict=True)] for place in places])
        if isinstance(blocks := self._seat.shared.blocks, TurningBlocks):
            poses[: len(blocks.quaternions), 3:] = blocks.quaternions
        return poses

    def soft(self) -> Array:
        """No vertices: there are no soft parts."""
        return np.zeros((0, 3))

    def touches(self, position: Vector, force: Vector) -> list[Touch]:
        """One contact, at the proxy and along the force on it."""
        if not (size := hypot(*force)):
            return []
        return shared(_padded(force), [(_padded(position), _padded([f / size for f in force]), 0.0)])


def _padded(vector: Sequence[float], rest: float = 0.0) -> Vector:
    return (*vector, *(rest,) * (3 - len(vector)))


def builder(text: str) -> Callable[..., Seat] | None:
    """A function that makes the world that `text` describes; None: `text` does not describe such a world."""
    return partial(shared_world, text) if kind_of(text)[0] == WORD else None


def shared_world(
    text: str,
    /,
    *,
    dof: int = 3,
    stiffness: float = WALL_STIFFNESS,
    damping: float = WALL_DAMPING,
    step_min_s: float = STEP_MIN_S,
    step_max_s: float = STEP_MAX_S,
) -> Seat:
    """The first seat of the world that `text` describes (see above); `stiffness`, `damping` : of all contacts.

    Raises InvalidParameter.
    """
    n = checked_dof(dof)
    blocks = [_block(part, n) for part in parts_in(text.partition(":")[2])]
    try:
        made = TurningBlocks if any(block.turns for block in blocks) else Blocks
        return Seat(SharedWorld(made(blocks, stiffness, damping)), text, step_min_s, step_max_s)
    except InvalidParameter as error:
        if error.name != "at":
            raise
        raise error.renamed(f"scene {text}: {error.name}") from error


def _block(text: str, n: int) -> Block:
    kind, _, words = kind_of(text)
    properties = Properties(text, words)
    if kind != "block":
        raise properties.error(kind, "block, such as shared:block?mass=0.2 + block?at=120mm,0,0&mass=0")
    size = properties.lengths("size", (_SIZE_M,) * 3)
    at = properties.lengths("at", (_FRONT_M + 0.5 * size[0], 0.0, 0.0))
    values = {key: properties.number(key, default) for key, default in _NUMBERS.items()}
    for key, value in values.items():
        if not value >= 0.0:
            raise properties.error(f"{key}={value:g}", f"{key}: 0 or above")
    if not min(size) > 0.0:
        raise properties.error("size", "three lengths above 0")
    half = tuple([0.5 * length for length in size[:n]])
    if not values["limit"] > 0.0:
        raise properties.error("limit", "limit: above 0")
    if (turns := properties.text("turns") or "no") not in ("yes", "no") or (turns == "yes" and n < 3):
        raise properties.error(f"turns={turns}", "turns: no, or yes with three axes")
    properties.finish(WORDS)
    numbers = {f"{key}{_UNITS.get(key, '')}": value for key, value in values.items()}
    return Block(at[:n], half, **numbers, turns=turns == "yes")
