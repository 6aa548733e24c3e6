"""How much force is left at the device when hapnet's processes are killed or stopped, or the device is unplugged.

The device is the emulated serial axis, which ends a force by its own watchdog 20 ms after the last command; it runs in
this process and notes each change of its force. By hand, 50 random times each, with the table of
`hapnet/devices/safety.md`: ``pytest -n 0 -s -m soak tests/faults/test_force_afterwards.py``.
"""

import os
import random
import signal
import threading
import time
from bisect import bisect_right
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import mkdtemp
from typing import NamedTuple

import numpy as np
import pytest

from hapnet.assembly.operators import operator
from hapnet.checks import Vector
from hapnet.ext.devices.emulator import EmulatedHandle
from hapnet.ext.devices.serial_emulator import SerialEmulator
from hapnet.params import Params
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.worlds.registry import make_scene
from hapnet.realtime.servo import FIFO_PRIORITY
from tests.faults.support import Pair, let_pass, pair
from tests.support.processes import child_of, until

pytest.importorskip("serial")

FELT_N = 0.1
"""A fault comes at a random time, but not where there is no force that could be left."""
AFTER_NS = 50_000_000
SEEN_S = 0.15

HAND = {
    "operator": "press", "operator_model.wait_s": 0.0, "operator_model.reach_s": 0.5, "operator_model.hold_s": 0.5,
}  # fmt: skip


class Noted(SimulatedDevice):
    """It notes when its force changes [ns], and to what [N], by its own time: a board's watchdog waits for nobody."""

    times_ns: list[int]
    forces_N: list[float]
    began_ns = 0

    def advance(self) -> float:
        self.began_ns = self.began_ns or time.monotonic_ns() - round(self.period * 1e9)
        return super().advance()

    def apply(self, force: Vector) -> Vector:
        applied = super().apply(force)
        self.forces_N.append(abs(applied[0]))
        self.times_ns.append(self.began_ns + round(self.ticks * self.period * 1e9))
        return applied


class StandIn:
    """The emulated axis with a simulated hand on it, plugged in or not; it lives in both cases."""

    def __init__(self, link: Path) -> None:
        params = Params().set(HAND | {"dof": 1})
        device = Noted(operator(params, make_scene("wall", dof=1)), force_limit=SerialEmulator.force_limit)
        device.times_ns, device.forces_N = [0], [0.0]
        self.device = device
        self.handle = EmulatedHandle(device, SerialEmulator.watchdog_s)
        self.link = link
        self._stop = threading.Event()
        self._thread = threading.Thread()
        self.plug()

    def plug(self) -> None:
        self._go_on(SerialEmulator(self.handle, time.monotonic_ns, link=str(self.link)).run)

    def unplug(self) -> None:
        """Nothing goes in or out any more, and the computer has no such port; power and watchdog stay."""
        self._go_on(self._alone)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()

    @property
    def force_N(self) -> float:
        return self.device.forces_N[-1]

    def force_at(self, at_ns: int) -> float:
        return self.device.forces_N[bisect_right(self.device.times_ns, at_ns) - 1]

    def ended_ns(self) -> int:
        """When the force became zero, and stayed so."""
        k = len(self.device.forces_N) - 1
        assert self.device.forces_N[k] == 0.0
        while k > 0 and self.device.forces_N[k - 1] == 0.0:
            k -= 1
        return self.device.times_ns[k]

    def _go_on(self, run: Callable[[threading.Event], None]) -> None:
        if self._thread.ident is not None:
            self.close()
        self._stop = threading.Event()

        def as_hardware_does() -> None:
            undisturbed()
            run(self._stop)

        self._thread = threading.Thread(target=as_hardware_does, daemon=True)
        self._thread.start()

    def _alone(self, stop: threading.Event) -> None:
        while not stop.wait(1e-3):
            self.handle.read(time.monotonic_ns())


def undisturbed() -> None:
    """Let the calling thread run as soon as it wants to, where that is allowed: a board waits for no computer."""
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(FIFO_PRIORITY + 1))


class Outcome(NamedTuple):
    """Force at the fault and 50 ms after it [N], after how long it was zero [ms], and whether the watchdog did that."""

    before_N: float
    after_N: float
    ended_ms: float
    by_watchdog: bool


