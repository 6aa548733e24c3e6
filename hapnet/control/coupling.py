"""The protocols that every coupling implements, and adapters that turn a simple law into a coupling.

A coupling has two ends. The device's end chooses the force to hold at each tick; the world's end makes each step of the
virtual mass. Each end sends samples to the other, and may shuffle energy to it. The rest of a side reads an end's
account and set-position from its `CouplingState`.

Most laws need less. They implement `DeviceLaw` and `WorldLaw` below, and `LawServo` and `LawSteps` turn these into the
two ends. For such a law a step of the virtual mass M is

    (2M/T + g) vhat = 2M/T v + p + f                    g: drag [Ns/m], p: push [N], f: of the environment [N]

The law gives g and p for each step. So its reaction to the mass may be implicit, and a step may take any time T.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, NamedTuple, Protocol, TypeVar

from hapnet.checks import Vector
from hapnet.control import ledger as ledgers
from hapnet.control.law import HeldForce, begin_tick, sends, tick
from hapnet.control.law_state import Law as Law, LawState as LawState, Stamped as Stamped
from hapnet.control.ledger import Ledger
from hapnet.control.samples import (
    CouplingSample as CouplingSample,
    MotionSample as MotionSample,
    PortSample as PortSample,
    PositionSample as PositionSample,
    ProxySample as ProxySample,
    WaveSample as WaveSample,
    level_of as level_of,
    vector_of as vector_of,
)
from hapnet.mechanics.contacts import Mass, Step, Surroundings
from hapnet.records.record import Reals, equation
from hapnet.records.vectors import inner

Made = TypeVar("Made")


class ForceParts(NamedTuple):
    """The parts of a device's force [N]. Spring and damper add up to the force, unless a limit reduces it."""

    spring: Vector
    """K (ybar - x)."""
    damper: Vector
    """-B v."""
    model: Vector
    """The part of the spring's force that comes from the local contact model's planes."""
    added_damping: Vector
    """The part of the spring's force that is added damping."""


class Update(NamedTuple):
    """The result of an update at either end: the sample to send, if one is due, and the energy to shuffle [J]."""

    sample: CouplingSample | None
    shuffled: float = 0.0


class CouplingState(Protocol):
    """The state of one end of a coupling, for a side's runtime, recording and summary."""

    ledger: Ledger
    energy_min: float
    """Smallest content of the reservoir so far [J]."""
    deficit_max: float
    discarded: float
    account: float
    """The reservoir's content as the ledger counts it [J]."""

    @property
    def modulated_share(self) -> float | None:
        """The share of the updates in which the energy did not suffice for y; None: no updates."""

    @property
    def set_position(self) -> Vector:
        """The point to which its spring is tied [m]; without a spring, the assumed position of the other side.

        Its distance from the position is the force divided by the coupling's stiffness: the deadband relies on that.
        """

    @property
    def target(self) -> Vector:
        """The point to which its spring would be tied with unlimited energy [m]."""

    @property
    def reservoir(self) -> float: ...
    @property
    def deficit(self) -> float: ...

    def potential(self, x: Vector) -> float:
        """Energy stored in its spring at x [J]."""

    def receive(self, sample: CouplingSample, sent_s: float, age_s: float) -> None:
        """Take in a sample that arrived. No sample arrives twice, and none comes from an earlier peer.

        sent_s : time at which it was sent, on the other side's clock [s].
        age_s : its present age [s]. For a `ProxySample` with `aimed`: exactly, since the device's own time for which it
            holds. For any other sample: since it was sent, estimated from the minimum round trip.
        """

    def credit(self, energy: float) -> None:
        """Take in shuffled energy that arrived [J]; the next update uses it, once."""

    def on_peer_changed(self) -> float:
        """Start again with a new peer; its counts start at zero. Returns the energy to shuffle to that peer [J]."""


