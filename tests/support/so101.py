"""SO-101 arms of STS3215 servos on an emulated bus, for LeRobot's own classes: `python -m tests.support.so101 ...`.

Addresses are those of Feetech's memory table of the STS series. A joint has no inertia: torque and friction balance,
and a leader's joints are held by a hand of `HAND` Nm/rad that moves them. The servo's loop is a spring to the goal
that its torque limit saturates. Both numbers are ours: no datasheet has them.
"""

from __future__ import annotations

import json
import math
import os
import random
import select
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from hapnet.ext.devices.pseudo_terminal import PseudoTerminal
from hapnet.ext.robots import bus_packets as wire

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
COUNT_RAD = 2.0 * math.pi / 4096
MIDDLE, RANGE, GRIPPER_RANGE = 2048, (900, 3196), (2048, 3186)
"""Counts: of 0 degrees, and the ends of the joints' ranges. So a unit of the gripper, 0 to 100, is a degree too."""

STALL_NM, CONSTANT_NM_A, CURRENT_A = 2.94, 1.09, 6.5e-3
LOOP_NM_RAD = STALL_NM / math.radians(5.0)
FRICTION = {"follower": 1.0, "leader": 0.05}  # Nms/rad
HAND = 3.0
GEARS = {"shoulder_pan": 191, "elbow_flex": 191, "wrist_flex": 147, "wrist_roll": 147, "gripper": 147}
STEP_S = 0.002
PUSH_RAD = math.radians(20.0)


def range_of(joint: str) -> tuple[int, int]:
    return GRIPPER_RANGE if joint == "gripper" else RANGE


class Servo:
    """A servo and its joint. angle : of the joint [rad]. ratio : of its gear, as a share of 1:345."""

    def __init__(self, number: int, angle: float, friction: float, ratio: float) -> None:
        self.table = bytearray(256)
        low, high = range_of(JOINTS[number - 1])
        for address, value, size in (
            (3, 777, 2), (5, number, 1), (9, low, 2), (11, high, 2), (16, 1000, 2), (48, 1000, 2), (55, 1, 1),
        ):  # fmt: skip
            self.put(address, value, size)
        self.angle, self.torque, self.work_J = angle, 0.0, 0.0
        self.most_J = 0.0
        self.stop = math.inf
        self._friction, self.ratio = friction, ratio

    def put(self, address: int, value: int, size: int) -> None:
        self.table[address : address + size] = value.to_bytes(size, "little")

    def get(self, address: int, size: int) -> int:
        return int.from_bytes(self.table[address : address + size], "little")

    @property
    def units(self) -> float:
        """The joint's degrees, as LeRobot's."""
        return math.degrees(self.angle)

    def step(self, hand: float | None) -> None:
        """Move for `STEP_S`; hand : where a hand holds the joint [rad]."""
        self.torque = 0.0
        if self.table[40]:
            most = self.ratio * STALL_NM * self.get(48, 2) / 1000.0
            pull = self.ratio * LOOP_NM_RAD * ((self.get(42, 2) - MIDDLE) * COUNT_RAD - self.angle)
            self.torque = max(-most, min(most, pull))
        held = HAND if hand is not None else 0.0
        stiff = held + (self.ratio * LOOP_NM_RAD if self.table[40] else 0.0)
        force = self.torque + held * ((hand or 0.0) - self.angle)
        moved = force / (self._friction + stiff * STEP_S) * STEP_S  # implicit: stable at any stiffness
        moved = min(moved, max(0.0, self.stop - self.angle))
        self.angle += moved
        self.work_J += self.torque * moved
        self.most_J = max(self.most_J, self.work_J)

    def refresh(self) -> None:
        self.put(56, round(MIDDLE + self.angle / COUNT_RAD) % 4096, 2)
        count = round(self.torque / (self.ratio * CONSTANT_NM_A) / CURRENT_A)
        self.put(69, -count | 1 << 15 if count < 0 else count, 2)


