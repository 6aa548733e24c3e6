"""MuJoCo as the world: it integrates the proxy itself, so the proxy replaces the passive integrator.

A step of length T is made of ``ceil(T / timestep)`` substeps of equal length, never longer than the model's `timestep`:
so the model is as stable and as stiff as its author made it, and simulated time is real time, whatever T_k is. In each
substep the virtual coupling's force is held. It is that of a spring and a damper which are computed for the substep's
end, with W the proxy's inverse mass and a the acceleration that all but the coupling gave it in the last substep:

    u = v + h a,    F = (I + (h B' + h^2 K') W)^-1 [-B' u - K' (x + h u - ybar)]

so it is stable for any h, and K' (ybar - x) where a contact holds the proxy. Its work is known exactly from positions.
So the coupling's end of the theorem has the spring only (the proxy's mass belongs to the engine): with
phi = 1/2 |x - ybar|_K'^2 it harvests what was measured,

    D = -sum F . (x_{j+1} - x_j) - (phi_{k+1} - phi_k)                          both phi with ybar_k

D may be negative: something else pushed the proxy. No substep takes more than spring and reservoir hold; one that would
is made again without force. So the reservoir never goes below 0.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import ceil, inf
from operator import add, mul, neg, sub

import numpy as np
from numpy.typing import ArrayLike

from hapnet import checks
from hapnet.checks import Array, Signal, Vector
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.loading import cause
from hapnet.mechanics.contacts import Inverse, Mass, Observed, Step, Surroundings
from hapnet.mechanics.plane import Plane
from hapnet.plant.worlds.mujoco_engine import Engine
from hapnet.plant.worlds.mujoco_model import asked, load, warnings
from hapnet.plant.worlds.mujoco_picture import ModelPicture
from hapnet.plant.worlds.mujoco_planes import SpherePlanes
from hapnet.plant.worlds.protocol import WorldDefaults
from hapnet.plant.worlds.scene import STEP_MAX_S, STEP_MIN_S, Scene, checked_dof
from hapnet.records.vectors import inner

MAX_S = 0.25
"""So much is simulated in one step at most: where steps take longer, the world is slower than time."""

_SMALLEST_MASS = 0.02
"""Of the sphere, until the parameter is known [kg]."""

Product = Callable[[Sequence[float]], list[float]]

_PAID = 1.0 - 1e-12
"""The share of the energy at hand that may be used: so rounding makes no deficit."""


class MujocoProxy(Mass):
    """The proxy on its virtual coupling, moved by the engine: the `hapnet.mechanics.contacts.Mass`.

    engine : the running model. damping, stiffness : B' [Ns/m], K' [N/m].
    """

    kinetic_J: float = 0.0
    """Zero: the proxy's motion is stored in the engine."""

    def __init__(self, engine: Engine, damping: ArrayLike, stiffness: ArrayLike) -> None:
        self._available_J = inf
        self._engine = engine
        self._B, self._K = _matrix("damping", damping, engine.dof), _matrix("stiffness", stiffness, engine.dof)
        self._stiffness = self._inverse_mass = _product(self._K)
        self._pushed: Vector = (0.0,) * engine.dof
        """Acceleration that all but the coupling gave the proxy in the last substep [m/s^2]."""
        self._gains_h = 0.0
        self._known_gains = self._stiffness, self._stiffness
        self._position = engine.position()

    @property
    def position(self) -> Vector:
        return self._position

    @property
    def velocity(self) -> Vector:
        return self._engine.velocity()

    def afford(self, energy_J: float) -> None:
        self._available_J = energy_J

    def place(self, position: ArrayLike) -> None:
        self._engine.place(checks.vector("position", position, self._engine.dof))
        self._pushed = (0.0,) * self._engine.dof
        self._position = self._engine.position()

    def step(self, dt: float, set_position: Vector, contacts: Surroundings | None = None) -> Step:
        try:
            return self._step(dt, set_position)
        except self._engine.found.engine.FatalError as error:
            raise HapnetError(f"the scene mujoco failed: {cause(error)}") from error

    def _step(self, dt: float, set_position: Vector) -> Step:
        engine, n = self._engine, self._engine.dof
        simulated = min(dt, MAX_S)
        count = max(1, ceil(simulated / engine.own_step_s - 1e-9))
        h = simulated / count
        engine.begin(h)
        spring, damper = self._gains(h)
        x = start = self._position
        total, work = [0.0] * n, 0.0
        before = self._potential_J(x, set_position)
        most = _PAID * (before + self._available_J)
        before_v = engine.velocity()
        for _ in range(count):
            e, u = tuple(map(sub, x, set_position)), [v + h * a for v, a in zip(before_v, self._pushed, strict=True)]
            force = tuple(map(neg, map(add, spring(e), damper(u))))
            applied, done = engine.substep(force, most - work)
            work += done
            total = list(map(add, total, applied))
            x, after_v = engine.position(), engine.velocity()
            own = self._inverse_mass(applied)
            self._pushed = tuple([(w - v) / h - a for w, v, a in zip(after_v, before_v, own, strict=True)])
            before_v = after_v
        self._position = x
        mean = tuple([f / count for f in total])
        return Step(
            tuple([(b - a) / dt for a, b in zip(start, x, strict=True)]), tuple(map(neg, mean)),
            -work, -work - (self._potential_J(x, set_position) - before), mean, x, engine.depth(),
        )  # fmt: skip

    def _gains(self, h: float) -> tuple[Product, Product]:
        """The force's dependence on the spring's length and on the velocity, in a substep of `h` [s]."""
        if h == self._gains_h and self._engine.found.dofs:  # a body's inverse mass changes with the model's pose
            return self._known_gains
        B, K = self._B, self._K
        inverse_mass = self._engine.inverse_mass()
        gain = np.linalg.inv(np.eye(self._engine.dof) + (h * B + h * h * K) @ inverse_mass)
        self._inverse_mass = _product(inverse_mass)
        self._gains_h, self._known_gains = h, (_product(gain @ K), _product(gain @ (B + h * K)))
        return self._known_gains

    def _potential_J(self, x: Vector, set_position: Vector) -> float:
        e = tuple(map(sub, x, set_position))
        return 0.5 * float(inner(e, self._stiffness(e)))

    def push(self, dt: float, drag: float, push: Vector, contacts: Surroundings | None = None) -> Step:
        """Not possible: a law's impedance would have to be solved together with the engine's step."""
        raise HapnetError("a MuJoCo scene needs a coupling whose virtual mass has a spring, such as pspm")


