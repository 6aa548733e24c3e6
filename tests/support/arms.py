"""A device that keeps the forces that it got, and processes that drive it."""

import contextlib
import json
import signal
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from hapnet.transport.config import free_address
from tests.support.processes import HAPNET, Program, started

linux = pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
DRIVER = """
import mmap, time

class Arm:
    '''Held 30 mm inside; every force that it gets is a line: monotonic and wall clock [ns], the force [N].'''

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
ARM = ("--device", "driver:Arm", "--set", "device.self_test_N=0")  # it stands still, whatever pushes it


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
    """The forces that the arm got: monotonic [ns], wall clock [ns], the largest component [N]."""
    lines = Path("diary").read_bytes().rstrip(b"\0").decode("ascii").splitlines()
    return [(int(mono), int(wall), float(force)) for mono, wall, force in map(str.split, lines)]


def pressing() -> bool:
    return any(force > 0.3 for _, _, force in forces()[-5:])


def assert_no_force_last() -> int:
    """The arm pushed, and the last force that it got was zero; when, on the monotonic clock [ns]."""
    reported = forces()
    assert max(force for _, _, force in reported) > 0.3
    assert reported[-1][2] == 0.0
    assert any(
        force > 0.0 for _, _, force in reported[-50:-1]
    )  # it pushed to the end, but for ticks that came too late
    return reported[-1][0]


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
