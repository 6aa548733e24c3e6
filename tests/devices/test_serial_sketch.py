"""The sketch in examples/serial_axis, compiled for this machine, and driven by the driver over a pseudo-terminal."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from hapnet.devices.serial_axis import SerialAxis
from hapnet.errors import DeviceSilent, HapnetError
from tests.conftest import ROOT
from tests.support.processes import until

SKETCH = ROOT / "examples" / "serial_axis" / "serial_axis.ino"

pytestmark = pytest.mark.skipif(shutil.which("g++") is None, reason="there is no C++ compiler")


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    program = tmp_path_factory.mktemp("sketch") / "board"
    flags = ["-std=c++17", "-O1", "-Wall", "-Wextra", f'-DSKETCH="{SKETCH}"']
    subprocess.run(["g++", *flags, ROOT / "tests" / "sketch" / "board.cpp", "-o", program], check=True)
    return program


@pytest.fixture
def axis(program: Path) -> Iterator[SerialAxis]:
    board, driver = os.openpty()
    for end in (board, driver):
        tty.setraw(end)
    process = subprocess.Popen([program], stdin=board, stdout=board)
    axis = SerialAxis(1, port=os.ttyname(driver))
    yield axis
    axis.close()
    process.kill()
    process.wait()
    os.close(board)
    os.close(driver)


def read(axis: SerialAxis) -> tuple[float, float]:
    """The next reading; on a busy machine a state may come late."""
    while True:
        try:
            (x,), (v,) = axis.read()
        except DeviceSilent:
            continue
        return x, v


def test_the_sketch_speaks_the_protocol(axis: SerialAxis) -> None:
    assert (axis.rate_hz, axis.force_limit, axis.dead_man) == (1000.0, 3.0, 0)
    with pytest.raises(HapnetError, match="home=yes"):
        axis.home()
    positions: list[float] = []

    def swung() -> bool:
        positions.append(read(axis)[0])
        return max(positions) - min(positions) > 0.015

    until(swung)
    assert max(map(abs, positions)) < 0.021  # 10 mm either way, from wherever it was when it started
    assert axis.buttons() == (False,)


def test_the_sketch_counts_the_force_that_acted_while_its_clock_wraps(axis: SerialAxis) -> None:
    """Its clock and its impulse wrap within the first second; the force that is told stays the one asked for."""
    reported = []
    start_s = time.monotonic()
    while time.monotonic() < start_s + 1.0:
        read(axis)
        axis.apply((1.5,))
        if (acted := axis.acted()) is not None:
            reported.append(acted[0])
    assert sorted(reported)[len(reported) // 2] == pytest.approx(1.5, rel=0.01)
    assert min(reported) >= -1e-6
    assert max(reported) <= 1.5 * 1.01


def test_the_sketch_limits_the_force_and_takes_it_away_by_itself(axis: SerialAxis) -> None:
    def acted() -> float:
        read(axis)
        found = axis.acted()
        return 0.0 if found is None else found[0]

    def pushed() -> bool:
        axis.apply((-10.0,))
        return acted() == pytest.approx(-3.0, rel=0.01)

    until(pushed)
    until(lambda: acted() == 0.0)  # nothing is sent any more
