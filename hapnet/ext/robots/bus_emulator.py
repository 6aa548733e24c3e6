"""Emulators of servo buses on a pseudo-terminal: an arm whose joints a simulated hand holds, with faults on request.

Tables, errors and units are those of the makers' pages: Robotis' e-manual of the X series and of protocol 2.0, and
Feetech's memory tables of STS and HLS. Bytes take their time on the wire, statuses come in the order of the request
and after the return delay; a servo after a silent one does not answer, as we read the e-manual. Gears have no friction
here, rotors no inertia, and currents have no rise time; a servo in another mode than current control makes
no torque.
"""

from __future__ import annotations

import heapq
import random
import select
import threading
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import replace
from struct import Struct
from typing import Any, ClassVar

from hapnet.checks import one_of
from hapnet.errors import InvalidParameter
from hapnet.ext.arms.table import ArmTable
from hapnet.ext.devices.emulator import NANO, EmulatedHandle, Emulator
from hapnet.ext.devices.pseudo_terminal import PseudoTerminal
from hapnet.ext.robots import bus_packets as wire, dynamixel as x_series, feetech as st
from hapnet.ext.robots.bus_joints import COUNT_RAD, JointServo, arm_table, joints_of
from hapnet.ext.robots.servo_bus import transfer_s

_IDLE_S = 0.005
_OF_BULK = Struct("<BHH")
"""A servo, an address and a number of bytes, in a bulk read of Protocol 2.0."""

_ROOM = 256
_LIMIT_C, _WARM_C = 70, 35

ACCESS, DATA_RANGE, DATA_LIMIT, INSTRUCTION, ALERT = 0x07, 0x04, 0x06, 0x02, 0x80


class EmulatedServo:
    """A servo: its table, and the joint that it turns."""

    def __init__(self, joint: JointServo) -> None:
        self.joint = joint
        self.table = bytearray(_ROOM)
        self.heard_ns = 0
        self.broken = False

    def put(self, address: int, value: int, size: int) -> None:
        """Set a number in the table."""
        self.table[address : address + size] = (value % (1 << 8 * size)).to_bytes(size, "little")

    def get(self, address: int, size: int) -> int:
        """Return a number from the table."""
        return int.from_bytes(self.table[address : address + size], "little")


