"""A servo whose parent stands still renders no force: nobody could end it. Then it goes on by itself."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from hapnet.plant.device import SimulatedDevice
from hapnet.plant.operator import Impedance, Rest
from hapnet.realtime.parent_watch import HANGS, HANGS_LOOKS, LOOK_NS, STOPPED, ParentWatch
from hapnet.realtime.servo_pipe import available
from hapnet.summary.verdict import judge
from tests.conftest import ROOT, mostly_slow
from tests.side.test_real_device import Rig
from tests.summary.test_verdict import but
from tests.support.processes import until

pytestmark = pytest.mark.skipif(not available(), reason="no SOCK_SEQPACKET here")

SLEEPER = [sys.executable, "-c", "import time; time.sleep(60)"]


@pytest.fixture
def states(tmp_path: Path) -> Callable[[str], str]:
    """Writes what proc_pid_stat(5) says of a process in this state; returns the file's path."""

    def write(state: str) -> str:
        path = tmp_path / "stat"
        path.write_text(f"4711 (a (b) T) c) {state} 1 4711 4711 0 -1 4194560 2133 0 0 0", "ascii")
        return str(path)

    return write


@pytest.mark.parametrize(("state", "why"), [("R", ""), ("S", ""), ("D", ""), ("Z", ""), ("T", STOPPED), ("t", STOPPED)])
def test_the_state_of_a_process_says_whether_it_was_stopped(state: str, why: str, states: Callable[[str], str]) -> None:
    watch = ParentWatch(0, states(state))
    assert watch.look(0) == why
    watch.close()


def test_one_that_was_stopped_is_back_with_its_next_beat(states: Callable[[str], str]) -> None:
    watch = ParentWatch(0, states("T"))
    assert watch.look(0) == STOPPED
    states("S")
    assert watch.look(LOOK_NS - 1) == STOPPED  # it is not looked at in each tick
    assert watch.look(LOOK_NS) == STOPPED
    watch.beat()
    assert watch.look(2 * LOOK_NS) == ""
    watch.close()


def test_a_heart_that_does_not_beat_for_a_second_stands_still(states: Callable[[str], str]) -> None:
    """The servo looks a hundred times a second; an absence of its own counts as one look."""
    watch = ParentWatch(0, states("S"))
    assert not any(watch.look(k * LOOK_NS) for k in range(500))  # it has not begun to beat
    for _ in range(3):
        watch.beat()
        since_ns = 500 * LOOK_NS
        assert not any(watch.look(since_ns + k * LOOK_NS) for k in range(HANGS_LOOKS - 2))
        assert watch.look(since_ns + 3600_000_000_000) == ""
        assert watch.look(since_ns + 3600_000_000_000 + LOOK_NS) == HANGS
        watch._due_ns = 0
    watch.close()


def test_without_such_a_file_the_heart_counts() -> None:
    watch = ParentWatch(0, "/nowhere")
    watch.beat()
    assert [watch.look(k * LOOK_NS) for k in range(HANGS_LOOKS)] == [""] * (HANGS_LOOKS - 1) + [HANGS]
    watch.close()


def test_a_real_process() -> None:
    process = subprocess.Popen(SLEEPER)
    watch = ParentWatch(process.pid)
    try:
        assert watch.look(0) == ""
        process.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, process.pid, os.WSTOPPED)
        assert watch.look(LOOK_NS) == STOPPED
    finally:
        process.kill()
        process.wait()
    watch.beat()
    assert watch.look(2 * LOOK_NS) == ""  # it is gone, which is another matter
    watch.close()


# -- the side ----------------------------------------------------------------------------------------------------------


def test_a_force_that_nobody_could_end_is_none_at_once_and_then_grows() -> None:
    rig = Rig(device__force_ramp_s=0.02)
    rig.tick(0.0, times=20)
    assert rig.arm.reported[-1][0] == pytest.approx(2.0)
    for _ in range(50):
        rig.side.withhold(rig.now_ns, STOPPED)
        rig.tick(0.001)
        rig.side.coupling.receive((0.02,), 0.0, 0.0)
    assert rig.arm.reported[-50:] == [(0.0,)] * 50
    grown = []
    for _ in range(12):
        rig.side.withhold(rig.now_ns, "")
        rig.tick(0.001)
        rig.side.coupling.receive((0.02,), 0.0, 0.0)
        grown.append(rig.arm.reported[-1][0])
    assert 0.0 <= grown[0] <= 2.0 * 2.0 / 20.0
    assert grown[-1] == pytest.approx(1.9)  # 100 N/m over the 19 mm that are left
    assert rig.events == [
        f"parent: no force: {STOPPED}",
        "parent: the network process runs again: the force grows back",
    ]
    assert rig.levels == ["warning", "info"]
    assert rig.side.withheld_ns == 50 * 2_000_000
    assert rig.work == pytest.approx(-2.0 * 0.001)  # of the millimetre at the start, under the force before


