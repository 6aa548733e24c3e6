"""An arm of servos on a bus, the base of the drivers `Dynamixel` and `Feetech`. Its page is servo_bus.md.

The tip's position is computed from the joints' counts. A force F at the tip goes to the motors as J'F, added to the
torques that carry the arm's weight. If that exceeds a motor's current limit, the largest multiple of F within all
limits is rendered. Beyond a joint's stop its motor gives no torque outward.

`acted` is the force nearest to the command that does the motors' work, by the account in bus_motors.py.
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
from hapnet.ext.robots.bus_joints import COUNT_RAD, Jaw, JointServo, Posture, arm_table, joints_of
from hapnet.ext.robots.bus_motors import ArmReading, Motor, MotorWork, Present, ServoHealth
from hapnet.ext.robots.bus_packets import Packets, Reply
from hapnet.ext.robots.joint_torques import share
from hapnet.ext.robots.servo_bus import ServoBus, transfer_s
from hapnet.records.vectors import added
from hapnet.units import METRES, RADIANS

_LATENCY_S, _MARGIN, _SHARE = 1e-3, 1.1, 0.85
"""A tick takes its bytes' time times the margin, plus the latency; a reading may take this share of a period."""

_FASTEST_RADPS, _OVER = 50.0, 1.5
"""No supported servo is faster without load (XL330-M077: 48 rad/s), or measures more than this times its limit."""

_SILENT_S, _FIRST_S = 0.02, 0.1
"""The longest silence of a servo [s], in operation and while its torque is off."""

_GLANCE_TICKS = 8

_WIDEST = 0.5
"""Greatest opening of a jaw per radian [m/rad]."""


class ControlTable(NamedTuple):
    """Addresses in the servos' control tables.

    present : of the block that is read each tick, and its size. goal : of the commanded current, 2 bytes. enable : of
    the torque switch, 1 byte. glances : of single bytes that are read in turn, one every few ticks; the torque switch
    is among them.
    """

    present: tuple[int, int]
    goal: int
    enable: int
    glances: tuple[int, ...]