KILLED, STOPPED, UNPLUGGED = "killed", "stopped", "unplugged"
FAULTS = [
    ("thread", "process", KILLED), ("thread", "process", STOPPED), ("thread", "device", UNPLUGGED),
    ("realtime", "servo", KILLED), ("realtime", "servo", STOPPED),
    ("realtime", "parent", KILLED), ("realtime", "parent", STOPPED), ("realtime", "device", UNPLUGGED),
]  # fmt: skip


def faults(kind: str, who: str, what: str, times: int, directory: Path) -> list[Outcome]:
    """Do it so many times, in one run if it can go on."""
    rng = random.Random(f"{kind} {who} {what}")
    outcomes: list[Outcome] = []
    undisturbed()  # this thread too, which may hold the interpreter's lock
    stand_in = StandIn(directory / "axis")
    words = ("--device", f"serial:{stand_in.link}", *(("--realtime",) if kind == "realtime" else ()))
    more = ("--set", "device.self_test_N=0", "--set", "device.force_ramp_s=0.05")
    try:
        while len(outcomes) < times:
            run = Path(mkdtemp(dir=directory))
            with pair(run, "--dof", 1, "--scene", "wall", device=(*words, *more)) as sides:
                while len(outcomes) < times:
                    try:
                        outcomes.append(fault(sides, kind, who, what, rng, stand_in))
                    except AssertionError as error:
                        if "cannot be made" not in str(error):  # its states came too late: this machine is too busy
                            raise
                        break
                    if what == KILLED:
                        break
    finally:
        stand_in.close()
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return outcomes


def fault(sides: Pair, kind: str, who: str, what: str, rng: random.Random, stand_in: StandIn) -> Outcome:
    sides.device.until("a force", lambda: stand_in.force_N > FELT_N)
    let_pass(rng.uniform(0.0, 1.0))
    sides.device.until("a force", lambda: stand_in.force_N > FELT_N)
    process = sides.device.process.pid
    servo = None if kind == "thread" else child_of(process, "hapnet.realtime.servo_child")
    if who == "servo":
        assert servo is not None
        process = servo
    released = stand_in.handle.released
    at_ns = time.monotonic_ns()
    if what == UNPLUGGED:
        stand_in.unplug()
    else:
        os.kill(process, signal.SIGKILL if what == KILLED else signal.SIGSTOP)
    let_pass(SEEN_S)
    until(lambda: stand_in.force_N == 0.0)
    ended_ms = (stand_in.ended_ns() - at_ns) * 1e-6
    found = Outcome(
        stand_in.force_at(at_ns), stand_in.force_at(at_ns + AFTER_NS), ended_ms, stand_in.handle.released > released
    )
    if what == UNPLUGGED:
        stand_in.plug()
    elif what == STOPPED:
        os.kill(process, signal.SIGCONT)
    elif servo is not None:  # it lets go of the port by itself
        until(lambda: not Path(f"/proc/{servo}").exists())
    return found


def assert_ended(who: str, what: str, outcomes: list[Outcome]) -> None:
    """By 50 ms there is no force; where its parent was stopped hapnet itself ends it. A killed one dies slowly."""
    assert all(outcome.before_N > 0.0 for outcome in outcomes)
    assert [outcome.after_N for outcome in outcomes] == [0.0] * len(outcomes)
    if (who, what) == ("parent", STOPPED):
        assert not any(outcome.by_watchdog for outcome in outcomes)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "who", "what"), FAULTS)
def test_no_force_is_left(kind: str, who: str, what: str, tmp_path: Path) -> None:
    assert_ended(who, what, faults(kind, who, what, 1, tmp_path))


@pytest.mark.soak
@pytest.mark.parametrize(("kind", "who", "what"), FAULTS)
def test_fifty_random_times(kind: str, who: str, what: str, tmp_path: Path) -> None:
    outcomes = faults(kind, who, what, 50, tmp_path)
    before, after, ended, watchdog = (np.array(column) for column in zip(*outcomes, strict=True))
    by = f"its watchdog ({watchdog.sum()} of {len(outcomes)})" if watchdog.any() else "hapnet"
    print(
        f"\n| {kind} | {who} {what} | {np.median(before):.2f}, {before.max():.2f} | {after.max():.2g} | "
        f"{np.median(ended):.0f}, {ended.max():.0f} | {by} |"
    )
    assert_ended(who, what, outcomes)
