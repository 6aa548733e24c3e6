"""How real processes end, whatever brings it: no force first, what was recorded readable, an exit code that says so."""

import contextlib
import os
import pty
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hapnet.realtime.shutdown import LINGER_S
from hapnet.recording.mcap import read_recording
from hapnet.transport.config import free_address
from tests.conftest import ENVIRONMENT
from tests.support.arms import (
    ARM,
    assert_no_force_last,
    forces,
    heard as heard,
    here as here,
    linux,
    notices,
    pressing,
    pushing,
)
from tests.support.processes import HAPNET, LIMIT_S, read_json, size, started, until, without_progress

REPORTED_NS = 2_500_000_000
"""After so long the device has had a report of the world, which has just begun when the hand pushes."""

# -- signals -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "code", "more"),
    [
        (signal.SIGINT, 130, ()),
        pytest.param(signal.SIGHUP, 129, ("--realtime",), marks=pytest.mark.slow),
        pytest.param(signal.SIGTERM, 143, (), marks=pytest.mark.slow),
        pytest.param(signal.SIGTERM, 143, ("--realtime",), marks=pytest.mark.soak),
        pytest.param(signal.SIGHUP, 129, (), marks=pytest.mark.soak),
    ],
)
def test_forces_go_to_zero_before_anything_else(number: signal.Signals, code: int, more: tuple[str, ...]) -> None:
    with pushing("--record", "device.mcap", "--json", "device.json", *more) as (device, world):
        device.until("samples on disk", lambda: size(Path("device.mcap")) > 5_000)
        device.process.send_signal(number)
        got, _, stderr = device.end()
        world.until_line("the device left")
    assert (got, stderr) == (code, "")
    zero_ns = assert_no_force_last()
    (left,) = notices(Path("world.jsonl"), "left")
    assert zero_ns < left["monotonic_ns"]
    assert forces()[-1][1] < Path("device.mcap").stat().st_mtime_ns
    recording = read_recording("device.mcap")
    assert not recording.torn
    assert recording.summary is not None
    assert read_json(Path("device.json"))["device"]["ledger"]["margin_J"] > 0.0


@pytest.mark.slow
def test_a_second_ctrl_c_does_not_wait_for_a_peer_that_is_gone() -> None:
    """The world is stopped dead with energy on its way to it: one Ctrl-C would wait for `LINGER_S`."""
    with pushing("--record", "device.mcap") as (device, world):
        pushed_ns = forces()[-1][0]
        device.until("seconds, in each of which the world reports", lambda: forces()[-1][0] - pushed_ns > REPORTED_NS)
        world.process.send_signal(signal.SIGSTOP)
        device.until("samples on disk", lambda: size(Path("device.mcap")) > 5_000)
        asked = time.monotonic()
        device.process.send_signal(signal.SIGINT)
        device.until("no force", lambda: forces()[-1][2] == 0.0)
        device.process.send_signal(signal.SIGINT)
        code, _, stderr = device.end()
        assert time.monotonic() - asked < LINGER_S
    assert code == 130
    assert stderr.startswith("hapnet: the rest of the world's account is missing since its last report")
    assert_no_force_last()
    assert not read_recording("device.mcap").torn


@linux
@pytest.mark.parametrize(
    "command", [["device", "-e", "tcp/127.0.0.1:1"], ["run"], pytest.param(["simulate"], marks=pytest.mark.slow)]
)
def test_ctrl_c_in_the_first_tenth_of_a_second_is_no_traceback(command: list[str]) -> None:
    """From when hapnet's first line has run, which SIGTERM's being caught shows."""
    for wait_s in (0.0, 0.03, 0.1):
        with started(*command) as program:
            status = Path(f"/proc/{program.process.pid}/status")

            def caught(status: Path = status) -> bool:
                line = next(line for line in status.read_text("ascii").splitlines() if line.startswith("SigCgt"))
                return bool(int(line.split()[1], 16) >> (signal.SIGTERM - 1) & 1)

            program.until("its first line", caught)
            time.sleep(wait_s)
            program.process.send_signal(signal.SIGINT)
            code, _, stderr = program.end()
        assert (code, stderr) == (130, "")


