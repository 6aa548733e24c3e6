"""A law's two ends as records, with equations that plain Python runs and numba compiles.

Each end of hapnet's own laws is a `DeviceEnd` or a `WorldEnd`. Their methods that work on records are equations; these
classes wrap them into the methods of `DeviceLaw` and `WorldLaw`. A user's own law needs none of this, and is not
compiled.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, ClassVar

from hapnet.checks import Vector
from hapnet.control import ledger as ledgers
from hapnet.control.ledger import Ledger
from hapnet.control.limits import limit_step
from hapnet.control.reserve import limit_speed
from hapnet.control.samples import CouplingSample, MotionSample, PortSample, WaveSample, vector_of
from hapnet.records.record import Floats, OfAxes, Reals, Record, compiled_as, equation
from hapnet.records.vectors import copy, dot

NOT_SENT = -1.0
"""The time of an integral that its sender does not send [s]."""


class LawMessage(Record):
    """A message of an end. value : a position [m], a port's value [m or N] or a wave [sqrt(W)]. more : a motion's
    velocity [m/s]. amount : a port's energy [J] or a wave's span [s].
    """

    value: OfAxes
    more: OfAxes
    amount: float


class End(Record):
    """One end of a law. n : the number of axes. y : its set-position [m]. outgoing : its next message."""

    n: int
    y: OfAxes
    outgoing: LawMessage

    sends: ClassVar[type[MotionSample] | type[PortSample] | type[WaveSample] | None] = None
    """The kind of samples that the end sends; None: bare positions."""

    def __init__(self, position: Vector) -> None:
        super().__init__()
        self.n, self.y = len(position), list(position)
        self.outgoing.value, self.outgoing.more = [0.0] * self.n, [0.0] * self.n

    @property
    def set_position(self) -> Vector:
        """The point to which the spring is tied [m]: see `CouplingState.set_position`."""
        return tuple(self.y)

    def receive(self, sample: CouplingSample) -> None:
        """Take in a sample that arrived: see `CouplingState.receive`."""
        match sample:
            case MotionSample(position, velocity):
                self.take(position, velocity, 0.0, NOT_SENT)
            case PortSample(value, energy):
                self.take(value, value, energy, NOT_SENT)
            case WaveSample(value, span, total, total_s):
                self.take(value, total, span, total_s if total else NOT_SENT)
            case _:
                position = vector_of(sample)
                self.take(position, position, 0.0, NOT_SENT)

    def take(self, value: Reals, more: Reals, amount: float, total_s: float) -> None:
        """Take in a sample: see `LawMessage`; for a wave `more` is its integral [sqrt(W) s] over `total_s` [s]."""
        raise NotImplementedError

    def _sample(self) -> CouplingSample:
        outgoing = self.outgoing
        value = tuple(outgoing.value)
        if self.sends is MotionSample:
            return MotionSample(value, tuple(outgoing.more))
        if self.sends is PortSample:
            return PortSample(value, outgoing.amount)
        return WaveSample(value, outgoing.amount) if self.sends is WaveSample else value

    @classmethod
    def lines(cls) -> dict[Callable[..., Any], Callable[..., Any]]:
        """The functions to compile in place of the functions that call a Python object of this end."""
        return {}


class DeviceEnd(End):
    """The device's end of a law: a `DeviceLaw`. out : memory for its force."""

    out: OfAxes

    def __init__(self, position: Vector) -> None:
        super().__init__(position)
        self.out = [0.0] * self.n

    def force(self, dt: float, x: Vector, v: Vector, held: Vector) -> Vector:
        """The force to hold [N]; the arguments are those of `DeviceLaw.force`."""
        self.render(dt, x, v, held, self.out)
        return tuple(self.out)

    def next_sample(self, x: Vector, v: Vector) -> CouplingSample:
        """The sample to send."""
        self.set_outgoing(x, v)
        return self._sample()

    def render(self, dt: float, x: Reals, v: Reals, held: Reals, out: Floats) -> None:
        """Compute `force` into `out`."""
        raise NotImplementedError

    def set_outgoing(self, x: Reals, v: Reals) -> None:
        """Write the next sample into `outgoing`."""
        raise NotImplementedError


