"""An engine as the world: it integrates the proxy itself, so the proxy replaces the passive integrator.

A step of length T has ``ceil(T / substep_s)`` substeps of equal length: so the engine is as stable and as stiff as its
author intended, and simulated time is real time for any T_k. In each substep the virtual coupling's force is held. It
is that of a spring and a damper, computed for the substep's end, with W the proxy's inverse mass and a its acceleration
by all forces except the coupling's in the last substep:

    u = v + h a,    F = (I + (h B' + h^2 K') W)^-1 [-B' u - K' (x + h u - ybar)]

so it is stable for any h, and K' (ybar - x) if a contact holds the proxy. Its work is known exactly from positions. So
the coupling's half of the theorem has the spring only (the proxy's mass belongs to the engine): with
phi = 1/2 |x - ybar|_K'^2 its harvest is measured,

    D = -sum F . (x_{j+1} - x_j) - (phi_{k+1} - phi_k)                          both phi with ybar_k

D may be negative if other forces push the proxy. No substep takes more than spring and reservoir hold; a substep that
would is repeated without force. So the reservoir never goes below 0.

An engine that integrates the proxy on its coupling (`hapnet.ext.engines.engine.CoupledEngine`) has F by (13), from the
positions that it reached, whatever force it used. Then D is the harvest of (13), the damper's |vhat|_B'^2 h.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import ceil, inf
from operator import add, mul, neg, sub
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from hapnet import checks
from hapnet.checks import Array, Signal, Vector
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.engines.engine import CoupledEngine, Engine
from hapnet.ext.engines.engine_account import EngineAccount, EngineFailed
from hapnet.ext.engines.observed_world import contact_planes
from hapnet.ext.solids.shapes_picture import ShapesPicture
from hapnet.mechanics.contacts import Inverse, Mass, Observed, Step, Surroundings
from hapnet.mechanics.plane import Plane
from hapnet.plant.worlds.picture import Picture
from hapnet.plant.worlds.protocol import Completed, WorldDefaults, lacking
from hapnet.plant.worlds.scene import STEP_MAX_S, STEP_MIN_S, Scene
from hapnet.records.vectors import inner
from hapnet.units import METRES

MAX_S = 0.25
"""The most time simulated in one step [s]: if steps take longer, the world runs slower than real time."""

SHORTEST_S = 1e-5
"""The shortest substep of an engine [s]: with shorter ones the world runs far slower than real time."""

_LIGHTEST = 1e12
"""The greatest inverse mass of a proxy [1/kg]."""

Product = Callable[[Sequence[float]], list[float]]

Substep = Callable[[float, Vector, float], tuple[Vector, float]]
"""A function that does a substep, of its length [s], a set-position [m] or a force [N], and the most energy that it may
take [J]. Returns the mean force applied [N], and its work [J]."""

PAID = 1.0 - 1e-12
"""The share of the available energy that may be used, so that rounding makes no deficit."""


class EngineMass(Mass):
    """The proxy on its virtual coupling, moved by the engine: the `hapnet.mechanics.contacts.Mass`.

    account : the running engine. mass : of the proxy if the engine reports no inverse mass [kg]. damping, stiffness :
    B' [Ns/m], K' [N/m].
    """

    kinetic_J: float = 0.0
    """Zero: the proxy's motion is stored in the engine."""

    def __init__(self, account: EngineAccount, mass: ArrayLike, damping: ArrayLike, stiffness: ArrayLike) -> None:
        self._available_J = inf
        self._account = account
        self._B, self._K = matrix_of("damping", damping, account.dof), matrix_of("stiffness", stiffness, account.dof)
        self._lightness = np.array(np.linalg.inv(matrix_of("mass", mass, account.dof)))
        self._damper, self._stiffness = _product(self._B), _product(self._K)
        self._is_coupled = isinstance(account.engine, CoupledEngine)
        self._pushed: Vector = (0.0,) * account.dof
        """The proxy's acceleration by all forces except the coupling's in the last substep [m/s^2]."""
        self._gains_of: tuple[float, object] = (0.0, None)
        self._inverse_mass = self._stiffness
        self._known_gains = self._stiffness, self._stiffness

    @property
    def position(self) -> Vector:
        return self._account.position

    @property
    def velocity(self) -> Vector:
        return self._account.velocity

    def limit_energy(self, energy_J: float) -> None:
        self._available_J = energy_J

    def place(self, position: ArrayLike) -> None:
        self._account.place(checks.vector("position", position, self._account.dof))
        self._pushed = (0.0,) * self._account.dof

    def step(self, dt: float, set_position: Vector, contacts: Surroundings | None = None) -> Step:
        before = self._potential_J(self._account.position, set_position)
        most = PAID * (before + self._available_J)
        done = self._advance(dt, self._coupled if self._is_coupled else self._held, set_position, most)
        return done._replace(dissipated_J=done.work_J - (self._potential_J(done.position, set_position) - before))

    def _advance(self, dt: float, kind: Callable[[float], Substep], given: Vector, most_J: float) -> Step:
        """Do a step of substeps of this kind, with `given` as their vector; together they take at most `most_J` [J]."""
        account = self._account
        simulated = min(dt, MAX_S)
        count = max(1, ceil(simulated / account.engine.substep_s - 1e-9))
        h = simulated / count
        account.begin()
        substep = kind(h)
        start = account.position
        total, work = [0.0] * account.dof, 0.0
        for _ in range(count):
            applied, done = substep(h, given, most_J - work)
            work += done
            total = list(map(add, total, applied))
        x = account.position
        mean = tuple([f / count for f in total])
        return Step(
            tuple([(b - a) / dt for a, b in zip(start, x, strict=True)]),
            tuple(map(neg, mean)),
            -work,
            0.0,
            mean,
            x,
            account.depth,
        )

    def _held(self, h: float) -> Substep:
        """Substeps of `h` [s] with a held force."""
        gains = self._gains(h)

        def substep(h: float, set_position: Vector, most_J: float) -> tuple[Vector, float]:
            before = self._account.velocity
            applied, done = self._account.substep(h, self._demand(h, gains, set_position), most_J)
            self._note(h, before, applied)
            return applied, done

        return substep

    def _demand(self, h: float, gains: tuple[Product, Product], set_position: Vector) -> Vector:
        """The coupling's force for the next substep of `h` [s]: F above [N]."""
        (spring, damper), account = gains, self._account
        e = tuple(map(sub, account.position, set_position))
        u = [v + h * a for v, a in zip(account.velocity, self._pushed, strict=True)]
        return tuple(map(neg, map(add, spring(e), damper(u))))

    def _note(self, h: float, before: Vector, applied: Vector) -> None:
        """Note the acceleration by other forces, after a substep with `applied` [N] from the velocity `before`."""
        own = self._inverse_mass(applied)
        changed = zip(self._account.velocity, before, own, strict=True)
        self._pushed = tuple([(w - v) / h - a for w, v, a in changed])

    def _coupled(self, h: float) -> Substep:
        """Substeps of `h` [s] in which the engine integrates the proxy on its coupling."""

        def substep(h: float, set_position: Vector, most_J: float) -> tuple[Vector, float]:
            def force(x: Vector, reached: Vector) -> Vector:
                e = [0.5 * (a + b) - y for a, b, y in zip(x, reached, set_position, strict=True)]
                v = [(b - a) / h for a, b in zip(x, reached, strict=True)]
                return tuple(map(neg, map(add, self._stiffness(e), self._damper(v))))

            return self._account.coupled_substep(h, (set_position, self._K, self._B), force, most_J)

        return substep

    def _gains(self, h: float) -> tuple[Product, Product]:
        """The force's dependence on the spring's length and on the velocity, in a substep of `h` [s]."""
        own = self._account.ask("inverse_mass")
        known = None if own is None or isinstance(own, float) else self._inverse_of(own)
        key = h, own if known is None else known.tobytes()
        if key != self._gains_of:
            if known is None:
                known = self._lightness if own is None else self._inverse_of(own)
            B, K = self._B, self._K
            gain = np.linalg.inv(np.eye(self._account.dof) + (h * B + h * h * K) @ known)
            self._inverse_mass, self._gains_of = _product(known), key
            self._known_gains = _product(gain @ K), _product(gain @ (B + h * K))
        return self._known_gains

    def _inverse_of(self, own: ArrayLike) -> Array:
        """W (n, n) [1/kg], from the engine's inverse mass `own`."""
        dof = self._account.dof
        try:
            known = matrix_of("inverse_mass", own, dof)
        except (TypeError, ValueError, OverflowError):
            known = np.full((dof, dof), np.nan)
        numbers = known.ravel().tolist()
        if not (inner(numbers, numbers) < _LIGHTEST**2 and min(numbers[:: dof + 1]) >= 0.0):
            allowed = f"one number, {dof} or {dof} x {dof}, from 0 to {_LIGHTEST:g} per kg on the diagonal"
            raise self._account.failed(f"inverse_mass() gave {own!r:.80}; allowed: {allowed}")
        return known

    def _potential_J(self, x: Vector, set_position: Vector) -> float:
        e = tuple(map(sub, x, set_position))
        return 0.5 * float(inner(e, self._stiffness(e)))

    def push(self, dt: float, drag: float, push: Vector, contacts: Surroundings | None = None) -> Step:
        """Step under a held force. A law's drag is refused: it would have to be solved together with the engine's step.

        A substep that makes a debt which cannot be paid is repeated without force (`EngineAccount`).
        """
        if drag != 0.0:
            raise HapnetError("an engine's scene needs a coupling whose virtual mass has a spring, such as pspm")
        return self._advance(dt, lambda h: self._account.substep, push, inf)