class MujocoWorld(WorldDefaults, Surroundings):
    """A MuJoCo model as a world, and its own surroundings. It is used for one run.

    scene : its name, see `hapnet.plant.worlds.mujoco_model`. dof : axes of the hand, the model's first ones.
    min_s, max_s : range of the step time T_k [s].

    Raises InvalidParameter.
    """

    name, dof, moves_proxy = "mujoco", 3, True
    warnings: tuple[str, ...] = ()

    def __init__(self, scene: str, dof: int = 3, min_s: float = STEP_MIN_S, max_s: float = STEP_MAX_S) -> None:
        self._steps = Scene(self.name, checked_dof(dof), (), min_s, max_s)
        self._found = load(scene, dof, _SMALLEST_MASS)
        self.warnings = tuple(warnings(self._found))
        self.engine: Engine = Engine(self._found, dof)
        self.dof = dof
        self.start: Vector = self._steps.start
        reported, self._planes = asked(scene).planes, None
        if self._found.dofs and not self._found.model.nflex and reported != "none":
            planes = SpherePlanes(self._found, dof, everything=reported == "all")
            self._planes = planes if planes.any_fits else None

    @property
    def contacts(self) -> MujocoWorld:
        return self

    def proxy(self, mass: ArrayLike, damping: ArrayLike, stiffness: ArrayLike) -> MujocoProxy:
        """The proxy; an added sphere gets `mass` [kg], a body of the model keeps its own."""
        if self._found.dofs:
            kg = float(checks.vector("mass", mass, 1)[0]) if np.size(mass) == 1 else 0.0
            if not kg > 0.0:
                raise InvalidParameter("mass", mass, "one positive number [kg] in a MuJoCo scene")
            model = self._found.model
            share = kg / float(model.body_mass[self._found.body])
            model.body_mass[self._found.body] *= share
            model.body_inertia[self._found.body] *= share
            engine = self._found.engine
            engine.mj_setConst(model, engine.MjData(model))  # it moves what it is given
            self.engine.weigh()
        return MujocoProxy(self.engine, damping, stiffness)

    def picture(self) -> ModelPicture:
        return ModelPicture(self.engine)

    def next_step_s(self, rng: np.random.Generator) -> float:
        return self._steps.next_step_s(rng)

    def towards(self, position: Vector) -> Vector:
        """The farthest point from the start towards `position` where an added sphere is free, to a thousandth."""
        low, high = 0.0, 1.0
        if self.engine.place(position):
            return position
        for _ in range(10):
            middle = 0.5 * (low + high)
            free = self.engine.place(tuple([middle * x for x in position]))
            low, high = (middle, high) if free else (low, middle)
        self.engine.place(tuple([low * x for x in position]))
        return self.engine.position()

    def signal(self, name: str, value: Signal) -> None:
        """``ctrl``: the commands of all actuators; ``ctrl.NAME``: of one. What fits no actuator is ignored."""
        self.engine.command(name, value)

    @property
    def observed(self) -> Observed:
        return self.engine.observed

    @property
    def supplied_J(self) -> float:
        """Work of the model's actuators [J]."""
        return self.engine.supplied_J

    def stored_J(self, position: Sequence[float]) -> float:
        """Kinetic and potential energy of all bodies, the proxy's too [J]."""
        return self.engine.energy_J()

    def solve(
        self, dt: float, position: Sequence[float], velocity: list[float], inverse: Inverse
    ) -> tuple[Sequence[float], list[float]]:
        """Never called: the engine integrates the proxy itself."""
        raise HapnetError("a MuJoCo scene moves its proxy itself")

    def penetration(self, position: Sequence[float]) -> float:
        return self.engine.depth()

    @property
    def contact_force(self) -> Vector:
        """Of all contacts on the proxy, the mean over the last step [N]."""
        return self.engine.contact_force

    def planes(self, position: Sequence[float], reach_m: float) -> tuple[Plane, ...] | None:
        """Those around an added sphere where it is. None: it touches what no plane describes, or there is a flex, or
        the hand holds a body of the model, with its weight and joints.
        """
        return None if self._planes is None else self._planes.around(tuple(position), reach_m)


def _product(matrix: Array) -> Product:
    """A function that multiplies a vector by `matrix`; faster than numpy for three axes."""
    if not (matrix - np.diag(np.diagonal(matrix))).any():
        diagonal = np.diagonal(matrix).tolist()
        return lambda vector: list(map(mul, diagonal, vector))
    rows = matrix.tolist()
    return lambda vector: [inner(row, vector) for row in rows]


def _matrix(name: str, value: ArrayLike, dof: int) -> Array:
    """An (n, n) matrix from a scalar, a diagonal or a matrix."""
    given = np.asarray(value, dtype=float)
    if given.ndim == 2 and given.shape == (dof, dof):
        return given
    if given.ndim < 2 and given.size in (1, dof):
        return np.diag(np.broadcast_to(given, (dof,)))
    raise InvalidParameter(name, value, f"one number, {dof} numbers or a {dof} x {dof} matrix")
