"""An arm of Robotis' Dynamixel X-series servos, in current control: a haptic device, or a follower.

Addresses, units, watchdog and errors are those of the maker's e-manual (docs/en/dxl/x, docs/en/dxl/protocol2).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from struct import Struct
from typing import NamedTuple

from hapnet.errors import HapnetError
from hapnet.ext.robots.bus_arm import BusArm, ControlTable
from hapnet.ext.robots.bus_joints import JointServo
from hapnet.ext.robots.bus_motors import UNKNOWN, Present
from hapnet.ext.robots.bus_packets import Dynamixel2, Reply

MODEL, RETURN_DELAY, OPERATING_MODE, HOMING_OFFSET, TEMPERATURE_LIMIT, CURRENT_LIMIT = 0, 9, 11, 20, 31, 38
STATUS_RETURN_LEVEL = 68
"""0: a servo answers a ping only; 1: reading too; 2: every instruction."""
TORQUE_ENABLE, HARDWARE_ERROR, BUS_WATCHDOG, GOAL_CURRENT, PRESENT, TEMPERATURE = 64, 70, 98, 102, 126, 146
CURRENT_CONTROL = 0
WATCHDOG_S = 0.02
"""The unit of the bus watchdog."""
STOPPED = 255
"""The watchdog's value after it has stopped the servo."""
RATE_RADPS = 0.229 * 2.0 * math.pi / 60.0
BLOCK = Struct("<hii")
"""Present current, velocity and position."""

_WATCHED_PERIODS, _ASK_S = 2.5, 2e-3

ERRORS = {0: "its input voltage", 2: "overheating", 3: "a fault of its encoder", 4: "an electric shock", 5: "overload"}
"""Bits of the hardware error status."""


class ServoModel(NamedTuple):
    """A model of the X series. torque : stall torque over stall current at the recommended voltage [Nm/A]; 0: it has no
    current control. unit_A : unit of the current [A]."""

    name: str
    torque: float
    unit_A: float


MODELS = {
    1000: ServoModel("XH430-W350", 3.4 / 1.3, 2.69e-3),
    1001: ServoModel("XD430-T350", 3.4 / 1.3, 2.69e-3),
    1010: ServoModel("XH430-W210", 2.5 / 1.3, 2.69e-3),
    1011: ServoModel("XD430-T210", 2.5 / 1.3, 2.69e-3),
    1020: ServoModel("XM430-W350", 4.1 / 2.3, 2.69e-3),
    1030: ServoModel("XM430-W210", 3.0 / 2.3, 2.69e-3),
    1040: ServoModel("XH430-V350", 3.3 / 0.7, 1.34e-3),
    1050: ServoModel("XH430-V210", 2.6 / 0.7, 1.34e-3),
    1060: ServoModel("XL430-W250", 0.0, 0.0),
    1070: ServoModel("XC430-W150", 0.0, 0.0),
    1080: ServoModel("XC430-W240", 0.0, 0.0),
    1090: ServoModel("2XL430-W250", 0.0, 0.0),
    1100: ServoModel("XH540-W270", 9.9 / 4.9, 2.69e-3),
    1101: ServoModel("XD540-T270", 9.9 / 4.9, 2.69e-3),
    1110: ServoModel("XH540-W150", 7.1 / 4.9, 2.69e-3),
    1111: ServoModel("XD540-T150", 7.1 / 4.9, 2.69e-3),
    1120: ServoModel("XM540-W270", 10.6 / 4.4, 2.69e-3),
    1130: ServoModel("XM540-W150", 7.3 / 4.4, 2.69e-3),
    1140: ServoModel("XH540-V270", 9.2 / 2.4, 2.69e-3),
    1150: ServoModel("XH540-V150", 6.4 / 2.4, 2.69e-3),
    1160: ServoModel("2XC430-W250", 0.0, 0.0),
    1170: ServoModel("XW540-T260", 9.5 / 4.9, 2.69e-3),
    1180: ServoModel("XW540-T140", 6.9 / 4.9, 2.69e-3),
    1190: ServoModel("XL330-M077", 0.215 / 1.47, 1e-3),
    1200: ServoModel("XL330-M288", 0.52 / 1.47, 1e-3),
    1210: ServoModel("XC330-T181", 0.76 / 0.8, 1e-3),
    1220: ServoModel("XC330-T288", 0.92 / 0.8, 1e-3),
    1230: ServoModel("XC330-M181", 0.6 / 1.8, 1e-3),
    1240: ServoModel("XC330-M288", 0.93 / 1.8, 1e-3),
    1270: ServoModel("XW430-T333", 3.1 / 1.3, 2.69e-3),
}


