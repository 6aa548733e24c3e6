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
    1020: ServoModel("XM430-W350", 4.1 / 2.3, 2.69e-3),
    1030: ServoModel("XM430-W210", 3.0 / 2.3, 2.69e-3),
    1060: ServoModel("XL430-W250", 0.0, 0.0),
    1070: ServoModel("XC430-W150", 0.0, 0.0),
    1120: ServoModel("XM540-W270", 10.6 / 4.4, 2.69e-3),
    1190: ServoModel("XL330-M077", 0.215 / 1.47, 1e-3),
    1200: ServoModel("XL330-M288", 0.52 / 1.47, 1e-3),
    1220: ServoModel("XC330-T288", 1.0 / 0.88, 1e-3),
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
        bits = 0 if reply is None else reply.data[0]
        named = [text for bit, text in ERRORS.items() if bits >> bit & 1]
        return f"{' and '.join(named) or fault}: switch its power off and on"

    def decoded(self, reply: Reply) -> Present:
        current, rate, count = BLOCK.unpack(reply.data)
        return Present(count, current, rate * RATE_RADPS, UNKNOWN if reply.error & 0x80 else "")

    def current(self, count: int) -> bytes:
        return count.to_bytes(2, "little", signed=True)
