"""What a driver costs beside the bare port or library; the rounds take turns.

serial: against its emulator in another process. A round trip is the time from a command to the first state that has
its number; the emulator sends a state each millisecond, so it is between 0 and a little over 1 ms. dhd: against the
stand-in of the library, read and command together.
"""

import ctypes
import os
import select
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from hapnet.errors import DeviceSilent
from hapnet.ext.devices import serial_frames as wire
from hapnet.ext.devices.force_dimension import ForceDimension
from hapnet.ext.devices.serial_axis import SerialAxis
from tests.conftest import ROOT
from tests.support.processes import HAPNET, until

ROUNDS, CYCLES = 5, 2000
STATE_SIZE = len(wire.state(wire.BoardState(0, 0, 0, 0, 0, 0)))
Measured = tuple[list[float], float]
"""Round trips [us], and CPU time a cycle [us]."""


def cpu_us(cycle: Callable[[], None], cycles: int) -> float:
    before = time.thread_time()
    for _ in range(cycles):
        cycle()
    return (time.thread_time() - before) / cycles * 1e6


def bare_serial(path: str) -> Measured:
    port = os.open(path, os.O_RDWR | os.O_NOCTTY)
    took: list[float] = []
    number, sent_s = 0, 0.0

    def cycle() -> None:
        nonlocal number, sent_s
        select.select([port], [], [], 0.01)
        state = os.read(port, 4096)[-STATE_SIZE:]
        if int.from_bytes(state[2:4], "little") == number and sent_s:
            took.append((time.perf_counter() - sent_s) * 1e6)
            sent_s = 0.0
        if not sent_s:
            number += 1
            command = wire.command(wire.BoardCommand(b"F", number))
            sent_s = time.perf_counter()
            os.write(port, command)

    cpu = cpu_us(cycle, CYCLES)
    os.close(port)
    return took, cpu


def driven_serial(path: str) -> Measured:
    axis = SerialAxis(1, port=path)
    took: list[float] = []
    sent_s = 0.0

    def cycle() -> None:
        nonlocal sent_s
        try:
            axis.read()
        except DeviceSilent:  # a busy machine
            return
        if axis._last.command == axis._number and sent_s:
            took.append((time.perf_counter() - sent_s) * 1e6)
            sent_s = 0.0
        if not sent_s:
            sent_s = time.perf_counter()
            axis.apply((0.0,))

    cpu = cpu_us(cycle, CYCLES)
    axis.close()
    return took, cpu


def dhd(library: str, *, driven: bool) -> Measured:
    took: list[float] = []
    device = ForceDimension(3, library=library)
    stub = device._dhd
    three = [ctypes.c_double() for _ in range(3)]
    pointers = [ctypes.byref(value) for value in three]
    zero = (0.0, 0.0, 0.0)

    def bare() -> None:
        begun_s = time.perf_counter()
        stub.dhdGetPosition(*pointers, 0)
        stub.dhdGetLinearVelocity(*pointers, 0)
        stub.dhdSetForce(0.0, 0.0, 0.0, 0)
        took.append((time.perf_counter() - begun_s) * 1e6)

    def through() -> None:
        begun_s = time.perf_counter()
        device.read()
        device.apply(zero)
        took.append((time.perf_counter() - begun_s) * 1e6)

    cpu = cpu_us(through if driven else bare, CYCLES)
    device.close()
    return took, cpu


def show(name: str, bare: list[Measured], driven: list[Measured]) -> None:
    for what, found in (("bare", bare), ("driver", driven)):
        p50, p99 = (np.median([np.quantile(took, q) for took, _ in found]) for q in (0.5, 0.99))
        print(f"{name:<7} {what:<7} round trip {p50:7.1f} us, p99 {p99:7.1f} us; CPU a cycle "
              f"{np.median([cpu for _, cpu in found]):6.1f} us")  # fmt: skip


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        link, library = Path(folder) / "axis", Path(folder) / "libdhd.so"
        emulator = subprocess.Popen([*HAPNET, "emulate", f"serial:link={link}"], stdout=subprocess.DEVNULL)
        try:
            until(link.exists)
            pairs = [(bare_serial(str(link)), driven_serial(str(link))) for _ in range(ROUNDS)]
        finally:
            emulator.terminate()
            emulator.wait()
        show("serial", [bare for bare, _ in pairs], [driven for _, driven in pairs])
        flags = ["-std=gnu11", "-O1", "-shared", "-fPIC"]
        subprocess.run(["gcc", *flags, ROOT / "tests" / "sketch" / "dhd.c", "-o", library, "-lm"], check=True)
        both = [(dhd(str(library), driven=False), dhd(str(library), driven=True)) for _ in range(ROUNDS)]
        show("dhd", [bare for bare, _ in both], [driven for _, driven in both])