class Dynamixel(BusArm):
    """``dynamixel:/dev/ttyUSB0,arm=arm.urdf,tip=hand,calibration=arm.json``; options: `BusArm`."""

    about = "an arm of Dynamixel X-series servos in current mode: force"
    emulator = "hapnet.ext.robots.bus_emulator:DynamixelEmulator"
    packets = Dynamixel2
    usb = frozenset({(0x0403, 0x6014), (0x2F5D, 0x2202)})
    control_table = ControlTable(
        (PRESENT, BLOCK.size), GOAL_CURRENT, TORQUE_ENABLE, (BUS_WATCHDOG, TORQUE_ENABLE, TEMPERATURE)
    )

    @property
    def watched_units(self) -> int:
        """The setting of the bus watchdog: two and a half periods, rounded up."""
        return max(1, math.ceil(_WATCHED_PERIODS / self.rate_hz / WATCHDOG_S))

    def watched_s(self) -> float | None:
        return self.watched_units * WATCHDOG_S

    @classmethod
    def turns_in_servo(cls) -> bool:
        return True

    def set_up(self, joint: JointServo, torque_constant: float, current: float) -> tuple[float, int]:
        bus, servo = self.bus, joint.servo
        number = int.from_bytes(bus.read(servo, MODEL, 2), "little")
        model = MODELS.get(number)
        if model is None:
            known = ", ".join(one.name for one in MODELS.values())
            raise HapnetError(f"servo {servo} ({joint.name}) is of model {number}, and this driver supports {known}")
        bus.sync_write(STATUS_RETURN_LEVEL, {servo: b"\2"})  # nothing answers this, at any level
        if bus.read(servo, HARDWARE_ERROR, 1)[0]:
            bus.reboot(servo)
            bus.sync_write(STATUS_RETURN_LEVEL, {servo: b"\2"})
            if bits := bus.read(servo, HARDWARE_ERROR, 1)[0]:
                raise HapnetError(
                    f"servo {servo} ({joint.name}) reports {_named(bits)}, and restarting it does not help"
                )
        offset = int.from_bytes(bus.read(servo, HOMING_OFFSET, 4), "little", signed=True)
        self.require_offset(joint, offset)
        bus.write(servo, TORQUE_ENABLE, b"\0")
        bus.write(servo, BUS_WATCHDOG, b"\0")
        bus.write(servo, RETURN_DELAY, b"\0")
        self.health.limits_C[servo] = bus.read(servo, TEMPERATURE_LIMIT, 1)[0]
        if not model.torque:
            return 0.0, 0
        bus.write(servo, OPERATING_MODE, bytes((CURRENT_CONTROL,)))
        most = int.from_bytes(bus.read(servo, CURRENT_LIMIT, 2), "little")
        if current:
            most = min(most, int(current / model.unit_A))
        return (torque_constant or model.torque) * model.unit_A, most

    def switch(self, servos: Sequence[int], *, on: bool) -> None:
        if not on:
            super().switch(servos, on=False)
            return
        self.bus.sync_write(BUS_WATCHDOG, dict.fromkeys(servos, b"\0"))  # after it has acted, the servo refuses a goal
        super().switch(servos, on=True)
        self.bus.sync_write(BUS_WATCHDOG, dict.fromkeys(servos, bytes((self.watched_units,))))

    def seen(self, joint: JointServo, address: int, value: int) -> None:
        if address == TEMPERATURE:
            self.health.feel(joint.servo, value)
        elif address == BUS_WATCHDOG and value != self.watched_units:
            super().seen(joint, TORQUE_ENABLE, 0)
        else:
            super().seen(joint, address, value)

    def why(self, servo: int, fault: str) -> str:
        reply = self.bus.glance(servo, HARDWARE_ERROR, 1, _ASK_S)
        return f"{_named(0 if reply is None else reply.data[0]) or fault}: the next run restarts it"

    def decoded(self, reply: Reply) -> Present:
        current, rate, count = BLOCK.unpack(reply.data)
        return Present(count, current, rate * RATE_RADPS, UNKNOWN if reply.error & 0x80 else "")

    def current(self, count: int) -> bytes:
        return count.to_bytes(2, "little", signed=True)


def _named(bits: int) -> str:
    """The errors of a hardware error status, in words."""
    return " and ".join(text for bit, text in ERRORS.items() if bits >> bit & 1)
