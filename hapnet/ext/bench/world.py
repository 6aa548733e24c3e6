"""The cost of the virtual world: a step at the wall, and the integrator by dimension."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import cycle

import numpy as np

from hapnet.assembly.build import compiled_ends, device_session, prepare, world_session, world_side
from hapnet.ext.bench.references import NumpyMidpoint, PenaltyWorld
from hapnet.ext.bench.row import Call, Limit, Options, Row, cost
from hapnet.ext.bench.traffic import KILOHERTZ
from hapnet.ext.bench.wire import pair
from hapnet.params import Params
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.side.endpoint import NANO, DeviceEndpoint, WorldEndpoint
from hapnet.side.world import WorldSide

_TARGET = (0.016, 0.004, -0.003)  # m, behind the wall, and within reach of the reservoir
_WALL_M = 0.010


class PressedWorld:
    """A world with its mass pressed into the wall; each step has a new set-position. It is compiled as in real time.

    own : parameters besides the scene. steps_s : minimum and maximum time between two steps [s].
    """

    def __init__(self, own: Mapping[str, object], steps_s: tuple[float, float]) -> None:
        setup = prepare(Params().set({"scene": "wall", "world.wall.position_m": _WALL_M, **own}), "sampled")
        setup = replace(setup, ends=compiled_ends())
        self._target = _TARGET[: setup.dof]
        self._device = DeviceEndpoint(device_session(setup, 1))
        self._world = WorldEndpoint(world_session(setup, 2))
        self.side: WorldSide = world_side(setup, self._world, np.random.default_rng(1), lambda sample: None)
        pair(self._device, self._world)
        min_ns, most_ns = (round(seconds / NANO) for seconds in steps_s)
        self._steps_ns = cycle(np.random.default_rng(1).integers(min_ns, most_ns, 1000, endpoint=True).tolist())
        self.now_ns: int = 0
        for _ in range(100):
            self.prepare()
            self.step()

    def prepare(self) -> None:
        """Advance the time by a step, and deliver a message."""
        self.now_ns += next(self._steps_ns)
        self._world.receive(self.now_ns, self._device.session.position(self.now_ns, self._target))

    def step(self) -> None:
        self.side.step(self.now_ns)


def world_step_wall(options: Options) -> Row:
    """`WorldSide.step`: integrator, contacts, PSPM, ledger, sample and message, in contact."""
    world = PressedWorld({"dof": 3}, (0.010, 0.050))
    what = "world step, 3-DOF, wall in contact, new data, T_k varying"
    return _beside_penalty("world_step_wall", what, world, _TARGET, options)


def world_step_kilohertz(options: Options) -> Row:
    """`WorldSide.step` in 1-DOF at the rate of a servo, where the predictor fits 36 positions in place of 8."""
    world = PressedWorld(KILOHERTZ, (0.001, 0.001))
    what = "world step, 1-DOF, wall in contact, 1 kHz, a new position for each step"
    return _beside_penalty("world_step_kilohertz", what, world, _TARGET[:1], options)


def _beside_penalty(name: str, what: str, world: PressedWorld, target: tuple[float, ...], options: Options) -> Row:
    bare_world = PenaltyWorld(0.02, 14.0, 500.0, (3000.0, 10.0, _WALL_M), len(target))
    subject, bare = cost(Call(world.step, world.prepare), Call(lambda: bare_world.step(1e-4, target)), options)
    return Row(
        name, "us", what, subject, "Euler and a penalty wall in plain floats", bare, limits=(Limit("median", 30.0),)
    )


def integrator_step(n: int, options: Options) -> Row:
    """The passive midpoint integrator in free space, with full matrices and varying steps."""
    rng = np.random.default_rng(n)
    root = rng.normal(size=(n, n))
    coupled = root @ root.T + n * np.eye(n)
    M, B, K = 0.02 * coupled, 14.0 * coupled, 500.0 * coupled
    ours, theirs = PassiveIntegrator(M, B, K, np.zeros(n)), NumpyMidpoint(M, B, K)
    target = rng.uniform(-0.01, 0.01, n)
    goal = tuple(target.tolist())
    steps = cycle(rng.uniform(0.010, 0.050, 1000).tolist())
    dt = 0.010

    def draw() -> None:
        nonlocal dt
        dt = next(steps)

    subject, bare = cost(Call(lambda: ours.step(dt, goal), draw), Call(lambda: theirs.step(dt, target), draw), options)
    what = f"integrator step, {n}-DOF, full matrices, T_k varying"
    return Row(f"integrator_step_{n}dof", "us", what, subject, "numpy.linalg.solve", bare, panel=n == 3)
