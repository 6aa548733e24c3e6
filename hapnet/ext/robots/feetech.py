"""An arm of Feetech's servos. HLS has torque control; ST and STS (ST3215) have none, and lead without force.

Addresses and units are those of the maker's memory tables (STS, HLS) and its SDK (SMS_STS.h, HLSCL.h).
"""

from __future__ import annotations

from struct import Struct

from hapnet.errors import HapnetError
from hapnet.ext.robots.bus_arm import BusArm, ControlTable
from hapnet.ext.robots.bus_joints import JointServo
from hapnet.ext.robots.bus_motors import Present
from hapnet.ext.robots.bus_packets import FeetechPackets, Reply

MODEL, TEMPERATURE_LIMIT, PROTECTION_CURRENT, HOMING_OFFSET, MODE = 3, 13, 28, 31, 33
TORQUE_ENABLE, GOAL_TORQUE, PRESENT = 40, 44, 56
CURRENT_MODE = 2
CURRENT_A = 6.5e-3
BLOCK = Struct("<HHHBBBBBHH")
"""Present position, speed, load, voltage, temperature, flags, status, moving, goal, current."""

HLS = 10
"""The first byte of the series' model numbers."""
SIGN_BIT, STS_OFFSET_BIT = 15, 11
ERRORS = {0: "its input voltage", 1: "a fault of its encoder", 2: "overheating", 3: "too high a current", 5: "overload"}
"""Bits of the status byte."""


def signed(value: int, bit: int = SIGN_BIT) -> int:
    """Decode a number with this bit as its sign."""
    size = value & (1 << bit) - 1
    return -size if value >> bit & 1 else size


def unsigned(value: int, bit: int = SIGN_BIT) -> int:
    """Encode a number with this bit as its sign."""
    return -value | 1 << bit if value < 0 else value


class Feetech(BusArm):
    """``feetech:/dev/ttyACM0,arm=so101.urdf,tip=gripper_frame_link,calibration=leader.json``; options: `BusArm`."""

    about = "an arm of Feetech's servos: HLS by current; ST3215 and STS only lead, without force"
    emulator = "hapnet.ext.robots.bus_emulator:FeetechEmulator"
    packets = FeetechPackets
    usb = frozenset({(0x1A86, 0x55D3), (0x1A86, 0x7523)})
    control_table = ControlTable((PRESENT, BLOCK.size), GOAL_TORQUE, TORQUE_ENABLE, (TORQUE_ENABLE,))

    def set_up(self, joint: JointServo, torque_constant: float, current: float) -> tuple[float, int]:
        bus, servo = self.bus, joint.servo
        is_hls = bus.read(servo, MODEL, 1)[0] == HLS
        written = int.from_bytes(bus.read(servo, HOMING_OFFSET, 2), "little")
        offset = signed(written, SIGN_BIT if is_hls else STS_OFFSET_BIT)
        self.require_offset(joint, offset)
        bus.write(servo, TORQUE_ENABLE, b"\0")
        self.health.limits_C[servo] = bus.read(servo, TEMPERATURE_LIMIT, 1)[0]
        if not is_hls:
            return 0.0, 0
        if not torque_constant:
            raise HapnetError(
                f"servo {servo} ({joint.name}) is an HLS: torque_constant= [Nm/A] is needed, from its data sheet"
            )
        bus.write(servo, MODE, bytes((CURRENT_MODE,)))
        most = int.from_bytes(bus.read(servo, PROTECTION_CURRENT, 2), "little")
        if current:
            most = min(most, int(current / CURRENT_A))
        return torque_constant * CURRENT_A, most

    def decoded(self, reply: Reply) -> Present:
        count, _, _, _, temperature_C, _, status, _, _, current = BLOCK.unpack(reply.data)
        named = [text for bit, text in ERRORS.items() if status >> bit & 1]
        return Present(signed(count), signed(current), None, " and ".join(named), temperature_C)

    def current(self, count: int) -> bytes:
        return unsigned(count).to_bytes(2, "little")
