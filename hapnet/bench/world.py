"""What the virtual world costs: a step at the wall, and the integrator by dimension."""

from __future__ import annotations

from itertools import cycle

import numpy as np

from hapnet.assembly.build import device_session, prepare, world_session, world_side
from hapnet.bench.cost import Call, cost
from hapnet.bench.endpoints import pair
from hapnet.bench.references import NumpyMidpoint, PenaltyWorld
from hapnet.bench.row import Limit, Options, Row, row
from hapnet.params import Params
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.side.endpoint import DeviceEndpoint, WorldEndpoint
from hapnet.side.world import WorldSide

_TARGET = (0.016, 0.004, -0.003)  # m, behind the wall, and within reach of the reservoir
_WALL_M = 0.010


class PressedWorld:
    """A 3-DOF world whose mass is pressed into the wall; every step has a new set-position."""

    def __init__(self) -> None:
        setup = prepare(Params().set({"scene": "wall", "dof": 3, "world.wall.position_m": _WALL_M}), "sampled")
        self._device = DeviceEndpoint(device_session(setup, 1))
        self._world = WorldEndpoint(world_session(setup, 2))
        self.side: WorldSide = world_side(setup, self._world, np.random.default_rng(1), lambda sample: None)
        pair(self._device, self._world)
        self._steps_ns = cycle(np.random.default_rng(1).integers(10_000_000, 50_000_000, 1000).tolist())
        self.now_ns = 0
        for _ in range(100):
            self.prepare()
            self.step()

    def prepare(self) -> None:
        """A message arrives, and time passes."""
        self.now_ns += next(self._steps_ns)
        self._world.receive(self.now_ns, self._device.session.position(self.now_ns, _TARGET))

    def step(self) -> None:
        self.side.step(self.now_ns)


def world_step_wall(options: Options) -> Row:
    """`WorldSide.step`: integrator, contacts, PSPM, ledger, sample and message, in contact."""
    world = PressedWorld()
    bare_world = PenaltyWorld(0.02, 14.0, 500.0, (3000.0, 10.0, _WALL_M))
    subject, bare = cost(Call(world.step, world.prepare), Call(lambda: bare_world.step(1e-4, _TARGET)), options)
    what = "world step, 3-DOF, wall in contact, new data, T_k varying"
    return row(
        "world_step_wall", "us", what, subject, "Euler and a penalty wall in plain floats", bare,
        limits=(Limit("median", 30.0),),
    )  # fmt: skip


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
    return row(f"integrator_step_{n}dof", "us", what, subject, "numpy.linalg.solve", bare, panel=n == 3)
