"""The world's end where a robot stands in the virtual mass's place: its force is held from tick to tick.

A follower is a device like the leader: PSPM, measured harvest and account at the actuator's port are those of
`set_position_servo`. What it adds is its place in the world's half: a step of the world is a tick of its servo, y is
the leader's motion, predicted, and the leader is sent a `Proxy`.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from hapnet.checks import Vector
from hapnet.control.coupling import Position, Update
from hapnet.control.reporter import Teller
from hapnet.control.set_position_coupling import SetPositionSteps
from hapnet.control.set_position_servo import SampledServo
from hapnet.mechanics.contacts import Mass, Step, Surroundings
from hapnet.records.vectors import added, inner

Said = Callable[[Vector, Vector, Vector], Vector]
"""The position to send [m], of the follower's position, the set-position that it follows [m], and the force of its
surroundings on it [N]."""


def position(x: Vector, target: Vector, force: Vector) -> Vector:
    """Position-position: the leader's spring is tied to where the follower is."""
    return x


def reflected(stiffness: float) -> Said:
    """Position-force: the leader's spring K, `stiffness` [N/m], renders the force on the follower.

    With y = x_d + f/K, and x_d the leader's position that the follower follows, the spring's force is f where the
    leader stands still. PSPM pays for y as for any other: the measured force need not be true.
    """

    def say(x: Vector, target: Vector, force: Vector) -> Vector:
        return tuple([y + f / stiffness for y, f in zip(target, force, strict=True)])

    return say


class HeldSteps(SetPositionSteps):
    """A `WorldCoupling` whose mass is a robot under a held force.

    servo : its PSPM, account and force. reporter : as in `SetPositionSteps`. said : see `Said`.
    period : of the servo [s]; a late step is made in parts so long. watchdog : a servo that is later than this renders
        no force until it is on time again [s]; infinite: never.
    """

    def __init__(
        self, servo: SampledServo, reporter: Teller | None, *, said: Said, period: float, watchdog: float = math.inf
    ) -> None:
        super().__init__(servo.coupling, reporter)
        self.servo = servo
        self._said, self._period, self._watchdog = said, period, watchdog
        self._velocity: Vector = (0.0,) * servo.n
        self._force: Vector = (0.0,) * servo.n

    def advance(self, mass: Mass, dt: float, contacts: Surroundings) -> Step:
        parts, left = [], dt
        while left > 1.5 * self._period:
            parts.append(mass.push(self._period, 0.0, self.servo.force, contacts))
            self.servo.follow(self._period, parts[-1].position)
            left -= self._period
        parts.append(mass.push(left, 0.0, self.servo.force, contacts))
        done = parts[0] if len(parts) == 1 else _joined(parts, dt, (self._period,) * (len(parts) - 1) + (left,))
        self._velocity, self._force = mass.velocity, done.force
        if self.reporter is not None:
            self.reporter.moved(done, contacts)
        return done

    def counted(self, dt: float, x: Vector, kinetic: float, work: float, dissipated: float) -> Update:
        """As `update`: the servo's ledger is at the actuator's port, and counts the force that was held."""
        return self.update(dt, x, dissipated)

    def update(self, dt: float, x: Vector, dissipated: float) -> Update:
        """A tick of the servo, `dt` seconds after the last, at x [m]."""
        if self.reporter is not None:
            self.reporter.look(dt, x)
        done = self.servo.tick(dt, x, self._velocity, release=dt > self._watchdog)
        if done is None or done.sample is None:
            return Update(None) if done is None else done
        coupling = self.coupling
        said = self._said(x, coupling.target, self._force)
        if self.reporter is None:
            level = coupling.level
            return Update(said if level is None else Position(said, level), done.shuffled)
        return Update(self.reporter.proxy(said, coupling.level), done.shuffled)


def _joined(parts: list[Step], dt: float, lengths: tuple[float, ...]) -> Step:
    """Steps one after the other as one of `dt` seconds."""
    end = parts[-1]

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
