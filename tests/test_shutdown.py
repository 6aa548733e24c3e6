"""How real processes end, whatever brings it: no force first, what was recorded readable, an exit code that tells."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from hapnet.realtime.shutdown import LINGER_S
from hapnet.recording.mcap import read_recording
from hapnet.transport.config import free_address
from tests.conftest import ENVIRONMENT
from tests.processes import HAPNET, LIMIT_S, Program, child_of, read_json, size, started, until

linux = pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
DRIVER = """
import mmap, time

class Arm:
    '''Held 30 mm inside; every force that it is told is a line: monotonic and wall clock [ns], the force [N].'''

    force_limit, resolution = 2.0, 0.0

    def __init__(self, dof):
        self.dof = dof
        with open("diary", "r+b") as file:
            self.diary = mmap.mmap(file.fileno(), 0)  # takes no room on a disk that is full
        self.begin = time.monotonic()

    def read(self):
        x = min(0.03, 0.1 * (time.monotonic() - self.begin))
        return (x,) + (0.0,) * (self.dof - 1), (0.0,) * self.dof

    def apply(self, force):
        line = f"{time.monotonic_ns()} {time.time_ns()} {max(map(abs, force)):.9f}"
        self.diary.write(f"{line:63}\\n".encode())
"""
ARM = ("--device", "driver:Arm")


@pytest.fixture(autouse=True)
def heard() -> Iterator[None]:
    """Under nohup these tests ignore SIGHUP, and so would what they start; a handler is not handed on."""
    before = signal.signal(signal.SIGHUP, lambda number, frame: None)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Every test runs in a directory of its own, with a driver in it."""
    monkeypatch.chdir(tmp_path)
    Path("driver.py").write_text(DRIVER, "utf-8")
    with Path("diary").open("wb") as diary:
        diary.truncate(1 << 22)  # a minute's lines
    return tmp_path


def forces() -> list[tuple[int, int, float]]:
    """What the arm was told: monotonic [ns], wall clock [ns], the largest component [N]."""
    lines = Path("diary").read_bytes().rstrip(b"\0").decode("ascii").splitlines()
    return [(int(mono), int(wall), float(force)) for mono, wall, force in map(str.split, lines)]


def pressing() -> bool:
    return any(force > 0.3 for _, _, force in forces()[-5:])


def assert_no_force_last() -> int:
    """The arm pushed, and the last that it was told was not to; when, on the monotonic clock [ns]."""
    told = forces()
    assert max(force for _, _, force in told) > 0.3
    assert told[-1][2] == 0.0
    assert any(force > 0.0 for _, _, force in told[-50:-1])  # it pushed to the end, but for ticks that came too late
    return told[-1][0]


def notices(log: Path, kind: str) -> list[dict[str, Any]]:
    found = [json.loads(line) for line in log.read_text("utf-8").splitlines()]
    return [notice for notice in found if notice["kind"] == kind]


@contextlib.contextmanager
def pushing(*more: object, before: Sequence[str] = ()) -> Iterator[tuple[Program, Program]]:
    """The device, whose arm renders a force, and its world, which logs."""
    address = free_address()
    with (
        started("world", "-l", address, "--log", "world.jsonl") as world,
        started("device", "-e", address, *ARM, *more, command=(*before, *HAPNET)) as device,
    ):
        device.until("a force", pressing)
        yield device, world


def limited(file_size: int) -> list[str]:
    """What starts a process that cannot write a file beyond this size."""
    code = "import os, resource as r, sys; n = int(sys.argv[1]); r.setrlimit(r.RLIMIT_FSIZE, (n, n))"
    return [sys.executable, "-c", f"{code}; os.execv(sys.argv[2], sys.argv[2:])", str(file_size)]