class EngineWorld(WorldDefaults, Surroundings):
    """An engine as a world, and its own surroundings. An object serves one run.

    engine : an `Engine`, or an object with its five required methods. name : in summaries and figures.
    min_s, max_s : range of the step time T_k [s]; by default that of the parameters.

    Raises HapnetError: the engine lacks a method, or returns an invalid value; InvalidParameter.
    """

    dof, moves_proxy = 1, True
    warnings: tuple[str, ...] = ()
    units: str = METRES

    def __init__(
        self, engine: object, *, name: str = "own", min_s: float | None = None, max_s: float | None = None
    ) -> None:
        if missing := lacking(engine, Engine.__abstractmethods__):
            raise EngineFailed(name, f"its engine has no {', '.join(missing)}")
        whole = engine if isinstance(engine, Engine) else cast(Engine, Completed(engine, Engine))
        self.name: str = name
        self.engine: Engine = whole
        self.account: EngineAccount = EngineAccount(whole, name)
        if not (isinstance(whole.substep_s, int | float) and whole.substep_s >= SHORTEST_S):
            raise self.account.failed(f"its substep_s is {whole.substep_s!r}; allowed: {SHORTEST_S:g} s or more")
        self.dof = self.account.dof
        self._has_steps = min_s is not None or max_s is not None
        self._steps = Scene(name, 1, (), min_s or STEP_MIN_S, max_s or STEP_MAX_S)
        self.start: Vector = self.account.position
        self.units = whole.units
        self.warnings = tuple(whole.warnings)
        if not self.account.knows_energy:
            self.warnings += ("the engine does not report its energy: it can give back only energy that was put in",)

    @property
    def contacts(self) -> EngineWorld:
        return self

    def proxy(self, mass: ArrayLike, damping: ArrayLike, stiffness: ArrayLike) -> EngineMass:
        """The proxy, of `mass` [kg] if the engine supports the choice."""
        self.account.ask("weigh", mass)
        self.account.look()
        return EngineMass(self.account, mass, damping, stiffness)

    def picture(self) -> Picture | None:
        own: Picture | None = self.account.ask("picture")
        shapes = () if own else self.account.ask("shapes")
        return ShapesPicture(shapes, partial(self.account.ask, "poses"), self.planes) if shapes else own

    def steps_between(self, min_s: float, max_s: float) -> bool:
        if not self._has_steps:
            self._steps = replace(self._steps, min_s=min_s, max_s=max_s)
        return not self._has_steps

    def next_step_s(self, rng: np.random.Generator) -> float:
        return self._steps.next_step_s(rng)

    def towards(self, position: Vector) -> Vector:
        """The farthest point from the start towards `position` where the proxy is free, to a thousandth."""
        free_towards(self.start, position, self.account.place)
        return self.account.position

    def signal(self, name: str, value: Signal) -> None:
        self.engine.signal(name, value)

    def signals(self) -> Mapping[str, Signal]:
        return self.engine.signals()

    @property
    def observed(self) -> Observed:
        return self.account.observed

    @property
    def supplied_J(self) -> float:
        """Work of the engine's motors [J]."""
        return self.account.supplied_J

    def stored_J(self, position: Sequence[float]) -> float:
        """Kinetic and potential energy of all bodies, the proxy's too [J]."""
        return self.account.energy_J

    def solve(
        self, dt: float, position: Sequence[float], velocity: list[float], inverse: Inverse
    ) -> tuple[Sequence[float], list[float]]:
        """Never called: the engine integrates the proxy itself."""
        raise HapnetError("an engine moves its proxy itself")

    def penetration(self, position: Sequence[float]) -> float:
        return self.account.depth

    @property
    def contact_force(self) -> Vector | None:
        """The force of all contacts on the proxy, its mean over the last step [N]."""
        return self.account.contact_force

    def planes(self, position: Sequence[float], reach_m: float) -> tuple[Plane, ...] | None:
        """The planes around the proxy at its present place, whatever `position` is."""
        reported: Sequence[Plane] | None = self.account.ask("planes", tuple(position), reach_m)
        return None if reported is None else contact_planes(self.account.name, reported, self.dof)