def test_the_verdict_says_for_how_long() -> None:
    found = judge(but({"device.servo": {"withheld_s": 3.21}}))
    assert found["passive"] is True
    assert found["reason"].endswith("no force for 3.2 s: the device's network process was stopped")
    assert "no force" not in judge(but({"device.servo": {"withheld_s": 0.0}}))["reason"]


# -- the servo's process -----------------------------------------------------------------------------------------------


class Told(SimulatedDevice):
    """A device without a hand; it writes to a file which force it got last, and when it last got one [ns]."""

    def __init__(self, dof: int) -> None:
        super().__init__(Rest(dof, Impedance(0.1, 1.0, 10.0), (0.0,) * dof))
        self._diary = os.open(os.environ["HAPNET_TEST_DIARY"], os.O_WRONLY | os.O_CREAT)
        self._last_ns = 0

    def apply(self, force: tuple[float, ...]) -> tuple[float, ...]:
        if any(force):
            self._last_ns = time.monotonic_ns()
        os.pwrite(self._diary, f"{max(map(abs, force)):12.6f} {self._last_ns:20d}".encode(), 0)
        return super().apply(force)


PARENT = f"""
import os, sys, time
sys.path.insert(0, {str(ROOT)!r})
from tests.realtime.test_servo_process import Running
running = Running("tests.realtime.test_parent_watch:Told")
running.paired()
print(running.pid, flush=True)
while True:
    running.servo.on_sample((0.02, 0.0), 0, 0, 0)
    if not os.path.exists(os.environ["HAPNET_TEST_DIARY"] + ".hangs"):
        running.servo.beat()
    time.sleep(0.02)
"""
"""Starts a servo, says its number, and is its heart."""


@pytest.mark.slow
def test_a_servo_whose_parent_stands_still_renders_no_force_until_it_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    diary, hangs = tmp_path / "diary", tmp_path / "diary.hangs"
    monkeypatch.setenv("HAPNET_TEST_DIARY", str(diary))

    def told() -> tuple[float, int]:
        words = diary.read_text().split() if diary.exists() else []
        return (float(words[0]), int(words[1])) if len(words) == 2 else (0.0, 0)

    with subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True) as parent:
        try:
            servo = int(parent.stdout.readline())
            until(lambda: told()[0] > 0.3)
            parent.send_signal(signal.SIGSTOP)
            until(lambda: told()[0] == 0.0)  # how soon: tests/faults/test_force_afterwards.py
            parent.send_signal(signal.SIGCONT)
            until(lambda: told()[0] > 0.3)
            hangs.touch()
            until(lambda: told()[0] == 0.0)
            hangs.unlink()
            until(lambda: told()[0] > 0.3)
            parent.send_signal(signal.SIGSTOP)
        finally:
            parent.kill()
    until(lambda: ended(servo))
    assert told()[0] == 0.0


@pytest.mark.parametrize("fork", mostly_slow([False, True], 1))
def test_a_servo_whose_parent_is_killed_renders_no_force_and_ends(
    fork: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The parent is a process that starts a servo, says its number and hangs; its fork, if any, holds the pipe open."""
    diary = tmp_path / "diary"
    monkeypatch.setenv("HAPNET_TEST_DIARY", str(diary))
    program = f"""
import os, sys, threading
sys.path.insert(0, {str(ROOT)!r})
from tests.realtime.test_servo_process import Running
running = Running()
running.paired()
running.servo.on_sample((0.02, 0.0), 0, 0, 0)
fork = os.fork() if {fork} else 1
if fork:
    print(running.pid, fork, flush=True)
threading.Event().wait(30.0)
"""
    parent = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    child, copy = map(int, parent.stdout.readline().split())
    until(lambda: diary.exists() and float(diary.read_text() or 0.0) > 0.3)
    parent.kill()
    parent.wait()
    parent.stdout.close()
    until(lambda: ended(child))
    if fork:
        os.kill(copy, signal.SIGKILL)
    assert float(diary.read_text()) == 0.0


def ended(process: int) -> bool:
    stat = Path(f"/proc/{process}/stat")
    return not stat.exists() or stat.read_text().rpartition(")")[2].split()[0] == "Z"
