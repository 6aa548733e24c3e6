"""What runs where Windows or macOS lack what Linux has: a device over the network of its maker's computer."""

import json
import signal
import sys
import time
from pathlib import Path

import pytest

from hapnet.errors import HapnetError
from hapnet.realtime.servo import require_fine_clock
from hapnet.transport.config import free_address
from tests.conftest import mostly_slow
from tests.support.processes import HAPNET, LIMIT_S, Program, assert_side_passive, started

ELSEWHERE = (sys.executable, "-m", "tests.support.elsewhere")
PLATFORMS = mostly_slow(["win32", "darwin"], 1)


@pytest.mark.parametrize("platform", PLATFORMS)
def test_every_module_can_be_imported(platform: str) -> None:
    with started(platform, "imports", command=ELSEWHERE) as program:
        code, out, err = program.end(LIMIT_S)
    assert (code, out.strip()) == (0, ""), out + err


@pytest.mark.parametrize("platform", PLATFORMS)
def test_a_device_there_and_its_world_here(platform: str, tmp_path: Path) -> None:
    """Both end on SIGTERM, in order, and each has the other's account."""
    address = free_address()
    sides: dict[str, Program] = {}
    for role, end, command in (("world", "-l", HAPNET), ("device", "-e", (*ELSEWHERE, platform))):
        files = ("--no-files", "--log", tmp_path / f"{role}.jsonl", "--json", tmp_path / f"{role}.json")
        sides[role] = Program(role, end, address, *files, command=command)
    try:
        for role, side in sides.items():
            log = tmp_path / f"{role}.jsonl"
            side.until("a pair", lambda log=log: log.exists() and '"paired"' in log.read_text("utf-8"))  # type: ignore[misc]
        time.sleep(0.5)  # control begins after the pairing
        for side in sides.values():
            side.process.send_signal(signal.SIGTERM)
        for side in sides.values():
            code, out, err = side.end()
            assert (code, err) == (128 + signal.SIGTERM, ""), out
    finally:
        for side in sides.values():
            side.kill()
    summary = json.loads((tmp_path / "device.json").read_text("utf-8"))
    assert summary["verdict"]["passive"] is True
    assert summary["device"]["servo"]["ticks"] > 0
    assert_side_passive(summary["device"])


def test_a_clock_that_is_too_coarse_for_a_servo_is_refused() -> None:
    """GetTickCount64, which is time.monotonic on Windows before Python 3.13."""
    require_fine_clock()
    with pytest.raises(HapnetError, match=r"steps of 15\.6 ms: on Windows take Python 3\.13 or later"):
        require_fine_clock(0.015625)