def free_towards(start: Vector, position: Vector, place: Callable[[Vector], bool]) -> None:
    """Place a proxy as far from `start` towards `position` (n,) [m] as it is free there, to a thousandth.

    place : puts it somewhere, and returns whether it is free there.
    """

    def along(share: float) -> Vector:
        return tuple([a + share * (x - a) for a, x in zip(start, position, strict=True)])

    low, high = 0.0, 1.0
    if place(position):
        return
    for _ in range(10):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if place(along(middle)) else (low, middle)
    place(along(low))


def _product(matrix: Array) -> Product:
    """A function that multiplies a vector by `matrix`; faster than numpy for three axes."""
    if not (matrix - np.diag(np.diagonal(matrix))).any():
        diagonal = np.diagonal(matrix).tolist()
        return lambda vector: list(map(mul, diagonal, vector))
    rows = matrix.tolist()
    return lambda vector: [inner(row, vector) for row in rows]


def matrix_of(name: str, value: ArrayLike, dof: int) -> Array:
    """An (n, n) matrix from a scalar, a diagonal or a matrix."""
    given = np.asarray(value, dtype=float)
    if given.ndim == 2 and given.shape == (dof, dof):
        return given
    if given.ndim < 2 and given.size in (1, dof):
        return np.diag(np.broadcast_to(given, (dof,)))
    raise InvalidParameter(name, value, f"one number, {dof} numbers or a {dof} x {dof} matrix")
