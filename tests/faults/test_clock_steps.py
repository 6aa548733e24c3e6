"""Steps of the wall clock: nothing depends on it, in hapnet's code and in Zenoh's."""

import ast
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

import hapnet
import netem
from hapnet.recording.mcap import read_recording
from tests.conftest import mostly_slow
from tests.faults.invariants import assert_pair_kept_the_rules
from tests.faults.support import let_pass, pair

SHIM = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <sys/time.h>
#include <time.h>

/* The wall clock is an hour ahead and an hour behind in turn, ten milliseconds each; the monotonic one is as it is. */

typedef int (*read_clock)(clockid_t, struct timespec *);

int clock_gettime(clockid_t clock, struct timespec *at)
{
    static read_clock real;
    if (!real)
        real = (read_clock)dlsym(RTLD_NEXT, "clock_gettime");
    int result = real(clock, at);
    if (result == 0 && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) {
        struct timespec since;
        real(CLOCK_MONOTONIC, &since);
        at->tv_sec += since.tv_nsec / 10000000 % 2 ? 3600 : -3600;
    }
    return result;
}

int gettimeofday(struct timeval *restrict at, void *restrict zone)
{
    (void)zone;
    struct timespec now;
    int result = clock_gettime(CLOCK_REALTIME, &now);
    at->tv_sec = now.tv_sec;
    at->tv_usec = now.tv_nsec / 1000;
    return result;
}

time_t time(time_t *at)
{
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (at)
        *at = now.tv_sec;
    return now.tv_sec;
}
"""

BITES = """
import json, time, zenoh
config = zenoh.Config()
config.insert_json5("listen/endpoints", "[]")
config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
walls, stamps, steady = [], [], []
for _ in range(50):
    walls.append(time.time())
    stamps.append(session.new_timestamp().get_time().timestamp())
    steady.append(time.monotonic())
    time.sleep(0.003)
session.close()
print(json.dumps([max(walls) - min(walls), max(stamps), max(steady) - min(steady)]))
"""

WALL_CLOCKS = {"time", "time_ns", "now", "utcnow", "today", "localtime", "gmtime", "ctime", "strftime"}
MAY_READ_IT = {
    "hapnet/ext/bench/commands.py",  # names a directory
    "hapnet/commands/log.py",  # once, to say at what time of day something happened
    "hapnet/commands/pair.py",  # likewise, for a process that cannot say so itself
    "hapnet/commands/output.py",  # names a directory
    "hapnet/realtime/runner.py",  # once, so that a recording has UTC
    "hapnet/transport/ros2.py",  # stamps of messages to ROS, which are UTC
}


@pytest.fixture(scope="module")
def shim(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of a process whose wall clock is stepped a hundred times a second."""
    compiler = shutil.which("cc")
    if compiler is None or sys.platform != "linux":
        pytest.skip("the stepped clock is compiled with cc and preloaded, which needs a C compiler and Linux")
    directory = tmp_path_factory.mktemp("shim")
    source, library = directory / "clock.c", directory / "clock.so"
    source.write_text(SHIM, "ascii")
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl"], check=True)
    return {"LD_PRELOAD": str(library)}


def test_the_stepped_clock_bites(shim: dict[str, str]) -> None:
    """Python's wall clock jumps by two hours, Zenoh's stamps are an hour ahead; the monotonic clock is as it is."""
    done = subprocess.run(
        [sys.executable, "-c", BITES], env={**os.environ, **shim}, capture_output=True, text=True, check=True
    )
    wall_s, latest_stamp_s, steady_s = json.loads(done.stdout)
    assert wall_s == pytest.approx(7200.0, abs=5.0)
    assert latest_stamp_s - time.time() == pytest.approx(3600.0, abs=60.0)
    assert 0.0 < steady_s < 5.0


@pytest.mark.parametrize("seconds", mostly_slow([1.5, 10.0], 0, 1))
def test_a_run_does_not_notice(seconds: float, shim: dict[str, str], tmp_path: Path) -> None:
    link = ("--delay", "20ms", "--jitter", "5ms", "--loss", "1%")
    with pair(tmp_path, *link, device=("--set", "record_hz=1000"), env=shim) as sides:
        sides.until_paired()
        let_pass(seconds)
        sides.stop()
    summary = sides.accounts()
    assert_pair_kept_the_rules(*(read_recording(side.recording) for side in (sides.device, sides.world)))
    for role in ("device", "world"):
        assert summary[role]["outages"]["count"] == 0
        assert summary[role]["incarnations"] == 1
    assert 0.9 * seconds < summary["duration_s"] < seconds + 3.0
    for side in (sides.device, sides.world):
        times = [notice["monotonic_ns"] for notice in side.log]
        assert times == sorted(times)
        assert [notice["time"] for notice in side.log] == sorted(notice["time"] for notice in side.log)


def test_only_what_names_things_for_people_reads_the_wall_clock() -> None:
    readers = set()
    for package in (hapnet, netem):
        assert package.__file__ is not None
        root = Path(package.__file__).parent
        for file in root.rglob("*.py"):
            if any(reads_wall_clock(node) for node in ast.walk(ast.parse(file.read_text("utf-8")))):
                readers.add(str(file.relative_to(root.parent)))
    assert readers == MAY_READ_IT


def reads_wall_clock(node: ast.AST) -> bool:
    """Is it `time.time`, `datetime.now` and the like, or an import that would hide one?"""
    if isinstance(node, ast.Attribute):
        owner = node.value
        name = owner.id if isinstance(owner, ast.Name) else owner.attr if isinstance(owner, ast.Attribute) else ""
        return name in ("time", "datetime", "date") and node.attr in WALL_CLOCKS
    if isinstance(node, ast.ImportFrom):
        return node.module == "time" and any(alias.name in WALL_CLOCKS for alias in node.names)
    return False
