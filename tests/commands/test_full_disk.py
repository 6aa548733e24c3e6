"""Recordings and logs that cannot be written: the run goes on, and its exit code says so."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from hapnet.recording.mcap import read_recording
from hapnet.transport.config import free_address
from tests.conftest import mostly_slow
from tests.support.arms import ARM, assert_no_force_last, heard as heard, here as here, limited, linux, notices, pushing
from tests.support.processes import HAPNET, LIMIT_S, read_json, size, started


@pytest.mark.parametrize(
    "file", ["/proc/no.mcap", *(pytest.param(file, marks=pytest.mark.slow) for file in ("driver.py/x.mcap", "."))]
)
def test_a_recording_that_cannot_be_written_is_refused_at_the_start(file: str) -> None:
    with started("world", "-l", free_address(), "--record", file) as program:
        code, stdout, stderr = program.end()
    assert (code, stdout) == (2, "")
    assert stderr.startswith(f"hapnet: cannot write recording {file}: ")
    assert stderr.count("\n") == 1


SUMMARY = ("simulate", "--duration", "0.3", "--no-files")


@linux
@pytest.mark.slow
@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize(
    ("argv", "code"),
    [
        (("--help",), 3),
        (("--version",), 3),
        (("simulate", "--show-params"), 3),
        ((*SUMMARY, "--json", "-"), 3),
        (SUMMARY, 0),
        (("devices",), 0),
    ],
)
def test_standard_output_that_takes_nothing_is_named(argv: tuple[str, ...], code: int, closed: bool) -> None:
    """A full disk, or nothing at all: what was asked for is missing, text for people is not."""
    shell = ["sh", "-c", f'exec "$@" {">&-" if closed else ">/dev/full"}', "sh"]
    ended = subprocess.run([*shell, *HAPNET, *argv], stderr=subprocess.PIPE, text=True, timeout=LIMIT_S)
    why = "Bad file descriptor" if closed else "No space left on device"
    said = [line for line in ended.stderr.splitlines() if line.startswith("hapnet: ")]
    assert (ended.returncode, said) == (code, [f"hapnet: cannot write standard output: {why}"] * bool(code))
    assert "Traceback" not in ended.stderr


@pytest.mark.slow
@pytest.mark.parametrize("more", mostly_slow([(("--realtime",),), ((),)], 0, 1), ids=["realtime", "thread"])
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


@pytest.mark.slow
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
    words = ("--log", "device.jsonl", "--no-files", "--duration", 0.5)
    with pushing(*words, before=limited(300)) as (device, _):
        code, stdout, stderr = device.end()
    assert (code, stderr) == (3, "hapnet: cannot write the log device.jsonl: File too large\n")
    assert "cannot write the log" in stdout
    assert_no_force_last()


@pytest.mark.slow
def test_a_run_without_room_for_its_files_says_so_in_one_line() -> None:
    """The limit holds for the children too; the summary, which needs no room, is whole."""
    with started(
        "run", *ARM, "--duration", 1, "--json", "-", "--out", "r", command=(*limited(17_000), *HAPNET)
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
