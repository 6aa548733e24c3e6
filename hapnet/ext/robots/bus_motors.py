"""The motors of an arm of servos on a bus: their limits, the work that they do, and their faults and temperatures.

The account counts the motors' work from the measured currents: between two readings the torques times the joints' turn,
less the change of the weight's potential. A current is sampled with its position; a new command acts from the end of
its packet, the previous one until then.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from hapnet.checks import Vector
from hapnet.ext.devices.timed_velocity import TimedVelocity
from hapnet.ext.robots.bus_joints import COUNT_RAD, JointServo
from hapnet.ext.robots.joint_torques import paid
from hapnet.records.vectors import inner

UNKNOWN = "a fault"
"""The fault of a servo before its driver has read the details."""

_HOT_K, _COOL_K = 5, 10
_CORRECTION = 0.9
"""The share of the force limit that a single reading may correct; the rest is counted with the next readings."""


class Present(NamedTuple):
    """The values from a servo. current : in its own unit, positive where counts grow. rate [rad/s] : None: unknown."""

    counts: int
    current: int
    rate: float | None = None
    fault: str = ""
    temperature_C: int | None = None


class Motor:
    """The motor of a joint. torque : per count of current [Nm]; 0: it has no current control. most : the largest count.

    Attributes
    ----------
    limit : its largest torque [Nm]. has_torque : whether it has current control.
    """

    def __init__(self, joint: JointServo, torque: float, most: int) -> None:
        self.joint, self.most = joint, most
        self._per_count = joint.sign * torque
        self.has_torque: bool = torque > 0.0
        self.limit: float = abs(self._per_count) * most
        self._slope = TimedVelocity(COUNT_RAD, COUNT_RAD)

    def torque(self, current: int) -> float:
        """The joint's torque of a measured current [Nm]."""
        return self._per_count * current

    def rate(self, at_s: float, angle: float, measured: float | None) -> float:
        """The joint's rate [rad/s] at its new angle; measured : as the servo reports it."""
        return self._slope.update(at_s, at_s, angle) if measured is None else self.joint.sign * measured

    def command(self, torque: float, weight: float, angle: float) -> int:
        """The count of current for a torque and the weight's [Nm]; no torque acts outward beyond the joint's stop."""
        if (angle >= self.joint.upper and torque > 0.0) or (angle <= self.joint.lower and torque < 0.0):
            torque = 0.0
        return max(-self.most, min(self.most, round((torque + weight) / self._per_count)))


class ArmReading(NamedTuple):
    """An arm at a time: its joints [rad], its axes' position, its motors' torques and the potential of its weight."""

    at_s: float
    q: Vector
    x: Vector
    torques: Vector
    stored_J: float


class MotorWork:
    """The account of an arm's motors. force_limit : of the arm [N]; None: its motors have no current control.

    Attributes
    ----------
    reading : the newest; None: there is none. acted : the force nearest to the command that did the motors' work since
    the reading before [N]; None: not known. owed_J : work not yet assigned to a force.
    """

    def __init__(self, dof: int, force_limit: float | None) -> None:
        self._none = (0.0,) * dof
        self._most = None if force_limit is None else _CORRECTION * force_limit
        self._commands = (self._none, self._none)  # the previous command, and the newest
        self._sent_s = self.owed_J = 0.0
        self.reading: ArmReading | None = None
        self.acted: Vector | None = None

    def command(self, force: Vector, sent_s: float | None = None) -> None:
        """Note a command that acts from the time `sent_s` on; None: from that of the previous command."""
        self._commands = (self._commands[1], force)
        self._sent_s = self._sent_s if sent_s is None else sent_s

    def take(self, now: ArmReading, *, counts: bool) -> None:
        """Take a new reading; counts : whether the motors may have done work since the previous one."""
        before, self.reading = self.reading, now
        if self._most is not None:
            self.acted = self._mean_force(before, now, self._most) if counts and before is not None else self._none

    def _mean_force(self, before: ArmReading, now: ArmReading, most_N: float) -> Vector:
        early = min(1.0, max(0.0, (self._sent_s - before.at_s) / (now.at_s - before.at_s)))
        work = before.stored_J - now.stored_J
        for old, new, begin, end in zip(before.torques, now.torques, before.q, now.q, strict=True):
            work += (early * old + (1.0 - early) * new) * (end - begin)
        moved = tuple([end - begin for begin, end in zip(before.x, now.x, strict=True)])
        held = tuple([early * one + (1.0 - early) * two for one, two in zip(*self._commands, strict=True)])
        force, self.owed_J = paid(self.owed_J + work - inner(held, moved), held, moved, most_N)
        return force


class ServoHealth:
    """The faults and temperatures that servos report. limits_C : each servo's greatest temperature."""

    def __init__(self) -> None:
        self.limits_C: dict[int, int] = {}
        self.temperatures_C: dict[int, int] = {}
        self.faults: dict[int, str] = {}
        self._suspects: set[int] = set()
        self._hot = False

    def feel(self, servo: int, temperature_C: int) -> None:
        """Take a servo's temperature, and update whether a servo is too hot for a force."""
        self.temperatures_C[servo] = temperature_C
        left = min(self.limits_C[each] - degrees for each, degrees in self.temperatures_C.items())
        self._hot = left < (_COOL_K if self._hot else _HOT_K)

    def note(self, joint: JointServo, fault: str, why: Callable[[int, str], str]) -> None:
        """Take the fault in a servo's answer; empty: none. why : describes it with details, once it is certain."""
        doubted = joint.servo not in self._suspects  # a single report may be a damaged packet
        self._suspects = self._suspects - {joint.servo} | ({joint.servo} if fault else set())
        if not fault:
            self.faults.pop(joint.servo, None)
        elif doubted:
            return
        elif UNKNOWN in self.faults.get(joint.servo, UNKNOWN):
            self.faults[joint.servo] = f"servo {joint.servo} ({joint.name}) reports {why(joint.servo, fault)}"

    def braked(self) -> str:
        """The reason why the arm renders no force; empty: it renders force."""
        if self.faults:
            return "; ".join(self.faults.values())
        return "a servo is close to its temperature limit" if self._hot else ""
