"""A side's host asleep: its processes stopped for a while, then woken as if nothing had been."""

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from hapnet.recording.mcap import read_recording
from hapnet.wire.messages import Role
from tests.conftest import mostly_slow
from tests.faults.invariants import NANO, assert_pair_kept_the_rules, columns_of
from tests.faults.support import RECOVERY_S, Pair, asleep, let_pass, pair
from tests.support.processes import child_of

LINK = ("--delay", "20ms", "--jitter", "5ms", "--loss", "1%")
ROUND_TRIP_S = 0.05
SILENCE = ("--on-silence", "release", "--silence-after", 0.3)
BEFORE_S = 0.7
BLOCKED_NS = 1_000_000_000
"""A control that pauses for longer was stopped, or waited for something that it must not wait for."""


@pytest.mark.parametrize("asleep_s", mostly_slow([1.5, 5.0], 0, 1))
def test_each_host_asleep(asleep_s: float, tmp_path: Path) -> None:
    """The device's, then the world's."""
    with pair(tmp_path, *LINK, *SILENCE, device=("--set", "record_hz=1000")) as sides:
        sides.until_paired()
        roles: tuple[Role, ...] = ("device", "world")
        recoveries_s = [sleep(sides, [sides.lives[role][0].process.pid], asleep_s) for role in roles]
        sides.stop()
    print("recovery", recoveries_s)
    assert_went_on(sides, sleeps=1, device_slept=True)


@pytest.mark.parametrize(
    "stopped",
    [
        pytest.param("parent", marks=pytest.mark.soak),
        pytest.param("servo", marks=pytest.mark.soak),
        pytest.param("both", marks=pytest.mark.slow),
    ],
)
def test_a_servo_in_a_process_of_its_own(stopped: str, tmp_path: Path) -> None:
    """Its parent stops, which holds the network; or it does; or both."""
    with pair(tmp_path, *LINK, *SILENCE, device=("--realtime", "--set", "record_hz=1000")) as sides:
        sides.until_paired()
        parent = sides.device.process.pid
        servo = child_of(parent, "hapnet.realtime.servo_child")
        processes = {"parent": [parent], "servo": [servo], "both": [parent, servo]}[stopped]
        deaf: tuple[Role, ...] = ("world",) if stopped == "servo" else ("device", "world")
        recovery_s = sleep(sides, processes, 5.0, deaf)
        sides.stop()
    print("recovery", recovery_s)
    assert_went_on(sides, sleeps=0, device_slept=stopped != "parent")


def sleep(sides: Pair, processes: Sequence[int], seconds: float, deaf: Sequence[Role] = ("device", "world")) -> float:
    """Let these processes sleep, and the sides that are deaf meanwhile hear again; how long they took [s]."""
    both = [sides.lives[role][0] for role in deaf]
    let_pass(BEFORE_S)
    with asleep(*processes):
        let_pass(seconds)
        awake_ns = time.monotonic_ns()
    for side in both:
        side.until_said("heard", awake_ns)
    let_pass(BEFORE_S)
    recovery_s = (
        max(notice["monotonic_ns"] - awake_ns for side in both for notice in side.said("heard", awake_ns)) * NANO
    )
    assert recovery_s < RECOVERY_S + ROUND_TRIP_S
    return float(recovery_s)


def assert_went_on(sides: Pair, *, sleeps: int, device_slept: bool) -> None:
    """Everything holds; and but for its own sleep no side paused.

    sleeps : how often the world's process slept. device_slept : whether the servo did; else its samples are missing,
    as the process that writes them slept.
    """
    summary = sides.accounts()
    device, world = (read_recording(side.recording) for side in (sides.device, sides.world))
    assert_pair_kept_the_rules(device, world, gaps=not device_slept)
    a, b = columns_of(device), columns_of(world)
    assert summary["device"]["incarnations"] == summary["world"]["incarnations"] == 1
    assert (np.diff(b["time_ns"]) > BLOCKED_NS).sum() == sleeps
    if device_slept:
        assert (np.diff(a["time_ns"]) > BLOCKED_NS).sum() == 1
        assert summary["device"]["servo"]["overruns"] >= 1
    else:
        assert summary["device"]["servo"]["longest_ms"] < BLOCKED_NS * 1e-6
    for side in (sides.device, sides.world):
        assert len(side.said("heard")) == side.summary[side.role]["outages"]["count"]