class BusEmulator(Emulator):
    """A bus and its servos.

    link : a path that points to the pseudo-terminal, whose own name changes. arm, tip, calibration : as for `BusArm`.
    model : of the servos; empty: the first. baud : bits a second. delay : the servos' return delay at first, in 2 us.
    noise : share of the bytes that get lost in each direction. corrupt : share of the statuses with a changed byte.
    silent, overload : the time after the first torque at which servo number `servo` (0: the first) stops answering, or
    is overloaded [s]; 0: never. seed : of the random numbers.
    """

    packets: ClassVar[type[wire.Packets]]
    models: ClassVar[Mapping[str, tuple[int, float]]]
    """By name: the number in the table, and the torque of a count of current [Nm]."""

    def __init__(
        self,
        handle: EmulatedHandle,
        clock: Callable[[], int],
        link: str = "",
        arm: str = "omni",
        tip: str = "",
        calibration: str = "",
        model: str = "",
        baud: int = 1_000_000,
        delay: int = 250,
        noise: float = 0.0,
        corrupt: float = 0.0,
        silent: float = 0.0,
        overload: float = 0.0,
        servo: int = 0,
        seed: int = 0,
    ) -> None:
        super().__init__(handle, clock)
        self._baud, self._corrupt = baud, corrupt
        self._silent_s, self._overload_s = silent, overload
        self._random = random.Random(seed)
        self._frames = self.packets()
        self.number, self.torque = self.models[one_of("model", model or next(iter(self.models)), tuple(self.models))]
        table = arm_table(arm, tip)
        joints = joints_of(table, calibration, in_servo=self.packets is wire.Dynamixel2)
        self._home = table.home
        self.servos = {joint.servo: EmulatedServo(joint) for joint in joints}
        self._failing = servo or joints[0].servo
        if self._failing not in self.servos:
            raise InvalidParameter("servo", servo, f"one of {', '.join(map(str, self.servos))}")
        for each in self.servos.values():
            self.make(each, delay)
        self._terminal = PseudoTerminal(link, noise, self._random)
        self.address: str = self._terminal.address
        self._due: list[tuple[int, int, Callable[[int], None]]] = []
        self._count = self._free_ns = 0
        self._first_ns: int | None = None

    @classmethod
    def arm(cls, options: Mapping[str, Any]) -> ArmTable:
        """The arm with unlimited efforts: its motors are limited by their currents instead."""
        table = arm_table(options.get("arm", "omni"), options.get("tip", ""))
        return replace(table, joints=tuple(replace(joint, effort=float("inf")) for joint in table.joints))

    @abstractmethod
    def make(self, servo: EmulatedServo, delay: int) -> None:
        """Fill a servo's table with the factory settings."""

    @abstractmethod
    def refresh(self, servo: EmulatedServo, angle: float, rate: float) -> None:
        """Put the measured values into a servo's table."""

    @abstractmethod
    def delay_ns(self, servo: EmulatedServo) -> int:
        """The delay between a request and its status [ns]."""

    @abstractmethod
    def accept(self, servo: EmulatedServo, address: int, data: bytes) -> int:
        """Write into a servo's table; returns the error of a refusal, or 0."""

    @abstractmethod
    def drive(self, servo: EmulatedServo) -> int:
        """The current that a servo makes now, in counts."""

    @abstractmethod
    def watch(self, servo: EmulatedServo, now_ns: int) -> bool:
        """Update a servo's watchdog; returns whether it has just ended the torque."""

    @abstractmethod
    def fail(self, servo: EmulatedServo) -> None:
        """Overload a servo."""

    def error(self, servo: EmulatedServo) -> int:
        """The error in each status of a servo."""
        return 0

    def answers(self, servo: EmulatedServo, code: int) -> bool:
        """Whether the servo answers an instruction of this code."""
        return not servo.broken

    def run(self, stop: threading.Event) -> None:
        device = self._terminal.device
        while not stop.is_set():
            now_ns = self._clock()
            while self._due and self._due[0][0] <= now_ns:
                at_ns, _, call = heapq.heappop(self._due)
                call(at_ns)
            left_s = (self._due[0][0] - now_ns) * NANO if self._due else _IDLE_S
            if select.select([device], [], [], min(max(0.0, left_s), _IDLE_S))[0]:
                for packet in self._frames.feed(self._terminal.read()):
                    self._handle_packet(packet)
            self._age(self._clock())
        self._terminal.close()

    def _age(self, now_ns: int) -> None:
        """Apply faults that are due, and update the watchdogs."""
        since_s = 0.0 if self._first_ns is None else (now_ns - self._first_ns) * NANO
        failing = self.servos[self._failing]
        if self._overload_s and since_s >= self._overload_s:
            self._overload_s = 0.0
            self.fail(failing)
            self._hold(now_ns)
        if self._silent_s and since_s >= self._silent_s:
            failing.broken = True
        acted = [servo for servo in self.servos.values() if self.watch(servo, now_ns)]
        if acted:
            self.handle.released += 1
            self._hold(now_ns)

    def _at(self, at_ns: int, call: Callable[[int], None]) -> None:
        self._count += 1
        heapq.heappush(self._due, (at_ns, self._count, call))

    def _carry(self, size: int, after_ns: int) -> tuple[int, int]:
        """Return a packet's begin and end on the wire, which carries one packet at a time [ns]. size : its bytes."""
        begin = max(after_ns, self._free_ns)
        self._free_ns = begin + round(transfer_s(size, self._baud) / NANO)
        return begin, self._free_ns

    def _handle_packet(self, packet: wire.BusPacket) -> None:
        """Handle an instruction, which begins on the wire now."""
        size = len(self._frames.packet(*packet))
        _, end_ns = self._carry(size, self._clock())
        place = self._frames.place
        half = place.size // 2
        if packet.code == wire.SYNC_READ:
            address, count = place.unpack_from(packet.data)
            for number in packet.data[place.size :]:
                servo = self.servos.get(number)
                if servo is None or servo.broken:
                    break
                self._answer(servo, end_ns, address, count)
        elif packet.code == wire.BULK_READ:
            for number, address, count in _OF_BULK.iter_unpack(packet.data):
                servo = self.servos.get(number)
                if servo is None or servo.broken:
                    break
                self._answer(servo, end_ns, address, count)
        elif packet.code == wire.PING and packet.servo == wire.ALL:
            for number in sorted(self.servos):
                self._ping(self.servos[number], end_ns)
        elif packet.code == wire.SYNC_WRITE:
            address, count = place.unpack_from(packet.data)
            each = packet.data[place.size :]
            parts = {each[k]: each[k + 1 : k + 1 + count] for k in range(0, len(each), count + 1)}
            self._at(end_ns, lambda at_ns: self._write_all(parts, address, at_ns))
        elif (one := self.servos.get(packet.servo)) is not None and not one.broken:
            if packet.code == wire.READ:
                address, count = place.unpack_from(packet.data)
                self._answer(one, end_ns, address, count)
            elif packet.code == wire.WRITE:
                address = int.from_bytes(packet.data[:half], "little")
                self._at(end_ns, lambda at_ns: self._write(one, address, packet.data[half:], at_ns))
            elif packet.code == wire.PING:
                self._ping(one, end_ns)
            else:
                if packet.code == wire.REBOOT:
                    self.make(one, one.table[x_series.RETURN_DELAY])
                error = 0 if packet.code == wire.REBOOT else INSTRUCTION
                self._at(end_ns, lambda at_ns: self._confirm(one, packet.code, error, at_ns))
        for servo in self.servos.values():
            servo.heard_ns = end_ns

    def about(self, servo: EmulatedServo) -> bytes:
        """The answer to a ping."""
        return b""

    def _ping(self, servo: EmulatedServo, end_ns: int) -> None:
        self._at(end_ns, lambda at_ns: self._confirm(servo, wire.PING, 0, at_ns, self.about(servo)))

    def _answer(self, servo: EmulatedServo, after_ns: int, address: int, count: int) -> None:
        """Schedule a status with a part of the table, sampled when the status begins."""
        if not self.answers(servo, wire.READ):
            return
        begin_ns, end_ns = self._carry(self._frames.status_bytes + count, after_ns + self.delay_ns(servo))

        def sample(at_ns: int) -> None:
            angles, rates = self.handle.read(at_ns)
            k = list(self.servos).index(servo.joint.servo)
            self.refresh(servo, angles[k] + self._home[k], rates[k])
            found = wire.Reply(self.error(servo), bytes(servo.table[address : address + count]))
            self._at(end_ns, lambda _: self._send(servo, found))

        self._at(begin_ns, sample)

    def _confirm(self, servo: EmulatedServo, code: int, error: int, at_ns: int, data: bytes = b"") -> None:
        """Answer an instruction of this code, if the servo does."""
        if not self.answers(servo, code):
            return
        reply = wire.Reply(self.error(servo) | error, data)
        _, end_ns = self._carry(self._frames.status_bytes + len(data), at_ns + self.delay_ns(servo))
        self._at(end_ns, lambda _: self._send(servo, reply))

    def _send(self, servo: EmulatedServo, reply: wire.Reply) -> None:
        data = self._frames.status(servo.joint.servo, reply)
        if self._corrupt and self._random.random() < self._corrupt:
            at = self._random.randrange(len(data))
            data = data[:at] + bytes((data[at] ^ 0x10,)) + data[at + 1 :]
        self._terminal.write(data)

    def _write_all(self, parts: dict[int, bytes], address: int, at_ns: int) -> None:
        for number, data in parts.items():
            if (servo := self.servos.get(number)) is not None and not servo.broken:
                self.accept(servo, address, data)
        self._hold(at_ns)

    def _write(self, servo: EmulatedServo, address: int, data: bytes, at_ns: int) -> None:
        self._confirm(servo, wire.WRITE, self.accept(servo, address, data), at_ns)
        self._hold(at_ns)

    def _hold(self, at_ns: int) -> None:
        """Apply the motors' torques from now on."""
        servos = self.servos.values()
        torques = tuple([servo.joint.sign * self.torque * self.drive(servo) for servo in servos])
        self.handle.hold(at_ns, torques)
        if self._first_ns is None and any(torques):
            self._first_ns = at_ns