class DeviceCoupling(Protocol):
    """A device's end that holds its force from tick to tick; its account is at the actuator's port."""

    force: Vector
    """The force held now [N]. A driver that measures the force really applied sets it before the next tick."""
    trusted_damping: Vector

    @property
    def harvest(self) -> str:
        """ "measured": the dissipation under zero-order hold is measured; "range": it is bounded by (10)."""

    @property
    def coupling(self) -> CouplingState: ...
    @property
    def account(self) -> float:
        """The reservoir's content plus the harvest of the current interval [J]."""

    @property
    def quantisation(self) -> float | None:
        """The most by which encoder quantisation can put the true slack below the measured slack [J]; None: unknown."""

    @property
    def parts(self) -> ForceParts | None:
        """The parts of the force of the last tick; None: this coupling does not compute them."""

    def figures(self) -> dict[str, Any]:
        """The figures of the zero-order hold, by the summary's keys; empty if the coupling keeps no such account."""

    def tick(self, dt: float, x: Vector, v: Vector, *, release: bool = False) -> Update | None:
        """Do a tick `dt` seconds after the last, at x [m] and v [m/s]. Sets `force`; returns what to send, if any.

        `release`: the servo was late, so it renders no force until it is on time again.
        """

    def skippable_ticks(self, dt: float) -> int:
        """The number of coming ticks, `dt` seconds apart, that return None if nothing arrives; 0 is always correct."""

    def stop(self) -> None:
        """Render no force from now until the next tick."""


class WorldCoupling(Protocol):
    """The world's end of a coupling."""

    @property
    def coupling(self) -> CouplingState: ...
    def advance(self, mass: Mass, dt: float, contacts: Surroundings) -> Step:
        """Move the mass through a step of `dt` seconds."""

    def update(self, dt: float, x: Vector, dissipated: float) -> Update:
        """Begin the next step, at x(k) [m] and with D(k-1) [J], with the samples that have arrived by now."""


class Ends:
    """Replaces ends by faster ones with the same results, where possible. This base class replaces none."""

    def servo(self, servo: DeviceCoupling) -> DeviceCoupling:
        """The device's end, before its first tick."""
        return servo

    def simulated(self, device: Made) -> Made:
        """A simulated device, before its first tick."""
        return device

    def steps(self, steps: WorldCoupling, mass: Mass, contacts: Surroundings) -> WorldCoupling:
        """The world's end, before its first step; `mass` and `contacts` are those of its steps."""
        return steps

    def mass(self, steps: WorldCoupling, mass: Mass) -> Mass:
        """The mass that replaces `mass` once `steps` is made for it."""
        return mass


@equation
def counted(world: Any, dt: float, x: Reals, kinetic: float, work: float, dissipated: float) -> Update:
    """Update the world's end, a `WorldCoupling` or its record, and its ledger; the arguments are those of
    `WorldControl.step`.

    The ledger is checked before the law (steps to k-1 with ybar_{k-1}) and after it (with ybar_k): both pairings of
    Theorem 1. A measured D may be negative: it is then charged before the ledger is checked.
    """
    coupling = world.coupling
    ledger = coupling.ledger
    ledgers.put_in(ledger, work)
    ledgers.observe(ledger, kinetic + potential(coupling, x), coupling.account + min(0.0, dissipated))
    done: Update = update(world, dt, x, dissipated)
    ledgers.observe(ledger, kinetic + potential(coupling, x), coupling.account)
    return done


def update(world: WorldCoupling, dt: float, x: Reals, dissipated: float) -> Update:
    """Call the end's `update`. Compiled code replaces this and `potential` by the end's own (ext/compiled/kinds.py)."""
    return world.update(dt, tuple(x), dissipated)


def potential(coupling: CouplingState, x: Reals) -> float:
    """Call the coupling's `potential` [J]."""
    return coupling.potential(tuple(x))


class DeviceLaw(Law, Protocol):
    """The device's end of a law."""

    def force(self, dt: float, x: Vector, v: Vector, held: Vector) -> Vector:
        """The force on the device [N], to hold until the next tick.

        dt : time since the last tick [s]. x, v : measured position [m] and velocity [m/s].
        held : the force really held since the last tick [N].
        """

    def next_sample(self, x: Vector, v: Vector) -> CouplingSample:
        """The sample to send to the world; called every few ticks, after `force`."""

    def release(self, dt: float, x: Vector, held: Vector) -> None:
        """Called in place of `force` while a late servo renders no force, until it is on time again."""


class WorldLaw(Law, Protocol):
    """The world's end of a law."""

    def begin(self) -> None:
        """Begin a step, with the samples that have arrived by now."""

    def impedance(self, dt: float) -> tuple[float, Vector]:
        """Drag g [Ns/m] and push p [N] of a step of `dt` seconds."""

    def moved(self, dt: float, vhat: Vector, x: Vector, v: Vector) -> None:
        """Complete the step: the mass moved with the mean velocity vhat [m/s] to x [m], with velocity v [m/s] there."""

    def next_sample(self) -> CouplingSample:
        """The sample to send to the device, after each step."""