class Arm:
    """An arm at a pseudo-terminal with the name `link`. starts : the joints' first angles [degrees].

    motion : of a leader's hand at each joint, `sine` or `push`, which ends 20 degrees from the start.
    """

    def __init__(self, kind: str, link: str, starts: list[float], motion: str) -> None:
        self.kind, self.motion = kind, motion
        ratios = [GEARS.get(joint, 345) / 345 if kind == "leader" else 1.0 for joint in JOINTS]
        self.servos = {
            k: Servo(k, math.radians(start), FRICTION[kind], ratio)
            for k, (start, ratio) in enumerate(zip(starts, ratios, strict=True), 1)
        }
        self._starts = [math.radians(start) for start in starts]
        self._terminal = PseudoTerminal(link, 0.0, random.Random(0))
        self._packets = wire.FeetechPackets()
        self.goals: list[tuple[float, list[float], list[float]]] = []
        """Time, goals and angles [degrees], for each goal while the torque is on."""
        self.limits: list[tuple[float, list[float]]] = []
        self.hand_s: float | None = None

    def serve(self, seconds: float) -> None:
        began = at = time.monotonic()
        while (now := time.monotonic()) - began < seconds:
            while at < now:
                at += STEP_S
                for k, servo in enumerate(self.servos.values()):
                    servo.step(self._hand(k, at))
            if select.select([self._terminal.device], [], [], STEP_S)[0]:
                for packet in self._packets.feed(self._terminal.read()):
                    self._answer(packet)
        self._terminal.close()

    def _hand(self, k: int, at: float) -> float | None:
        """Where the hand holds a leader's joint; it begins to move with the first command to the motors."""
        if self.kind != "leader":
            return None
        t = 0.0 if self.hand_s is None else at - self.hand_s
        grown = min(1.0, t / 2.0)
        share = grown if self.motion == "push" else 0.6 * grown * (math.sin(1.5 * t + k) - math.sin(k))
        return self._starts[k] + PUSH_RAD * share

    def _answer(self, packet: wire.BusPacket) -> None:
        data = packet.data
        if packet.code == wire.SYNC_READ:
            for number in data[2:]:
                self._send(number, data[0], data[1])
        elif packet.code == wire.SYNC_WRITE:
            size = data[1]
            for k in range(2, len(data), size + 1):
                self.servos[data[k]].table[data[0] : data[0] + size] = data[k + 1 : k + 1 + size]
            self._note(data[0])
        elif (servo := self.servos.get(packet.servo)) is not None:
            if packet.code == wire.READ:
                self._send(packet.servo, data[0], data[1])
            elif packet.code == wire.WRITE:
                was_on = servo.table[40]
                servo.table[data[0] : data[0] + len(data) - 1] = data[1:]
                if data[0] == 40 and data[1] and not was_on:  # switching on holds the place, as on the real servo
                    servo.put(42, round(MIDDLE + servo.angle / COUNT_RAD) % 4096, 2)
                self._status(packet.servo, b"")
            else:
                self._status(packet.servo, b"")

    def _note(self, address: int) -> None:
        now, servos = time.monotonic(), self.servos.values()
        if address == 42 and all(servo.table[40] for servo in servos):
            goals = [math.degrees((servo.get(42, 2) - MIDDLE) * COUNT_RAD) for servo in servos]
            self.goals.append((now, goals, [servo.units for servo in servos]))
            self.hand_s = self.hand_s or now
        elif address == 48:
            self.limits.append((now, [STALL_NM * servo.ratio * servo.get(48, 2) / 1000.0 for servo in servos]))

    def _send(self, number: int, address: int, size: int) -> None:
        if (servo := self.servos.get(number)) is not None:
            servo.refresh()
            self._status(number, bytes(servo.table[address : address + size]))

    def _status(self, number: int, data: bytes) -> None:
        self._terminal.write(self._packets.status(number, wire.Reply(0, data)))

    def report(self) -> dict[str, Any]:
        """What the arm received, and its motors' work on the joints [J]."""
        return {
            "goals": self.goals, "limits": self.limits,
            "work_J": [servo.work_J for servo in self.servos.values()],
            "most_J": [servo.most_J for servo in self.servos.values()],
        }  # fmt: skip


def calibration(folder: Path, name: str) -> None:
    """LeRobot's calibration file of the emulated arm, so that it asks for none."""
    folder.mkdir(parents=True, exist_ok=True)
    found = {
        joint: {"id": k, "drive_mode": 0, "homing_offset": 0, "range_min": low, "range_max": high}
        for k, joint in enumerate(JOINTS, 1)
        for low, high in [range_of(joint)]
    }
    (folder / f"{name}.json").write_text(json.dumps(found), "utf-8")


def main(kind: str, link: str, seconds: str, starts: str, motion: str = "sine", stops: str = "") -> None:
    """kind : leader or follower. starts : first angles [degrees]. stops : for each joint, how far it can turn."""
    arm = Arm(kind, link, [float(one) for one in starts.split(",")], motion)
    for servo, stop in zip(arm.servos.values(), stops.split(",") if stops else (), strict=bool(stops)):
        servo.stop = servo.angle + math.radians(float(stop))
    with suppress(OSError, AttributeError):  # on a busy machine, if it may
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    print("ready", flush=True)
    try:
        arm.serve(float(seconds))
    except KeyboardInterrupt:
        pass
    finally:
        Path(f"{link}.json").write_text(json.dumps(arm.report()), "utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