class BusArm(Driver):
    """An arm of servos on a bus.

    port : the bus's serial port. arm : its URDF, or ``omni`` (that of ``--device omni``). tip : a link of it.
    calibration : a file as in `bus_joints`. axes : those of the tip, as in `Axes`, or ``joints``. baud : bits a second.
    torque_constant : of all servos [Nm/A]; 0: as in hapnet's table. current : the greatest [A]; 0: the servo's limit.
    jaw : the last joint is a jaw that opens by so much per radian [m/rad], negative if it closes as its angle grows;
    with axes=joints its opening is the angle, and only the sign counts. 0: no jaw.

    More than twenty attributes: a device's declarations, the makers' tables, and the state of a bus.

    Raises InvalidParameter: a value is not allowed. MissingLibrary: pyserial is not installed. HapnetError: a servo
    does not answer, has a setting that differs from the calibration, or answers too late.
    """

    tested = "tested with an emulator"
    udev = 'SUBSYSTEM=="tty", KERNEL=="ttyACM*|ttyUSB*", TAG+="uaccess"'
    rate_hz: float = 250.0

    packets: ClassVar[type[Packets]]
    usb: ClassVar[frozenset[tuple[int, int]]]
    """Vendor and product IDs of the maker's USB adapters."""
    control_table: ClassVar[ControlTable]

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
        jaw: float = 0.0,
    ) -> None:
        if not port:
            raise InvalidParameter("port", port, "the bus's serial port, such as /dev/ttyUSB0")
        if self.missing():
            raise MissingLibrary("a servo bus", "pyserial", "serial")
        checks.non_negative("torque_constant", torque_constant)
        checks.non_negative("current", current)
        table, by_joints, self.jaw = arm_table(arm, tip), axes == "joints", jaw != 0.0
        if not abs(jaw) <= _WIDEST:
            raise InvalidParameter("jaw", jaw, f"the jaw's opening per radian [m/rad], -{_WIDEST:g} to {_WIDEST:g}")
        if by_joints and jaw:
            jaw = math.copysign(1.0, jaw)
        if by_joints and dof != len(table.free):
            raise InvalidParameter("dof", dof, f"{len(table.free)}, the joints of {table.name}")
        self.dof = dof
        self.units: str = RADIANS if by_joints else METRES
        joints = joints_of(table, calibration, in_servo=self.turns_in_servo())
        chosen = None if by_joints else Axes(axes, dof - self.jaw)
        self._posture = Posture(table, chosen, Jaw.of(joints[-1], jaw) if jaw else None)
        self._ids = [joint.servo for joint in joints]
        self.health = ServoHealth()
        self._powered: bool | None = None
        """Whether the motors are switched on; None: they render no force, before `begin` or without current control."""
        self._ticks = 0
        bytes_a_tick = tick_bytes(self.packets(), self.control_table.present[1], len(self._ids))
        period_s = _MARGIN * transfer_s(bytes_a_tick, checks.whole("baud", baud, at_least=1)) + _LATENCY_S
        self.rate_hz = min(type(self).rate_hz, 1.0 / period_s)
        self._budget_s = _SHARE / self.rate_hz
        self.bus = ServoBus(port, baud, self.packets())
        try:
            self._motors = [Motor(joint, *self.set_up(joint, torque_constant, current)) for joint in joints]
            self._require_in_time(period_s)
        except HapnetError:
            self.close()
            raise
        least = min(
            (
                max(0.0, motor.limit - abs(weight)) / far
                for motor, weight, lever in zip(self._motors, self._posture.weight, self._posture.levers, strict=True)
                if (far := math.hypot(*lever)) > 1e-9
            ),
            default=0.0,
        )
        if self.has_force and not least > 0.0:
            self.close()
            raise HapnetError(f"the motors of {table.name} cannot carry its weight at home")
        self.force_limit: float = least if self.has_force else NO_FORCE
        self._work = MotorWork(dof, least if self.has_force else None)
        self.resolution: float = COUNT_RAD if by_joints else COUNT_RAD * max(abs(jaw), added(table.reaches))
        self.workspace: float = 2.0 * (math.pi if by_joints else max(*table.reaches, math.pi * abs(jaw)))
        self.smallest_mass: float | None = 1.0  # without force this has no effect
        if self.has_force:
            self.smallest_mass = None if by_joints or jaw else apparent_masses(table)[0]
            self.watchdog_s = self.watched_s()

    @property
    def has_force(self) -> bool:
        """Whether all motors have current control."""
        return all(motor.has_torque for motor in self._motors)

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
        if (
            address == self.control_table.enable
            and not value
            and self._powered
            and joint.servo not in self.health.faults
        ):
            self.switch([joint.servo], on=True)  # the packet that switched it on was lost, or it had no power

    def switch(self, servos: Sequence[int], *, on: bool) -> None:
        """Switch motors on, without current, or off. Raises DeviceSilent."""
        if on:
            self.bus.sync_write(self.control_table.goal, dict.fromkeys(servos, self.current(0)))
        self.bus.sync_write(self.control_table.enable, dict.fromkeys(servos, bytes((on,))))

    def begin(self) -> None:
        if self.has_force:
            self._powered = True
            self.switch(self._ids, on=True)

    def read(self) -> tuple[Vector, Vector]:
        """Read all servos; the request to servos without an answer is repeated, within most of a period.

        Raises DeviceSilent: a servo did not answer, or the port is closed.
        """
        begun_s = time.monotonic()
        self.bus.port.reopen(self._budget_s)
        budget_s = max(_FIRST_S, self._budget_s) if self._powered is None else self._budget_s
        replies = self.bus.sync_read(*self.control_table.present, self._ids, budget_s)
        if len(replies) < len(self._ids):
            lost = next(motor.joint for motor in self._motors if motor.joint.servo not in replies)
            raise DeviceSilent(f"no complete answer of servo {lost.servo} ({lost.name}): check its power and cable")
        ended_s = time.monotonic()
        values = [self.decoded(replies[servo]) for servo in self._ids]
        self._require_possible(ended_s, values)
        for motor, value in zip(self._motors, values, strict=True):
            self.health.note(motor.joint, value.fault, self.why)
            if value.temperature_C is not None:
                self.health.feel(motor.joint.servo, value.temperature_C)
        at_s = 0.5 * (begun_s + ended_s)
        position, velocity = self._follow(at_s, values)
        self._ticks += 1
        if self._powered is not None and self._ticks % _GLANCE_TICKS == 0:
            self._glance(begun_s + self._budget_s - ended_s)
        return position, velocity

    def apply(self, force: Vector) -> Vector:
        """Send the motors' currents; returns the commanded force after the limits."""
        none = (0.0,) * self.dof
        if self._powered is None:
            return none
        now_s, work = time.monotonic(), self._work
        silent_s = math.inf if work.reading is None else now_s - work.reading.at_s
        if self.health.faults or silent_s > max(_SILENT_S, 2.0 / self.rate_hz):
            self._powered = False
            work.command(none)
            self.switch(self._ids, on=False)
            return none
        if not self._powered:
            self._powered = True
            self.switch(self._ids, on=True)
        posture, limits = self._posture, [motor.limit for motor in self._motors]
        command, loads = none, posture.weight
        for each in posture.parts(force):
            torques = posture.torques(each)
            part = share(torques, loads, limits)
            loads = tuple([load + part * torque for load, torque in zip(loads, torques, strict=True)])
            command = tuple([one + part * more for one, more in zip(command, each, strict=True)])
        counts = {
            motor.joint.servo: self.current(motor.command(load - weight, weight, angle))
            for motor, load, weight, angle in zip(self._motors, loads, posture.weight, posture.q, strict=True)
        }
        self.bus.sync_write(self.control_table.goal, counts)
        work.command(command, now_s + transfer_s(14 + 3 * len(counts), self.bus.baud))
        return command

    def acted(self) -> Vector | None:
        return self._work.acted

    def braked(self) -> str:
        return self.health.braked()

    def close(self) -> None:
        try:
            for _ in range(3):  # servos do not confirm it, and a packet may get lost
                self.switch(self._ids, on=False)
        except DeviceSilent:
            pass
        finally:
            self.bus.port.close()

    def _require_possible(self, now_s: float, found: list[Present]) -> None:
        """Raise DeviceSilent for impossible values: now and then a damaged packet passes its checksum."""
        if (last := self._work.reading) is None:
            return
        has_force, far = self.has_force, _FASTEST_RADPS * (now_s - last.at_s) + 2.0 * COUNT_RAD
        for motor, one, before in zip(self._motors, found, last.q, strict=True):
            joint, too_much = motor.joint, has_force and abs(one.current) > _OVER * motor.most
            if too_much or abs(joint.angle(one.counts) - before) > far:
                raise DeviceSilent(f"an impossible answer of servo {joint.servo} ({joint.name})")

    def _follow(self, at_s: float, found: list[Present]) -> tuple[Vector, Vector]:
        """Update the posture, its velocity, and the motors' mean force since the previous reading."""
        motors, posture = self._motors, self._posture
        q = tuple([motor.joint.angle(one.counts) for motor, one in zip(motors, found, strict=True)])
        rates = tuple([motor.rate(at_s, angle, one.rate) for motor, one, angle in zip(motors, found, q, strict=True)])
        posture.look(q)
        torques = tuple([motor.torque(one.current) for motor, one in zip(motors, found, strict=True)])
        now = ArmReading(at_s, q, posture.x, torques, posture.stored_J)
        self._work.take(now, counts=self._powered is not None)
        return posture.x, posture.velocity(rates)

    def why(self, servo: int, fault: str) -> str:
        """Describe the fault that a servo reports, with details if the servo has them."""
        return fault

    def _glance(self, left_s: float) -> None:
        """Read one byte of one servo, if there is time."""
        turn = self._ticks // _GLANCE_TICKS
        joint = self._motors[turn % len(self._motors)].joint
        address = self.control_table.glances[turn // len(self._motors) % len(self.control_table.glances)]
        reply = self.bus.glance(joint.servo, address, 1, left_s) if left_s > 0.0 else None
        if reply is not None:
            self.seen(joint, address, reply.data[0])

    def _require_in_time(self, period_s: float) -> None:
        """Raise HapnetError if even the fastest of ten readings is too slow."""
        took_s = math.inf
        for _ in range(10):
            begun_s = time.monotonic()
            if len(self.bus.sync_read(*self.control_table.present, self._ids, 0.2)) == len(self._ids):
                took_s = min(took_s, time.monotonic() - begun_s)
        if took_s > 2.0 * period_s:
            late = f"answer after {took_s * 1e3:.3g} ms instead of {period_s * 1e3:.2g}"
            raise HapnetError(f"the servos at {self.bus.port.path} {late}: {self.bus.port.remedy()}")


def tick_bytes(packets: Packets, size: int, servos: int) -> int:
    """Return a tick's bytes on the bus: a request, an answer of `size` bytes and a 2-byte current for each servo."""
    ids = range(1, servos + 1)
    asked = packets.sync_read(0, size, ids), packets.sync_write(0, dict.fromkeys(ids, b"\0\0"))
    return sum(map(len, asked)) + servos * (packets.status_bytes + size)
