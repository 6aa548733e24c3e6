"""The keyboard of a terminal: a device's class reads it in `hapnet run`, and the terminal is left as it was."""

import os
import pty
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from hapnet.commands.run import may_read_input, terminal_restored
from hapnet.recording.mcap import read_recording
from tests.conftest import ENVIRONMENT, ROOT

KNOB = "examples.keyboard_knob:Knob"
LIMIT_S = 60.0


class Terminal:
    """A pseudo terminal, on whose other end somebody types."""

    def __init__(self) -> None:
        self.ours, self.theirs = pty.openpty()
        self.said = b""

    def type(self, keys: str) -> None:
        os.write(self.ours, keys.encode())

    def until(self, words: bytes) -> None:
        """Read until the program has said these words since the last time."""
        end = time.monotonic() + LIMIT_S
        while words not in self.said:
            assert time.monotonic() < end, self.said
            self.said += os.read(self.ours, 65536)
        self.said = self.said.partition(words)[2]

    def close(self) -> None:
        os.close(self.ours)
        os.close(self.theirs)


@contextmanager
def terminal() -> Iterator[Terminal]:
    made = Terminal()
    try:
        yield made
    finally:
        made.close()


def started(terminal: Terminal, state: Path, *argv: object) -> subprocess.Popen[bytes]:
    """The command in a session of its own, in which this terminal controls it, as a shell's does."""
    command = [sys.executable, "-c", _IN_FRONT, sys.executable, "-m", "hapnet", "run", *map(str, argv)]
    environment = {**ENVIRONMENT, "XDG_STATE_HOME": str(state), "COLUMNS": "100", "TERM": "xterm"}
    return subprocess.Popen(
        command, cwd=ROOT, env=environment, stdin=terminal.theirs, stdout=terminal.theirs, stderr=terminal.theirs,
        start_new_session=True,
    )  # fmt: skip


_IN_FRONT = """
import fcntl, os, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
os.execv(sys.argv[1], sys.argv[1:])
"""


@pytest.mark.slow
def test_a_knob_that_the_keyboard_turns_rests_in_the_wall(tmp_path: Path) -> None:
    """The hand goes to 30 mm: K_h (A - x) = K (x - p) and K'/K times that force is K_w (p - wall)."""
    K, K_v, K_h, K_w, wall, hand = 200.0, 500.0, 60.0, 3000.0, 0.02, 0.03
    flags = ["--dof", 1, "--duration", 4, "--set", f"device.stiffness={K}", "--set", f"world.stiffness={K_v}"]
    flags += ["--set", "device.force_ramp_s=0", "--set", "device.watchdog_s=0", "--link", "delay 1ms"]
    with terminal() as typed:
        before = termios.tcgetattr(typed.theirs)
        run = started(typed, tmp_path, "--device", KNOB, *flags, "--out", tmp_path / "run")
        try:
            typed.until(b"press Enter")
            typed.type("\n")
            typed.until(b"running")
            typed.type("d" * round(hand / 0.002))
            typed.until(b"report.html")
            assert run.wait(LIMIT_S) == 0
        finally:
            run.kill()
            run.wait()
        assert termios.tcgetattr(typed.theirs) == before
    device = read_recording(tmp_path / "run" / "device.mcap").device
    at_rest = device["time_s"] > 3.0
    x, p = np.linalg.solve([[K_h + K, -K], [K_v, -K_v - K_w]], [K_h * hand, -K_w * wall])
    assert np.median(device["position_m"][at_rest]) == pytest.approx(x, abs=2e-4)
    assert -np.median(device["force_N"][at_rest]) == pytest.approx(K * (x - p), rel=0.05)
    assert x < hand - 0.003


def test_a_run_may_read_the_terminal_of_another_session(monkeypatch: pytest.MonkeyPatch) -> None:
    """As after ``setsid hapnet run``: job control is about the terminal of one's own session only."""
    with terminal() as typed, open(typed.theirs, closefd=False) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        before = termios.tcgetattr(typed.theirs)
        assert may_read_input()
        with terminal_restored():
            changed = termios.tcgetattr(typed.theirs)
            changed[3] &= ~termios.ICANON
            termios.tcsetattr(typed.theirs, termios.TCSANOW, changed)
        assert termios.tcgetattr(typed.theirs) == before


@pytest.mark.slow
def test_a_killed_run_leaves_the_terminal_usable(tmp_path: Path) -> None:
    """Ctrl-C comes from the terminal: its line discipline sends it to all processes in front."""
    with terminal() as typed:
        before = termios.tcgetattr(typed.theirs)
        flags = ["--dof", 1, "--duration", 0, "--set", "device.self_test_N=0", "--set", "device.watchdog_s=0"]
        run = started(typed, tmp_path, "--device", KNOB, *flags, "--no-files")
        try:
            typed.until(b"running")
            assert termios.tcgetattr(typed.theirs)[3] & termios.ICANON == 0  # a key counts without Enter
            typed.type("\x03")
            assert run.wait(LIMIT_S) == 130
        finally:
            run.kill()
            run.wait()
        assert termios.tcgetattr(typed.theirs) == before