class LawSteps:
    """A `WorldCoupling` made of the world's end of a law.

    law, initial_energy, stamped : as in `LawState`.
    """

    def __init__(self, law: WorldLaw, initial_energy: float, stamped: Stamped | None = None) -> None:
        self.law = law
        self.coupling: LawState[WorldLaw] = LawState(law, initial_energy, stamped)

    def advance(self, mass: Mass, dt: float, contacts: Surroundings) -> Step:
        drag, push = self.law.impedance(dt)
        done = mass.push(dt, drag, push, contacts)
        self.law.moved(dt, done.velocity, done.position, mass.velocity)
        self.coupling.fill(-dt * inner(done.coupling_force, done.velocity))
        return done

    def update(self, dt: float, x: Vector, dissipated: float) -> Update:
        """Begin a step. Returns the sample of the last step, to send to the device, and the energy to shuffle."""
        self.law.begin()
        return Update(self.law.next_sample(), self.coupling.give(dt))


class LawServo(HeldForce):
    """A `DeviceCoupling` made of the device's end of a law.

    law : the device's end.
    period : time between the samples sent [s].
    position : the first measured position [m].
    initial_energy : this side's share of d^2 [J].
    force_limit : maximum force of the actuator [N]; the law receives the force really held. step_limit, stiffness,
        speed, inertia : as `HeldForce.step`, `stiffness`, `speed` and `inertia`.
    stamped : as in `LawState`.
    """

    harvest = "measured"
    quantisation: ClassVar[float | None] = None
    """None: the effect of encoder quantisation on a law's account is unknown."""
    parts: ClassVar[ForceParts | None] = None
    """None: a law's force is not split into parts."""

    def __init__(
        self,
        law: DeviceLaw,
        *,
        period: float,
        position: Vector,
        initial_energy: float,
        force_limit: float,
        step_limit: float = math.inf,
        stiffness: float = 0.0,
        speed: float = math.inf,
        inertia: float = math.inf,
        stamped: Stamped | None = None,
    ) -> None:
        super().__init__()
        self.law = law
        self.coupling: LawState[DeviceLaw] = LawState(law, initial_energy, stamped)
        self.n = len(position)
        self.trusted_damping: tuple[float, ...] = (0.0,) * self.n
        self.position = list(position)
        self.held, self.before, self.caused = ([0.0] * self.n for _ in range(3))
        self.step, self.stiffness = step_limit, stiffness
        self.speed, self.inertia = speed, inertia if speed < math.inf else math.inf
        self.due, self.limit = period - TICK_SLACK_S, force_limit

    @property
    def account(self) -> float:
        """This side's share of d^2 [J]."""
        return self.coupling.account

    @property
    def force(self) -> Vector:
        """The force held now [N]. A driver that measures the force really applied sets it before the next tick."""
        return tuple(self.held)

    @force.setter
    def force(self, force: Vector) -> None:
        self.held[:] = force

    def figures(self) -> dict[str, Any]:
        return {} if self.coupling.tank is None else dict(self.coupling.tank.figures)

    def tick(self, dt: float, x: Vector, v: Vector, *, release: bool = False) -> Update | None:
        shuffled = 0.0
        if self.coupling.tank is not None:
            self.coupling.fill(inner(self.held, [before - at for before, at in zip(self.position, x, strict=True)]))
            shuffled = self.coupling.give(dt)
        if release:
            begin_tick(self, self.coupling, x)
            self.law.release(dt, x, tuple(self.held))
            self.stop()
            due = sends(self, dt)
        else:
            law: Any = self.law
            due = tick(self, self.coupling, law, dt, x, v)
        self.coupling.fill(0.0)
        return Update(self.law.next_sample(x, v) if due else None, shuffled) if due or shuffled else None

    def skippable_ticks(self, dt: float) -> int:
        return 0 if self.coupling.tank is not None else ticks_before(self.due, self.elapsed, dt)

    def stop(self) -> None:
        self.held[:] = [0.0] * self.n


TICK_SLACK_S = 1e-9
"""Tolerance of a period [s]: a clock in whole nanoseconds may measure it one nanosecond short."""


def ticks_before(due: float, elapsed: float, dt: float) -> int:
    """The number of ticks, `dt` seconds apart, before the tick in which `due` s have passed; `elapsed` s have now."""
    ticks, elapsed = 0, elapsed + dt
    while elapsed < due:
        ticks += 1
        elapsed += dt
    return ticks
