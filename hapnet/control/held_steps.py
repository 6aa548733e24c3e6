"""A follower's servo: a robot in the virtual mass's place, whose force is held from tick to tick.

A follower is a device like the leader: PSPM, measured harvest and account at the actuator's port are those of
`set_position_servo`. What it adds is its place in the world's half: y is the leader's motion, predicted, and the leader
is sent a `ProxySample`. A real robot has this servo as a device has its own. A simulated one is moved by the steps of a
world, each of which is a tick.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from hapnet.checks import Vector
from hapnet.control.coupling import PositionSample, Update
from hapnet.control.reporter import Teller
from hapnet.control.set_position_coupling import SetPositionSteps
from hapnet.control.set_position_servo import SampledServo
from hapnet.mechanics.contacts import Mass, Step, Surroundings
from hapnet.records.vectors import added, inner

REST_S = 0.2
"""A robot that is released holds its set-position for so long first [s]: without a force it would only drift on."""

Feedback = Callable[[Vector, Vector, Vector], Vector]
"""The position to send [m], of the follower's position, the set-position that it follows [m], and the force of its
surroundings on it [N]."""


def position(x: Vector, target: Vector, force: Vector) -> Vector:
    """Position-position: the leader's spring is tied to where the follower is."""
    return x


def reflected(stiffness: Vector) -> Feedback:
    """Position-force: the leader's spring renders the force on the follower. stiffness : its K along each axis [N/m].

    With y = x_d + f/K, and x_d the leader's position that the follower follows, the spring's force is f where the
    leader stands still. PSPM pays for y as for any other: the measured force need not be true.
    """

    def say(x: Vector, target: Vector, force: Vector) -> Vector:
        return tuple([y + f / k for y, f, k in zip(target, force, stiffness, strict=True)])

    return say


class FollowerServo(SampledServo):
    """PSPM and force of a follower.

    reporter : makes the `ProxySample`; None: a bare position is sent. The other arguments are those of `SampledServo`.

    Attributes
    ----------
    feedback : see `LawMessage`. released : its leader has let go, so it renders no force once it has come to rest.
    sensed : the force of its surroundings on it, as whoever moves the robot knows it [N].
    """

    def __init__(self, reporter: Teller | None, **servo: Any) -> None:
        super().__init__(**servo)
        self.reporter = reporter
        self.feedback: Feedback = position
        self.released: bool = False
        self._rested_s = 0.0
        self.sensed: Vector = (0.0,) * self.n

    def tick(self, dt: float, x: Vector, v: Vector, *, release: bool = False) -> Update | None:
        if self.reporter is not None:
            self.reporter.look(dt, x)
        self._rested_s = self._rested_s + dt if self.released else 0.0
        done = super().tick(dt, x, v, release=release or self._rested_s > REST_S)
        if done is None or done.sample is None:
            return done
        level, feedback = self.coupling.level, self.feedback(x, self.coupling.target, self.sensed)
        if self.reporter is not None:
            return Update(self.reporter.proxy(feedback, level), done.shuffled)
        return Update(feedback if level is None else PositionSample(feedback, level), done.shuffled)


class HeldSteps(SetPositionSteps):
    """The world's end of a simulated follower: a `WorldCoupling` whose mass is moved by a held force.

    period : of the servo [s]; a late step is made in parts so long. watchdog : a servo that is later than this renders
        no force until it is on time again [s].
    """

    def __init__(self, servo: FollowerServo, period: float, watchdog: float) -> None:
        super().__init__(servo.coupling)
        self.servo = servo
        self._period, self._watchdog = period, watchdog
        self._velocity: Vector = (0.0,) * servo.n

    def advance(self, mass: Mass, dt: float, contacts: Surroundings) -> Step:
        parts, lengths, left = [], [], dt
        while left > 1.5 * self._period:
            parts.append(mass.push(self._period, 0.0, self.servo.force, contacts))
            lengths.append(self._period)
            self.servo.force = parts[-1].coupling_force
            self.servo.follow(self._period, parts[-1].position)
            left -= self._period
        parts.append(mass.push(left, 0.0, self.servo.force, contacts))
        self.servo.force = parts[-1].coupling_force  # an engine may have applied less
        done = parts[0] if len(parts) == 1 else _joined(parts, [*lengths, left])
        self._velocity, self.servo.sensed = mass.velocity, done.force
        if self.servo.reporter is not None:
            self.servo.reporter.moved(done, contacts)
        return done

    def counted(self, dt: float, x: Vector, kinetic: float, work: float, dissipated: float) -> Update:
        """As `update`: the servo's ledger is at the actuator's port, and counts the force that was held."""
        return self.update(dt, x, dissipated)

    def update(self, dt: float, x: Vector, dissipated: float) -> Update:
        """A tick of the servo, `dt` seconds after the last, at x [m]."""
        return self.servo.tick(dt, x, self._velocity, release=dt > self._watchdog) or Update(None)


def _joined(parts: list[Step], lengths: list[float]) -> Step:
    """Steps of these lengths [s] one after the other, as one."""
    end, dt = parts[-1], math.fsum(lengths)

    def mean(vectors: list[Vector]) -> Vector:
        return tuple([inner(lengths, along) / dt for along in zip(*vectors, strict=True)])

    return Step(
        mean([one.velocity for one in parts]),
        mean([one.force for one in parts]),
        added([one.work_J for one in parts]),
        added([one.dissipated_J for one in parts]),
        end.coupling_force,
        end.position,
        end.penetration_m,
    )