class DynamixelEmulator(BusEmulator):
    """X-series servos, XL330-M288 if no other model is named: 0.35 Nm/A, 1 mA a count."""

    packets = wire.Dynamixel2
    models: ClassVar[Mapping[str, tuple[int, float]]] = {
        model.name: (number, model.torque * model.unit_A)
        for number, model in sorted(x_series.MODELS.items(), key=lambda item: item[0] != 1200)
    }

    def make(self, servo: EmulatedServo, delay: int) -> None:
        servo.table[:] = bytes(_ROOM)
        for address, value, size in (
            (0, self.number, 2), (6, 46, 1), (7, servo.joint.servo, 1), (9, delay, 1), (11, 3, 1),
            (20, servo.joint.offset or 0, 4), (31, _LIMIT_C, 1), (38, 1750, 2), (48, 4095, 4), (63, 53, 1), (68, 2, 1),
            (146, _WARM_C, 1),
        ):  # fmt: skip
            servo.put(address, value, size)

    def about(self, servo: EmulatedServo) -> bytes:
        return bytes(servo.table[0:2] + servo.table[6:7])

    def error(self, servo: EmulatedServo) -> int:
        return ALERT if servo.table[x_series.HARDWARE_ERROR] else 0

    def answers(self, servo: EmulatedServo, code: int) -> bool:
        least = {wire.PING: 0, wire.READ: 1}.get(code, 2)
        return not servo.broken and servo.table[x_series.STATUS_RETURN_LEVEL] >= least

    def delay_ns(self, servo: EmulatedServo) -> int:
        return servo.table[x_series.RETURN_DELAY] * 2000

    def refresh(self, servo: EmulatedServo, angle: float, rate: float) -> None:
        present = x_series.BLOCK.pack(
            self.drive(servo), round(servo.joint.sign * rate / x_series.RATE_RADPS), servo.joint.count(angle)
        )
        servo.table[x_series.PRESENT : x_series.PRESENT + len(present)] = present

    def accept(self, servo: EmulatedServo, address: int, data: bytes) -> int:
        table = servo.table
        if (address < 64 and table[x_series.TORQUE_ENABLE]) or address >= 120 or address + len(data) > _ROOM:
            return ACCESS
        if address == x_series.TORQUE_ENABLE and data[0] and table[x_series.HARDWARE_ERROR]:
            return ACCESS
        if address == x_series.GOAL_CURRENT:
            if table[x_series.BUS_WATCHDOG] == x_series.STOPPED:
                return DATA_RANGE
            if abs(int.from_bytes(data, "little", signed=True)) > servo.get(x_series.CURRENT_LIMIT, 2):
                return DATA_LIMIT
        table[address : address + len(data)] = data
        return 0

    def drive(self, servo: EmulatedServo) -> int:
        table = servo.table
        is_on = table[x_series.TORQUE_ENABLE] and table[x_series.OPERATING_MODE] == x_series.CURRENT_CONTROL
        if not is_on or table[x_series.BUS_WATCHDOG] == x_series.STOPPED:
            return 0
        goal = servo.get(x_series.GOAL_CURRENT, 2)
        return goal - (1 << 16) if goal >> 15 else goal

    def watch(self, servo: EmulatedServo, now_ns: int) -> bool:
        units = servo.table[x_series.BUS_WATCHDOG]
        if not 0 < units < 128 or not servo.table[x_series.TORQUE_ENABLE]:
            return False
        if (now_ns - servo.heard_ns) * NANO <= units * x_series.WATCHDOG_S:
            return False
        servo.table[x_series.BUS_WATCHDOG] = x_series.STOPPED
        return True

    def fail(self, servo: EmulatedServo) -> None:
        servo.table[x_series.HARDWARE_ERROR] |= 1 << 5
        servo.table[x_series.TORQUE_ENABLE] = 0


