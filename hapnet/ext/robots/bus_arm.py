"""An arm of servos on a bus, the base of the drivers `Dynamixel` and `Feetech`. Its page is servo_bus.md.

The tip's position is computed from the joints' counts. A force F at the tip goes to the motors as J'F, added to the
torques that carry the arm's weight. If that exceeds a motor's current limit, the largest multiple of F within all
limits is rendered. Beyond a joint's stop its motor gives no torque outward.

The account counts the motors' work from the measured currents: between two readings the torques times the joints' turn,
less the change of the weight's potential. `acted` is the force nearest to the command that does this work. A current is
sampled with its position; a new command acts from the end of its packet, the previous one until then.
"""

from __future__ import annotations

import math
import time
from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

from hapnet import checks
from hapnet.checks import Vector
from hapnet.devices.driver import NO_FORCE, Axes, Driver
from hapnet.errors import DeviceSilent, HapnetError, InvalidParameter, MissingLibrary
from hapnet.ext.arms.table import apparent_masses
from hapnet.ext.devices import serial_port
from hapnet.ext.devices.timed_velocity import TimedVelocity
from hapnet.ext.robots.bus_joints import COUNT_RAD, JointServo, Posture, arm_table, joints_of
from hapnet.ext.robots.bus_packets import Packets, Reply
from hapnet.ext.robots.joint_torques import paid, share
from hapnet.ext.robots.servo_bus import ServoBus, transfer_s
from hapnet.records.vectors import added, inner
from hapnet.units import METRES, RADIANS

_LATENCY_S, _MARGIN, _SHARE = 1e-3, 1.1, 0.85
"""A tick takes its bytes' time times the margin, plus the latency; a reading may take this share of a period."""

UNKNOWN = "a fault"
"""The fault of a servo before its driver has read the details."""

_FASTEST_RADPS, _OVER = 50.0, 1.5
"""No supported servo is faster without load (XL330-M077: 48 rad/s), or measures more than this times its limit."""

_SILENT_S, _FIRST_S = 0.02, 0.1
"""The longest silence of a servo [s], in operation and while its torque is off."""

_GLANCE_TICKS = 8
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


class _Reading(NamedTuple):
    at_s: float
    q: Vector
    x: Vector
    torques: Vector
    stored_J: float