class WorldEnd(End):
    """The world's end of a law: a `WorldLaw`. push : the push p of the running step [N]."""

    push: OfAxes

    def __init__(self, position: Vector) -> None:
        super().__init__(position)
        self.push = [0.0] * self.n

    @equation
    def stamp(self, value: Reals, sent_s: float, age_s: float) -> None:
        """Take in the time and the age of a position or port's value that arrived, as `CouplingState.receive`."""

    @equation
    def begin(self) -> None:
        """Begin a step, with the samples that have arrived by now."""

    def impedance(self, dt: float) -> tuple[float, Vector]:
        """Drag g [Ns/m] and push p [N] of a step of `dt` seconds."""
        drag = self.drag(dt)
        return drag, tuple(self.push)

    def drag(self, dt: float) -> float:
        """The drag of a step [Ns/m]; its push goes into `push`."""
        raise NotImplementedError

    def moved(self, dt: float, vhat: Reals, x: Reals, v: Reals) -> None:
        """Complete the step, from the mass's motion in it: see `WorldLaw.moved`."""
        raise NotImplementedError

    def next_sample(self) -> CouplingSample:
        """The sample to send, after each step."""
        self.set_outgoing()
        return self._sample()

    def set_outgoing(self) -> None:
        """Write the next sample into `outgoing`."""
        raise NotImplementedError


class LawAccount(Record):
    """The account of a law's end: no reservoir, but the same share of d^2 as with PSPM, so that margins are comparable.

    account : that share [J]. shuffled : always 0.
    """

    ledger: Ledger
    account: float
    shuffled: float


class HeldForce(Record):
    """The force of a law, held from tick to tick.

    held : the force [N]. position : at the last tick [m]. due : time between two sent samples [s]; elapsed : time since
    the last of them [s]. limit : maximum force of the actuator [N]. step : maximum change of the force in a tick,
    beyond the part that the own motion causes through the spring of `stiffness` [N], [N/m]. speed : maximum speed of
    the device [m/s]; inertia : m/T of its smallest mass [Ns/m], infinite if the force may accelerate it further.
    before, caused : the force before this tick, and that part of its change [N].
    """

    n: int
    held: OfAxes
    before: OfAxes
    caused: OfAxes
    position: OfAxes
    step: float
    stiffness: float
    due: float
    elapsed: float
    limit: float
    speed: float
    inertia: float


@equation
def tick(servo: HeldForce, account: LawAccount, law: DeviceEnd, dt: float, x: Reals, v: Reals) -> bool:
    """Do a tick `dt` seconds after the last, at x [m] and v [m/s]; return whether a sample is due."""
    begin_tick(servo, account, x)
    if dt > 0.0:  # a law may divide by dt
        _render(servo, law, dt, x, v)
        cut(servo, v)
    return sends(servo, dt)


def _compiled_render(servo: HeldForce, law: DeviceEnd, dt: float, x: Reals, v: Reals) -> None:
    render(law, dt, x, v, servo.held, law.out)
    copy(servo.n, law.out, servo.held)


@compiled_as(_compiled_render)
def _render(servo: HeldForce, law: DeviceEnd, dt: float, x: Reals, v: Reals) -> None:
    """Hold the law's force; in Python the law may be any object."""
    servo.held[:] = law.force(dt, tuple(x), tuple(v), tuple(servo.held))


def render(law: DeviceEnd, dt: float, x: Reals, v: Reals, held: Reals, out: Floats) -> None:
    """Call the law's `render`; compiled code replaces this function by the method of the law's class."""
    law.render(dt, x, v, held, out)


@equation
def begin_tick(servo: HeldForce, law: LawAccount, x: Reals) -> None:
    """Count the work of the force that was held while the device moved to x [m]."""
    work = 0.0
    for i in range(servo.n):
        work += servo.held[i] * (x[i] - servo.position[i])
        servo.caused[i] = -servo.stiffness * (x[i] - servo.position[i])
    ledgers.put_in(law.ledger, -work)
    copy(servo.n, servo.held, servo.before)
    copy(servo.n, x, servo.position)
    ledgers.observe(law.ledger, 0.0, law.account)


@equation
def cut(servo: HeldForce, v: Reals) -> None:
    """Keep the force, its step and what it accelerates within their limits; v : velocity [m/s]."""
    if servo.inertia < math.inf:
        limit_speed(servo.n, servo.held, v, servo.speed, servo.inertia, servo.step)
    if servo.step < math.inf:
        limit_step(servo.n, servo.before, servo.caused, servo.held, servo.step)
    square = dot(servo.n, servo.held, servo.held)
    if square > servo.limit * servo.limit:
        share = servo.limit / math.sqrt(square)
        for i in range(servo.n):
            servo.held[i] = share * servo.held[i]


@equation
def sends(servo: HeldForce, dt: float) -> bool:
    """Whether a sample is due in this tick, `dt` seconds after the last."""
    servo.elapsed += dt
    if servo.elapsed < servo.due:
        return False
    servo.elapsed = 0.0
    return True