@pytest.mark.parametrize("module", ["typer", "numpy", "zenoh"])
def test_ctrl_c_within_an_import_is_no_traceback(module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A module that presses Ctrl-C while it is imported, and whose importer would forgive an exception."""
    Path(f"{module}.py").write_text(
        "import os, signal, time\n"
        "try:\n    os.kill(os.getpid(), signal.SIGINT)\n    time.sleep(20)\n"
        "except BaseException:\n    raise ImportError from None\n"
    )
    with started("device", "-e", "tcp/127.0.0.1:1") as program:
        code, stdout, stderr = program.end()
    assert (code, stdout, stderr) == (130, "", "")


def test_ctrl_c_within_an_evaluated_string_is_no_death_by_signal() -> None:
    """As typer evaluates annotations: what passes through `eval` ends Python by SIGINT, though it is caught."""
    Path("pressing.py").write_text(
        "import os, signal, sys\n"
        "from hapnet.__main__ import _interrupt\n"
        "signal.signal(signal.SIGINT, _interrupt)\n"
        "try:\n    eval('os.kill(os.getpid(), signal.SIGINT) or [n for n in range(10)]')\n"
        "except KeyboardInterrupt:\n    sys.exit(130)\n"
    )
    with started(command=(sys.executable, "-m", "pressing")) as program:
        assert program.end() == (130, "", "")


# -- a terminal --------------------------------------------------------------------------------------------------------

ON_A_TERMINAL = """
import os, signal, sys
os.login_tty(int(sys.argv[1]))
os.dup2(os.open("stderr", os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
if sys.argv[2] == "nohup":
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
os.execv(sys.argv[3], sys.argv[3:])
"""


class Terminal:
    """A hapnet that prints to a terminal of its own, whose window can be closed."""

    def __init__(self, how: str, *argv: object) -> None:
        self._window, inside = pty.openpty()
        self.process = subprocess.Popen(
            [sys.executable, "-c", ON_A_TERMINAL, str(inside), how, *HAPNET, *map(str, argv)],
            pass_fds=(inside,),
            env={**ENVIRONMENT, "PYTHONFAULTHANDLER": "1"},
        )
        os.close(inside)
        self.shown = b""

    def until(self, words: bytes) -> None:
        deadline = time.monotonic() + LIMIT_S
        while words not in self.shown:
            assert time.monotonic() < deadline, self.shown
            self.shown += os.read(self._window, 4096)

    def close(self) -> None:
        os.close(self._window)

    def end(self) -> tuple[int, str]:
        """Exit code and standard error; if it does not end, where it stands.

        Beside twenty busy processes it has taken 25 s, while its start took two minutes: all for want of a processor.
        """
        try:
            code = self.process.wait(4 * LIMIT_S)
        except subprocess.TimeoutExpired:
            self.process.send_signal(signal.SIGABRT)
            self.process.wait(LIMIT_S)
            pytest.fail(f"it did not end:\n{Path('stderr').read_text('utf-8')}")
        return code, without_progress(Path("stderr").read_text("utf-8"))


@pytest.mark.parametrize(
    "role", ["device", pytest.param("world", marks=pytest.mark.slow), pytest.param("run", marks=pytest.mark.slow)]
)
@pytest.mark.slow
def test_a_closed_terminal_ends_a_side_in_order(role: str) -> None:
    address = free_address()
    sides: dict[str, list[str]] = {"world": ["-l", address], "device": ["-e", address, *ARM]}
    with contextlib.ExitStack() as stack:
        if role == "run":
            terminal = Terminal("", "run", "-v", *ARM, "--out", ".")
        else:
            other = "world" if role == "device" else "device"
            stack.enter_context(started(other, *sides[other]))
            terminal = Terminal("", role, *sides[role], "--record", f"{role}.mcap")
        recording = Path("device.mcap" if role == "run" else f"{role}.mcap")
        try:
            terminal.until(b"paired with the ")
            until(lambda: size(recording) > 5_000 and pressing())
            terminal.close()
            code, stderr = terminal.end()
        finally:
            terminal.process.kill()
    assert (code, stderr) == (129, "")
    assert not read_recording(recording).torn
    if role != "world":
        assert_no_force_last()


@pytest.mark.slow
def test_nohup_goes_on_without_its_terminal() -> None:
    """Every write to it fails then: nothing comes of that."""
    terminal = Terminal("nohup", "run", "-v", "--duration", 1.5, "--out", "r", "--json", "s.json")
    try:
        terminal.until(b"device: paired")
        terminal.close()
        code, stderr = terminal.end()
    finally:
        terminal.process.kill()
    assert (code, stderr) == (0, "")
    assert read_json(Path("s.json"))["duration_s"] == pytest.approx(1.5, abs=0.5)
    assert Path("r/figure.png").exists()
