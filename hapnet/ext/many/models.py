"""A MuJoCo model that several hands move: each holds a proxy of its own, and the engine makes one step for all.

The proxies are bodies or sites of the model, named by the scene in the order of the hands (``?proxy=left,right``) or by
the edges of a graph (``proxy = "left"``). A hand without a name has a sphere of its own, which begins at its `at`. The
step is that of `hapnet.ext.engines.joint`.

Seats get no planes, as among blocks (`hapnet.ext.many.shared`): what a plane describes may move with another hand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from math import dist, inf

import numpy as np
from numpy.typing import ArrayLike

from hapnet import checks
from hapnet.assembly.build import Setup
from hapnet.checks import Signal, Vector
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.engines.engine_world import EngineWorld, free_towards
from hapnet.ext.engines.joint import Aim, HandsAccount, HandsMass, MujocoHands
from hapnet.ext.engines.mujoco_engine import MujocoEngine
from hapnet.ext.engines.mujoco_model import Asked, HandProxy, asked
from hapnet.ext.engines.mujoco_picture import ModelPicture, moving_bodies
from hapnet.ext.many.graph import Edge
from hapnet.ext.many.joint import JointSeat, JointWorld, Push
from hapnet.mechanics.contacts import Inverse, Mass, Observed, Step, Surroundings
from hapnet.plant.worlds.protocol import World
from hapnet.plant.worlds.scene import Scene


class SharedModel(JointWorld):
    """A running model with the proxies of several hands. engine : the model. name : of the scene, for errors."""

    def __init__(self, engine: MujocoHands, name: str) -> None:
        self.engine = engine
        self.engine_account = HandsAccount(engine, name)
        self.mass = HandsMass(self.engine_account)
        self._done: dict[int, Step] = {}
        super().__init__(engine.dof)

    @property
    def stored_J(self) -> float:
        return self.engine_account.energy_J

    @property
    def supplied_J(self) -> float:
        return self.engine_account.supplied_J

    @property
    def observed(self) -> Observed:
        return self.engine_account.observed

    def bodies(self, seen_by: JointSeat) -> Sequence[int]:
        moving = moving_bodies(self.engine.proxies[0].found).tolist()
        return [moving.index(proxy.found.body) for proxy in self.engine.proxies]

    def begin_step(self, dt: float, moved_by: Mapping[JointSeat, Vector | Push]) -> None:
        aims = {
            seat.number: Aim(ybar, seat.mass.available_J, seat.is_here)
            for seat, ybar in moved_by.items()
            if isinstance(seat, ModelSeat) and not isinstance(ybar, Push)
        }
        self._done = self.mass.joint_step(dt, aims)

    def step_of(self, seat: ModelSeat, dt: float, set_position: Vector) -> Step:
        """The step of one seat's proxy. Without `begin_step` its hand is alone in this step."""
        if seat.number not in self._done:
            self.begin_step(dt, {seat: set_position})
        return self._done.pop(seat.number)


class SeatMass(Mass):
    """The proxy of one seat: its `Mass`. available_J : the energy of its coupling's reservoir."""

    kinetic_J: float = 0.0
    """Zero: the proxy's motion is stored in the engine."""

    def __init__(self, seat: ModelSeat) -> None:
        self._seat = seat
        self.available_J = inf

    @property
    def position(self) -> Vector:
        account = self._seat.shared.engine_account
        return account.of(self._seat.number, account.position)

    @property
    def velocity(self) -> Vector:
        account = self._seat.shared.engine_account
        return account.of(self._seat.number, account.velocity)

    def limit_energy(self, energy_J: float) -> None:
        self.available_J = energy_J

    def place(self, position: ArrayLike) -> None:
        self._seat.place(checks.vector("position", position, self._seat.dof))

    def step(self, dt: float, set_position: Vector, contacts: Surroundings | None = None) -> Step:
        return self._seat.shared.step_of(self._seat, dt, set_position)

    def push(self, dt: float, drag: float, push: Vector, contacts: Surroundings | None = None) -> Step:
        raise HapnetError("a model with several hands needs couplings with a spring at the world, such as pspm")


