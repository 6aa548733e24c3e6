"""A follower's servo: a robot in the virtual mass's place, with a force that is held from tick to tick.

A follower is a device like the leader: PSPM, measured harvest and account at the actuator's port are those of
`set_position_servo`. In addition it takes the world's place: its y is the leader's predicted motion, and it sends the
leader a `ProxySample`. A real robot runs this servo as a device runs its own. A simulated robot is moved by the steps
of a world; each step is a tick.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from hapnet.checks import Vector
from hapnet.control.coupling import PositionSample, Update
from hapnet.control.reporter import SampleReporter
from hapnet.control.set_position_servo import SampledServo
from hapnet.control.set_position_steps import SetPositionSteps
from hapnet.mechanics.contacts import Mass, Step, Surroundings
from hapnet.records.vectors import added, inner

REST_S = 0.2
"""A released robot first holds its set-position for this time, to come to rest [s]: without a force it would drift."""

Feedback = Callable[[Vector, Vector, Vector], Vector]
"""Returns the position to send [m], from the follower's position [m], the set-position that it follows [m], and the
force of its surroundings on it [N]."""


def position(x: Vector, target: Vector, force: Vector) -> Vector:
    """Position-position: the leader's spring is tied to the follower's position."""
    return x


def reflected(stiffness: Vector) -> Feedback:
    """Position-force: the leader's spring renders the force on the follower. stiffness : its K along each axis [N/m].

    With y = x_d + f/K, and x_d the leader's position that the follower follows, the spring's force is f while the
    leader stands still. PSPM pays for y as for any other y: the measured force need not be correct.
    """

    def feedback(x: Vector, target: Vector, force: Vector) -> Vector:
        return tuple([y + f / k for y, f, k in zip(target, force, stiffness, strict=True)])

    return feedback


class FollowerServo(SampledServo):
    """PSPM and force of a follower.

    reporter : makes the `ProxySample`; None: a bare position is sent. The other arguments are those of `SampledServo`.

    Attributes
    ----------
    feedback : see `Feedback`. released : its leader has released it, so it renders no force once it is at rest.
    sensed : the force of its surroundings on it, set by the code that moves the robot [N].
    """

    def __init__(self, reporter: SampleReporter | None, **servo: Any) -> None:
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
    """The world's end of a simulated follower: a `WorldCoupling` that moves its mass by a held force.

    period : of the servo [s]; a late step is made in parts of this length. watchdog : a servo that is later than this
        renders no force until it is on time again [s].
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
        """As `update`: the servo's own ledger, at the actuator's port, counts the work of the held force."""
        return self.update(dt, x, dissipated)

    def update(self, dt: float, x: Vector, dissipated: float) -> Update:
        """Do a tick of the servo, `dt` seconds after the last, at x [m]."""
        return self.servo.tick(dt, x, self._velocity, release=dt > self._watchdog) or Update(None)


def _joined(parts: list[Step], lengths: list[float]) -> Step:
    """Join consecutive steps of these lengths [s] into one."""
    end, dt = parts[-1], math.fsum(lengths)

    def mean(vectors: list[Vector]) -> Vector:
        return tuple([inner(lengths, along) / dt for along in zip(*vectors, strict=True)])

    return Step(
        mean([part.velocity for part in parts]),
        mean([part.force for part in parts]),
        added([part.work_J for part in parts]),
        added([part.dissipated_J for part in parts]),
        end.coupling_force,
        end.position,
        end.penetration_m,
    )