# -- signals -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "code", "more"),
    [
        (signal.SIGINT, 130, ()),
        pytest.param(signal.SIGHUP, 129, ("--realtime",), marks=pytest.mark.slow),
        pytest.param(signal.SIGTERM, 143, (), marks=pytest.mark.slow),
        pytest.param(signal.SIGTERM, 143, ("--realtime",), marks=pytest.mark.slow),
        pytest.param(signal.SIGHUP, 129, (), marks=pytest.mark.slow),
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
        world.process.send_signal(signal.SIGSTOP)
        device.until("samples on disk", lambda: size(Path("device.mcap")) > 5_000)
        asked = time.monotonic()
        device.process.send_signal(signal.SIGINT)
        device.until("no force", lambda: forces()[-1][2] == 0.0)
        device.process.send_signal(signal.SIGINT)
        code, _, stderr = device.end()
        assert time.monotonic() - asked < LINGER_S
    assert (code, stderr) == (130, "")
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
        return code, Path("stderr").read_text("utf-8")


@pytest.mark.parametrize(
    "role", ["device", pytest.param("world", marks=pytest.mark.slow), pytest.param("run", marks=pytest.mark.slow)]
)
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


# -- what cannot be written --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "file", ["/proc/no.mcap", *(pytest.param(file, marks=pytest.mark.slow) for file in ("driver.py/x.mcap", "."))]
)
def test_a_recording_that_cannot_be_written_is_refused_at_the_start(file: str) -> None:
    with started("world", "-l", free_address(), "--record", file) as program:
        code, stdout, stderr = program.end()
    assert (code, stdout) == (2, "")
    assert stderr.startswith(f"hapnet: cannot write recording {file}: ")
    assert stderr.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize("more", [(), ("--realtime",)], ids=["thread", "realtime"])
def test_a_full_disk_ends_recording_and_log_and_not_the_run(more: tuple[str, ...]) -> None:
    words = ("--record", "device.mcap", "--log", "device.jsonl", "--duration", 2, "--json", "-", *more)
    with pushing(*words, before=limited(10_000)) as (device, world):
        code, stdout, stderr = device.end()
        world.until_line("the device left")
    assert code == 3
    assert stderr.splitlines()[-1] == (
        "hapnet: cannot write recording device.mcap: File too large; the run goes on without a recording"
    )
    assert "Traceback" not in stderr
    assert json.loads(stdout)["duration_s"] >= 2.0
    assert assert_no_force_last() < notices(Path("world.jsonl"), "left")[0]["monotonic_ns"]
    torn = read_recording("device.mcap")
    assert torn.torn
    assert torn.device is not None
    assert notices(Path("device.jsonl"), "recording")


def test_what_is_missing_at_the_end_is_one_line_and_exit_code_3() -> None:
    """The directory of the recording and the summary is removed while the device runs."""
    Path("d").mkdir()
    with pushing("--record", "d/device.mcap", "--json", "d/s.json", "--duration", 1) as (device, _):
        device.until("samples on disk", lambda: size(Path("d/device.mcap")) > 1_000)
        shutil.rmtree("d")
        code, stdout, stderr = device.end()
    assert code == 3
    assert stderr == (
        "hapnet: cannot write recording d/device.mcap: it was removed; the run goes on without a recording; "
        "cannot write d/s.json: No such file or directory\n"
    )
    assert "without a recording" in stdout
    assert_no_force_last()


@pytest.mark.slow
def test_a_log_that_ends_early_is_exit_code_3() -> None:
    words = ("--log", "device.jsonl", "--duration", 0.5)
    with pushing(*words, before=limited(300)) as (device, _):
        code, stdout, stderr = device.end()
    assert (code, stderr) == (3, "hapnet: cannot write the log device.jsonl: File too large\n")
    assert "cannot write the log" in stdout
    assert_no_force_last()


@pytest.mark.slow
def test_a_run_without_room_for_its_files_says_so_in_one_line() -> None:
    """The limit holds for the children too; the summary, which needs no room, is whole."""
    with started(
        "run", *ARM, "--duration", 1, "--json", "-", "--out", "r", command=(*limited(12_000), *HAPNET)
    ) as program:
        code, stdout, stderr = program.end()
        assert not program.alive
    assert code == 3
    last = stderr.splitlines()[-1]
    for file in ("r/device.mcap", "r/report.html", "r/figure.png"):
        assert f"{file}: File too large" in last
    assert last.startswith("hapnet: ")
    assert stderr.count("hapnet: ") == 1
    assert "Traceback" not in stderr
    summary = json.loads(stdout)
    assert summary["device"]["ledger"]["margin_J"] > 0.0
    assert summary["world"]["ledger"]["margin_J"] > 0.0
    assert_no_force_last()
    for role in ("device", "world"):
        assert read_recording(f"r/{role}.mcap").meta["role"] == role