class ModelSeat(JointSeat, Surroundings):
    """A model as one of its hands has it; its positions are displacements of this hand's proxy from its start.

    steps : draws the lengths of the steps.
    """

    shared: SharedModel

    def __init__(self, shared: SharedModel, name: str, steps: Scene) -> None:
        super().__init__(len(shared.seats))
        self.shared, self.name = shared, name
        self._steps, self._proxy = steps, shared.engine.proxies[self.number]
        self.start: Vector = self._proxy.position()
        self.mass = SeatMass(self)
        shared.seats.append(self)

    @property
    def dof(self) -> int:
        return self._proxy.dof

    @property
    def contacts(self) -> ModelSeat:
        return self

    @property
    def warnings(self) -> tuple[str, ...]:
        return self.shared.engine.warnings

    @property
    def observed(self) -> Observed:
        return self.shared.observed

    @property
    def supplied_J(self) -> float:
        return self.shared.supplied_J

    def stored_J(self, position: Sequence[float]) -> float:
        return self.shared.stored_J

    def proxy(self, mass: ArrayLike, damping: ArrayLike, stiffness: ArrayLike) -> SeatMass:
        self.shared.engine.weigh_hand(self.number, mass)
        self.shared.mass.hold(self.number, damping, stiffness)
        self.shared.engine_account.look()
        return self.mass

    def next_step_s(self, rng: np.random.Generator) -> float:
        return self._steps.next_step_s(rng)

    def place(self, position: Vector) -> bool:
        """Put its sphere at rest at `position` (n,) [m], and return whether it is free there. A body stays."""
        free: list[bool] = []
        self.shared.mass.put(self.number, lambda: free.append(self._proxy.place(position)))
        return free[0]

    def towards(self, position: Vector) -> Vector:
        free_towards(self.start, position, self.place)
        return self.mass.position

    def picture(self) -> ModelPicture:
        return ModelPicture(self._proxy.found, self.mass.position)

    def signal(self, name: str, value: Signal) -> None:
        self.shared.engine.signal(name, value)

    @property
    def contact_force(self) -> Vector | None:
        """The force of all contacts on its sphere, the mean over the last step [N]."""
        account = self.shared.engine_account
        force = account.contact_force if self._proxy.is_sphere else None
        return None if force is None else account.of(self.number, force)

    def penetration(self, position: Sequence[float]) -> float:
        return self._proxy.depth()

    def solve(
        self, dt: float, position: Sequence[float], velocity: list[float], inverse: Inverse
    ) -> tuple[Vector, list[float]]:
        """Never called: the engine integrates the proxy itself."""
        raise HapnetError("an engine moves its proxies itself")


def seats_in_model(setup: Setup, edges: Sequence[Edge]) -> list[World]:
    """The world of each edge, if the setup's scene is a MuJoCo model; else none.

    Raises InvalidParameter: the model has too few proxies, or not this one, or two hands would hold the same one.
    """
    world = setup.scene
    engine = world.engine if isinstance(world, EngineWorld) else None
    if type(engine) is not MujocoEngine:  # a tool is a free body: it has room for one hand
        return []
    want, steps = asked(engine.scene), setup.params.world
    held = _held(edges, want, engine.dof)
    _require_names(edges, engine)
    if len(edges) == 1:
        one = MujocoEngine(engine.scene, engine.dof, held)
        single = EngineWorld(one, name=engine.scene, min_s=steps.step_min_s, max_s=steps.step_max_s)
        single.name = world.name
        return [single]
    hands = MujocoHands(engine.scene, engine.dof, held)
    _require_apart(edges, hands, 2.0 * want.radius)
    shared = SharedModel(hands, engine.scene)
    drawn = Scene(world.name, 1, (), steps.step_min_s, steps.step_max_s)
    return [ModelSeat(shared, world.name, drawn) for _ in edges]


def _held(edges: Sequence[Edge], want: Asked, dof: int) -> list[HandProxy]:
    named: dict[str, Edge] = {}
    for edge in edges:
        if edge.proxy and named.setdefault(edge.proxy, edge) is not edge:
            allowed = f"a proxy that no other hand holds: {named[edge.proxy].name} holds it"
            raise InvalidParameter(f"edges.{edge.name}.proxy", edge.proxy, allowed)
        if edge.proxy and want.proxies and edge.proxy not in want.proxies:
            allowed = f"one of the scene's proxies: {', '.join(want.proxies)}"
            raise InvalidParameter(f"edges.{edge.name}.proxy", edge.proxy, allowed, want.proxies)
        if edge.at and (edge.proxy or want.proxies):
            why = "a hand that holds a body of the model begins where the body is; leave `at` out"
            raise InvalidParameter(f"edges.{edge.name}.at", list(edge.at), "", why=why)
        if edge.at and len(edge.at) != dof:
            raise InvalidParameter(f"edges.{edge.name}.at", list(edge.at), f"{dof} lengths, one for each axis")
    if want.proxies and len(edges) > len(want.proxies):
        allowed = f"up to {len(want.proxies)}, one for each proxy of the scene: {', '.join(want.proxies)}"
        raise InvalidParameter(f"nodes.{edges[0].world}: scene mujoco", f"{len(edges)} edges", allowed)
    left = [name for name in want.proxies if name not in named]
    held = []
    for edge in edges:
        name = edge.proxy or (left.pop(0) if want.proxies else "")
        at = want.at if name or not edge.at else (*edge.at, *(0.0,) * (3 - dof))
        held.append(HandProxy(name) if name else HandProxy(at=at))
    return held


def _require_names(edges: Sequence[Edge], engine: MujocoEngine) -> None:
    """Raise InvalidParameter if the model has no body or site of the name that an edge gives."""
    known = engine.found.names()
    for edge in edges:
        if edge.proxy and edge.proxy not in known:
            allowed = f"a body or site of the model: {', '.join(known) or 'it has none with a name'}"
            raise InvalidParameter(f"edges.{edge.name}.proxy", edge.proxy, allowed, known)


def _require_apart(edges: Sequence[Edge], engine: MujocoHands, least_m: float) -> None:
    """Raise InvalidParameter if two spheres overlap at the start."""
    places = [
        (edge, proxy.found.data.xpos[proxy.found.body].tolist())
        for edge, proxy in zip(edges, engine.proxies, strict=True)
        if proxy.is_sphere
    ]
    for (one, here), (other, there) in combinations(places, 2):
        if dist(here, there) < least_m:
            allowed = f"a place at least {least_m:g} m from that of {one.name}"
            raise InvalidParameter(f"edges.{other.name}.at", list(other.at), allowed)