class BusArm(Driver):
    """An arm of servos on a bus.

    More than twenty attributes: a driver's declarations, the servos' limits, and the values to check a reading.

    port : the bus's serial port. arm : its URDF, or ``omni`` (that of ``--device omni``). tip : a link of it.
    calibration : a file as in `bus_joints`. axes : those of the tip, as in `Axes`, or ``joints``. baud : bits a second.
    torque_constant : of all servos [Nm/A]; 0: as in hapnet's table. current : the greatest [A]; 0: the servo's limit.

    Raises InvalidParameter: a value is not allowed. MissingLibrary: pyserial is not installed. HapnetError: a servo
    does not answer, has a setting that differs from the calibration, or answers too late.
    """

    tested = "tested with an emulator"
    udev = 'SUBSYSTEM=="tty", KERNEL=="ttyACM*|ttyUSB*", TAG+="uaccess"'
    rate_hz: float = 250.0

    packets: ClassVar[type[Packets]]
    usb: ClassVar[frozenset[tuple[int, int]]]
    """Vendor and product IDs of the maker's USB adapters."""
    present: ClassVar[tuple[int, int]]
    """Address and size of the block that is read each tick."""
    goal: ClassVar[int]
    """Address of the commanded current, 2 bytes."""
    enable: ClassVar[int]
    """Address of the torque switch, 1 byte."""
    glances: ClassVar[tuple[int, ...]]
    """Addresses of single bytes that are read in turn, one every few ticks; the torque switch is among them."""

    def __init__(
        self,
        dof: int,
        port: str = "",
        arm: str = "omni",
        tip: str = "",
        calibration: str = "",
        axes: str = "",
        baud: int = 1_000_000,
        torque_constant: float = 0.0,
        current: float = 0.0,
    ) -> None:
        if not port:
            raise InvalidParameter("port", port, "the bus's serial port, such as /dev/ttyUSB0")
        if self.missing():
            raise MissingLibrary("a servo bus", "pyserial", "serial")
        checks.non_negative("torque_constant", torque_constant)
        checks.non_negative("current", current)
        table, by_joints = arm_table(arm, tip), axes == "joints"
        if by_joints and dof != len(table.joints):
            raise InvalidParameter("dof", dof, f"{len(table.joints)}, the joints of {table.name}")
        self.dof = dof
        self.units: str = RADIANS if by_joints else METRES
        self._axes = None if by_joints else Axes(axes, dof)
        self._joints = joints_of(table, calibration, in_servo=self.turns_in_servo())
        self._ids = [joint.servo for joint in self._joints]
        self._posture = Posture(table, by_joints)
        self._velocities = [TimedVelocity(COUNT_RAD, COUNT_RAD) for _ in self._joints]
        self.temperatures_C: dict[int, int] = {}
        self.limits_C: dict[int, int] = {}
        self._faults: dict[int, str] = {}
        self._suspects: set[int] = set()
        self._hot = self._on = self._off = False
        self._now: _Reading | None = None
        self._acted: Vector | None = None
        self._commands = ((0.0,) * dof, (0.0,) * dof)  # the previous command, and the newest
        self._sent_s = self._owed_J = 0.0
        self._ticks = 0
        bytes_a_tick = tick_bytes(self.packets(), self.present[1], len(self._ids))
        period_s = _MARGIN * transfer_s(bytes_a_tick, checks.whole("baud", baud, at_least=1)) + _LATENCY_S
        self.rate_hz = min(type(self).rate_hz, 1.0 / period_s)
        self._budget_s = _SHARE / self.rate_hz
        self.bus = ServoBus(port, baud, self.packets())
        try:
            found = [self.set_up(joint, torque_constant, current) for joint in self._joints]
            self._require_in_time(period_s)
        except HapnetError:
            self.close()
            raise
        self.has_force: bool = all(per_count > 0.0 for per_count, _ in found)
        self._per_count = [joint.sign * one for joint, (one, _) in zip(self._joints, found, strict=True)]
        self._most = [most for _, most in found]
        levers = [1.0] * len(found) if by_joints else [math.hypot(*lever) for lever in self._posture.levers]
        room = [
            max(0.0, abs(per) * most - abs(weight))
            for per, most, weight in zip(self._per_count, self._most, self._posture.weight, strict=True)
        ]
        least = min((free / lever for free, lever in zip(room, levers, strict=True) if lever > 1e-9), default=0.0)
        if self.has_force and not least > 0.0:
            self.close()
            raise HapnetError(f"the motors of {table.name} cannot carry its weight at home")
        self.force_limit: float = least if self.has_force else NO_FORCE
        self.resolution: float = COUNT_RAD if by_joints else COUNT_RAD * added(table.reaches)
        self.workspace: float = 2.0 * math.pi if by_joints else 2.0 * max(table.reaches)
        self.smallest_mass: float | None = 1.0  # without force this has no effect
        if self.has_force:
            self.smallest_mass = None if by_joints else apparent_masses(table)[0]
            self.watchdog_s = self.watched_s()

    @classmethod
    def missing(cls) -> str:
        return serial_port.missing()

    @classmethod
    def found(cls) -> Sequence[str]:
        return serial_port.ports(lambda port: (port.vid, port.pid) in cls.usb)

    @classmethod
    def turns_in_servo(cls) -> bool:
        """Whether a servo itself reverses its counts."""
        return False

    @abstractmethod
    def set_up(self, joint: JointServo, torque_constant: float, current: float) -> tuple[float, int]:
        """Set up a servo with its torque off; returns its torque per count of current [Nm], 0 without current control,
        and the largest count. Raises HapnetError."""

    @abstractmethod
    def decoded(self, reply: Reply) -> Present:
        """Decode the block that is read each tick."""

    @abstractmethod
    def current(self, count: int) -> bytes:
        """The bytes of a commanded current."""

    def require_offset(self, joint: JointServo, offset: int) -> None:
        """Raise HapnetError if a servo's own offset is not the calibration's."""
        if joint.offset not in (None, offset):
            written = f"is {offset}, and that in the calibration file {joint.offset}: write the calibration to it first"
            raise HapnetError(f"the homing offset of servo {joint.servo} ({joint.name}) {written}")

    def watched_s(self) -> float | None:
        """The silence on the bus after which a servo switches its torque off [s]; None: it never does."""
        return None

    def seen(self, joint: JointServo, address: int, value: int) -> None:
        """Handle a byte of `glances`."""
        if address == self.enable and not value and self._on and not self._off and joint.servo not in self._faults:
            self.switch([joint.servo], on=True)  # the packet that switched it on was lost, or it had no power

    def switch(self, servos: Sequence[int], *, on: bool) -> None:
        """Switch motors on, without current, or off. Raises DeviceSilent."""
        if on:
            self.bus.sync_write(self.goal, dict.fromkeys(servos, self.current(0)))
        self.bus.sync_write(self.enable, dict.fromkeys(servos, bytes((on,))))

    def begin(self) -> None:
        self._on = self.has_force
        if self._on:
            self.switch(self._ids, on=True)

    def read(self) -> tuple[Vector, Vector]:
        """Read all servos; the request to servos without an answer is repeated, within most of a period.

        Raises DeviceSilent: a servo did not answer, or the port is closed.
        """
        begun_s = time.monotonic()
        self.bus.port.reopen(self._budget_s)
        budget_s = self._budget_s if self._on else max(_FIRST_S, self._budget_s)
        replies = self.bus.sync_read(*self.present, self._ids, budget_s)
        if len(replies) < len(self._ids):
            lost = next(joint for joint in self._joints if joint.servo not in replies)
            raise DeviceSilent(f"no complete answer of servo {lost.servo} ({lost.name})")
        ended_s = time.monotonic()
        values = [self.decoded(replies[servo]) for servo in self._ids]
        self._require_possible(ended_s, values)
        for joint, value in zip(self._joints, values, strict=True):
            self._note(joint, value.fault)
            if value.temperature_C is not None:
                self.feel(joint.servo, value.temperature_C)
        at_s = 0.5 * (begun_s + ended_s)
        position, velocity = self._follow(at_s, values)
        self._ticks += 1
        if self._on and self._ticks % _GLANCE_TICKS == 0:
            self._glance(begun_s + self._budget_s - ended_s)
        return position, velocity

    def apply(self, force: Vector) -> Vector:
        """Send the motors' currents; returns the commanded force after the limits."""
        none = (0.0,) * self.dof
        if not self._on:
            return none
        now_s = time.monotonic()
        if self._now is None or self._faults or now_s - self._now.at_s > max(_SILENT_S, 2.0 / self.rate_hz):
            self._off, self._commands = True, (self._commands[1], none)
            self.switch(self._ids, on=False)
            return none
        if self._off:
            self._off = False
            self.switch(self._ids, on=True)
        weight, torques = self._posture.weight, self._posture.torques(self._spread(force))
        limits = [abs(per) * most for per, most in zip(self._per_count, self._most, strict=True)]
        part = share(torques, weight, limits)
        counts = {}
        for k, joint in enumerate(self._joints):
            torque, q, most = part * torques[k], self._posture.q[k], self._most[k]
            if (q >= joint.upper and torque > 0.0) or (q <= joint.lower and torque < 0.0):
                torque = 0.0
            count = round((torque + weight[k]) / self._per_count[k])
            counts[joint.servo] = self.current(max(-most, min(most, count)))
        self.bus.sync_write(self.goal, counts)
        self._sent_s = now_s + transfer_s(14 + 3 * len(counts), self.bus.baud)
        command = force if part == 1.0 else tuple([part * one for one in force])
        self._commands = (self._commands[1], command)
        return command

    def acted(self) -> Vector | None:
        return self._acted

    def braked(self) -> str:
        if self._faults:
            return "; ".join(self._faults.values())
        return "a servo is close to its temperature limit" if self._hot else ""

    def close(self) -> None:
        try:
            for _ in range(3):  # servos do not confirm it, and a packet may get lost
                self.switch(self._ids, on=False)
        except DeviceSilent:
            pass
        finally:
            self.bus.port.close()

    def _spread(self, force: Vector) -> Vector:
        return force if self._axes is None else self._axes.spread(force)

    def _take(self, axes: Vector) -> Vector:
        return axes if self._axes is None else self._axes.take(axes)

    def _require_possible(self, now_s: float, found: list[Present]) -> None:
        """Raise DeviceSilent for impossible values: now and then a damaged packet passes its checksum."""
        if self._now is None:
            return
        far = _FASTEST_RADPS * (now_s - self._now.at_s) + 2.0 * COUNT_RAD
        for joint, one, before, most in zip(self._joints, found, self._now.q, self._most, strict=True):
            if abs(joint.angle(one.counts) - before) > far or (self.has_force and abs(one.current) > _OVER * most):
                raise DeviceSilent(f"an impossible answer of servo {joint.servo} ({joint.name})")

    def _follow(self, at_s: float, found: list[Present]) -> tuple[Vector, Vector]:
        """Update the posture, its velocity, and the motors' mean force since the previous reading."""
        q = tuple([joint.angle(one.counts) for joint, one in zip(self._joints, found, strict=True)])
        rates = tuple([
            slope.update(at_s, at_s, angle) if one.rate is None else joint.sign * one.rate
            for joint, one, slope, angle in zip(self._joints, found, self._velocities, q, strict=True)
        ])  # fmt: skip
        self._posture.look(q)
        torques = tuple([per * one.current for per, one in zip(self._per_count, found, strict=True)])
        before = self._now
        x = self._take(self._posture.x)
        self._now = now = _Reading(at_s, q, x, torques, self._posture.stored_J)
        if self.has_force:
            self._acted = (0.0,) * self.dof if before is None or not self._on else self._mean_force(before, now)
        return x, self._take(self._posture.velocity(rates))

    def _mean_force(self, before: _Reading, now: _Reading) -> Vector:
        """The force that does the work of the measured currents."""
        early = min(1.0, max(0.0, (self._sent_s - before.at_s) / (now.at_s - before.at_s)))
        work = before.stored_J - now.stored_J
        for old, new, begin, end in zip(before.torques, now.torques, before.q, now.q, strict=True):
            work += (early * old + (1.0 - early) * new) * (end - begin)
        moved = tuple([end - begin for begin, end in zip(before.x, now.x, strict=True)])
        held = tuple([early * one + (1.0 - early) * two for one, two in zip(*self._commands, strict=True)])
        owed_J = self._owed_J + work - inner(held, moved)
        force, self._owed_J = paid(owed_J, held, moved, _CORRECTION * self.force_limit)
        return force

    def feel(self, servo: int, temperature_C: int) -> None:
        """Take a servo's temperature, and update whether a servo is too hot for a force."""
        self.temperatures_C[servo] = temperature_C
        left = min(self.limits_C[each] - degrees for each, degrees in self.temperatures_C.items())
        self._hot = left < (_COOL_K if self._hot else _HOT_K)

    def why(self, servo: int, fault: str) -> str:
        """Describe the fault that a servo reports, with details if the servo has them."""
        return fault

    def _note(self, joint: JointServo, fault: str) -> None:
        doubted = joint.servo not in self._suspects  # a single report may be a damaged packet
        self._suspects = self._suspects - {joint.servo} | ({joint.servo} if fault else set())
        if not fault:
            self._faults.pop(joint.servo, None)
        elif doubted:
            return
        elif UNKNOWN in self._faults.get(joint.servo, UNKNOWN):
            self._faults[joint.servo] = f"servo {joint.servo} ({joint.name}) reports {self.why(joint.servo, fault)}"

    def _glance(self, left_s: float) -> None:
        """Read one byte of one servo, if there is time."""
        turn = self._ticks // _GLANCE_TICKS
        joint = self._joints[turn % len(self._joints)]
        address = self.glances[turn // len(self._joints) % len(self.glances)]
        reply = self.bus.glance(joint.servo, address, 1, left_s) if left_s > 0.0 else None
        if reply is not None:
            self.seen(joint, address, reply.data[0])

    def _require_in_time(self, period_s: float) -> None:
        """Raise HapnetError if even the fastest of ten readings is too slow."""
        took_s = math.inf
        for _ in range(10):
            begun_s = time.monotonic()
            if len(self.bus.sync_read(*self.present, self._ids, 0.2)) == len(self._ids):
                took_s = min(took_s, time.monotonic() - begun_s)
        if took_s > 2.0 * period_s:
            late = f"answer after {took_s * 1e3:.3g} ms instead of {period_s * 1e3:.2g}"
            raise HapnetError(f"the servos at {self.bus.port.path} {late}: {self.bus.port.remedy()}")


def tick_bytes(packets: Packets, size: int, servos: int) -> int:
    """Return a tick's bytes on the bus: a request, an answer of `size` bytes and a 2-byte current for each servo."""
    ids = range(1, servos + 1)
    asked = packets.sync_read(0, size, ids), packets.sync_write(0, dict.fromkeys(ids, b"\0\0"))
    return sum(map(len, asked)) + servos * (packets.status_bytes + size)