@linux
@pytest.mark.slow
def test_a_run_on_a_disk_that_is_really_full(here: Path) -> None:
    """A tmpfs of 48 KB in a mount namespace; what is on it at the end is copied out."""
    space = ["unshare", "-m"]
    mount = f"mount -t tmpfs -o size=48k none {here}/small"
    Path("small").mkdir()
    Path("out").mkdir()
    if shutil.which("unshare") is None or subprocess.run([*space, "sh", "-c", mount], capture_output=True).returncode:
        pytest.skip("no mount namespace can be made here (root only)")
    script = f'{mount} && "$@"; code=$?; cp small/* out; exit $code'
    argv = ("run", *ARM, "--duration", 4, "--json", "s.json", "--out", "small")
    with started(*argv, command=(*[*space, "sh", "-c", script, "sh"], *HAPNET)) as program:
        code, _, stderr = program.end()
    assert code == 3
    assert stderr.startswith("hapnet: cannot write recording small/")
    assert "No space left on device" in stderr
    assert stderr.count("\n") == 1
    assert read_json(Path("s.json"))["theorem"]["margin_J"] > 0.0
    for role in ("device", "world"):
        assert read_recording(f"out/{role}.mcap").meta["role"] == role
    assert_no_force_last()


def test_a_run_that_cannot_begin_to_write_is_refused() -> None:
    with started("run", "--out", "r", command=(*limited(0), *HAPNET)) as program:
        code, stdout, stderr = program.end()
    assert (code, stdout, stderr) == (2, "", "hapnet: cannot write to r: File too large\n")


# -- parts of the user's own, and those that die -----------------------------------------------------------------------

PARTS = """
import time
from hapnet.plant.operator import Sine
from hapnet.plant.worlds.scene import Scene

class Tired(Sine):
    def reference(self, t):
        if t > 0.3:
            raise ArithmeticError("no strength left")
        return super().reference(t)

class Endless(Scene):
    def next_step_s(self, rng):
        self.__dict__["left"] = self.__dict__.get("left", 60) - 1
        if self.left < 0:
            raise LookupError("out of steps")
        return super().next_step_s(rng)

def short(*, dof=1):
    from hapnet.plant.worlds.wall import wall
    made = wall(dof=dof)
    return Endless("short", dof, made.walls, 0.01, 0.02)
"""
TIRED = "hapnet: the operator parts:Tired failed: reference(0.301) raised ArithmeticError: no strength left\n"
SHORT = "hapnet: the scene parts:short failed: next_step_s() raised LookupError: out of steps\n"


@pytest.mark.parametrize(
    ("words", "says"),
    [
        pytest.param(("run", "--operator", "parts:Tired", "--out", "r"), TIRED, marks=pytest.mark.slow),
        (("run", "--scene", "parts:short", *ARM, "--out", "r", "--duration", "20"), SHORT),
        (("simulate", "--operator", "parts:Tired", "--no-files"), TIRED),
        (("simulate", "--scene", "parts:short", "--no-files"), SHORT),
        pytest.param(("run", "--realtime", "--operator", "parts:Tired", "--out", "r"), TIRED, marks=pytest.mark.slow),
    ],
    ids=["hand", "scene", "simulated hand", "simulated scene", "hand in the servo's process"],
)
def test_a_part_of_ones_own_that_raises_is_named_in_one_line(words: tuple[str, ...], says: str) -> None:
    Path("parts.py").write_text(PARTS, "utf-8")
    with started(*words) as program:
        code, stdout, stderr = program.end()
        assert not program.alive
    assert (code, stderr) == (2, says)
    assert "Traceback" not in stdout
    if words[0] == "run":
        assert read_recording("r/device.mcap").device is not None
    if ARM[0] in words:
        assert_no_force_last()


@linux
@pytest.mark.slow
@pytest.mark.parametrize("more", [(), ("--realtime",)], ids=["thread", "realtime"])
def test_the_children_of_a_run_that_is_killed_end_in_order(more: tuple[str, ...]) -> None:
    """They would hold the device for ever."""
    with started("run", *ARM, "--duration", 0, "--out", "r", *more) as program:
        program.until("a force", pressing)
        for role in ("device", "world"):
            child_of(program.process.pid, role)
        os.kill(program.process.pid, signal.SIGKILL)
        program.process.wait()
        program.until_gone(5.0)
    assert_no_force_last()
    for role in ("device", "world"):
        assert not read_recording(f"r/{role}.mcap").torn


@linux
@pytest.mark.slow
def test_the_children_of_a_run_that_is_killed_before_they_meet_end_too() -> None:
    with started("run", "--out", "r") as program:
        program.until("its directory", Path("r/log.jsonl").exists)
        program.until("a child", lambda: Path(f"/proc/{program.process.pid}/task/{program.process.pid}/children")
                      .read_text("ascii").count(" ") == 2)  # fmt: skip
        os.kill(program.process.pid, signal.SIGKILL)
        program.process.wait()
        program.until_gone()