class FeetechEmulator(BusEmulator):
    """Servos ST3215, or HLS with 1 Nm/A."""

    packets = wire.FeetechPackets
    models: ClassVar[Mapping[str, tuple[int, float]]] = {"ST3215": (777, 0.0), "HLS": (st.HLS, st.CURRENT_A)}

    def make(self, servo: EmulatedServo, delay: int) -> None:
        servo.table[:] = bytes(_ROOM)
        offset = st.unsigned(servo.joint.offset or 0, st.SIGN_BIT if self.torque else st.STS_OFFSET_BIT)
        for address, value, size in (
            (3, self.number, 2), (5, servo.joint.servo, 1), (7, 0 if self.torque else delay, 1), (8, 1, 1),
            (11, 4095, 2), (13, _LIMIT_C, 1), (28, 300, 2), (30, 1, 1), (31, offset, 2), (55, 1, 1), (63, _WARM_C, 1),
        ):  # fmt: skip
            servo.put(address, value, size)

    def error(self, servo: EmulatedServo) -> int:
        return servo.table[65]

    def delay_ns(self, servo: EmulatedServo) -> int:
        return 0 if self.torque else servo.table[7] * 2000

    def refresh(self, servo: EmulatedServo, angle: float, rate: float) -> None:
        servo.put(st.PRESENT, st.unsigned(servo.joint.count(angle)), 2)
        servo.put(58, st.unsigned(round(servo.joint.sign * rate / COUNT_RAD)), 2)
        servo.put(69, st.unsigned(self.drive(servo)), 2)

    def accept(self, servo: EmulatedServo, address: int, data: bytes) -> int:
        servo.table[address : address + len(data)] = data
        return 0

    def drive(self, servo: EmulatedServo) -> int:
        table = servo.table
        if not self.torque or table[st.TORQUE_ENABLE] != 1 or table[st.MODE] != st.CURRENT_MODE:
            return 0
        return st.signed(servo.get(st.GOAL_TORQUE, 2))

    def watch(self, servo: EmulatedServo, now_ns: int) -> bool:
        return False  # it has no watchdog

    def fail(self, servo: EmulatedServo) -> None:
        servo.table[65] |= 1 << 5
        servo.table[st.TORQUE_ENABLE] = 0
