"""Servo buses in a thread of the test."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hapnet.ext.arms.device import SimulatedArm
from hapnet.ext.devices.emulator import ArmHandle
from hapnet.ext.robots.bus_emulator import BusEmulator, DynamixelEmulator
from hapnet.plant.operator import Impedance, Operator, Rest

HAND = Impedance(0.005, 0.05, 3.0)
"""At each joint: kg m^2, Nms/rad, Nm/rad."""


@contextmanager
def bus(
    kind: type[BusEmulator] = DynamixelEmulator, hand: Operator | None = None, period: float = 0.01, **options: Any
) -> Iterator[Any]:
    """An emulated bus that serves until the block ends; its arm moves in steps of `period` [s]."""
    table = kind.arm(options)
    hand = hand or Rest(len(table.free), HAND)
    arm = SimulatedArm(table, hand, period=period, substeps=1, compensated=False, by_joints=True)
    emulator = kind(ArmHandle(arm), time.monotonic_ns, **options)
    stop = threading.Event()
    thread = threading.Thread(target=emulator.run, args=(stop,))
    thread.start()
    try:
        yield emulator
    finally:
        stop.set()
        thread.join()


def urdf(folder: Path, joints: int) -> Path:
    """An arm of so many joints, in turn about z and y, each with a bar of 0.1 m and 50 g."""
    links, hinges = ['<link name="l0"/>'], []
    for k in range(1, joints + 1):
        links.append(
            f'<link name="l{k}"><inertial><origin xyz="0 0 0.05"/><mass value="0.05"/>'
            '<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )
        axis = "0 0 1" if k % 2 else "0 1 0"
        hinges.append(
            f'<joint name="j{k}" type="revolute"><parent link="l{k - 1}"/><child link="l{k}"/>'
            f'<origin xyz="0 0 0.1"/><axis xyz="{axis}"/><limit lower="-1" upper="2" effort="0" velocity="0"/></joint>'
        )
    path = folder / f"arm{joints}.urdf"
    path.write_text(f'<robot name="arm">{"".join(links + hinges)}</robot>', "utf-8")
    return path
