"""The report of `hapnet doctor --share`: its contents, and that it names nobody."""

import getpass
import json
import platform
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet import cli
from hapnet.errors import InvalidParameter
from hapnet.ext.doctor import share
from hapnet.ext.doctor.machine import OK, WARNING, Check
from tests.support.processes import Emulator, started

GOOD: dict[str, Any] = {
    "exit_code": 0, "passive": True, "contacts": 3, "ticks": 9950, "skipped": 50, "silences": 0, "felt_N_m": 500.0,
    "peak_force_N": 2.0, "modulated_share": 0.0, "late_p99_us": 80.0,
}  # fmt: skip


@pytest.mark.parametrize(
    ("hardware", "driver"),
    [
        ("serial:/dev/ttyACM0,home=yes", "serial"), ("franka:192.168.0.7,speed=1", "franka"), ("3dmouse", "3dmouse"),
        ("my_lab.arm:Slider,gain=2", "own"),
    ],
)  # fmt: skip
def test_of_the_device_only_its_driver_is_named(hardware: str, driver: str) -> None:
    made = share.report(hardware, {"axes": 1}, [Check("watchdog", WARNING, "none", "see /home/me/x")], {"lan": GOOD})
    assert made["driver"] == driver
    text = json.dumps(made)
    for word in ("/dev", "192.168", "my_lab", "Slider", "/home", platform.node()):
        assert word not in text


@pytest.mark.parametrize(
    ("change", "finding"),
    [
        ({}, ""), ({"exit_code": 3}, "lan: the run ended with exit code 3"),
        ({"passive": None}, "lan: not shown to be passive"), ({"passive": False}, "lan: not shown to be passive"),
        ({"contacts": 0}, "lan: the wall was not touched"), ({"skipped": 101}, "lan: 101 of 10051 ticks skipped"),
        ({"silences": 2}, "lan: the device fell silent 2 times"),
    ],
)  # fmt: skip
def test_what_speaks_against_a_device(change: dict[str, Any], finding: str) -> None:
    checks = [Check("rate", OK, "1000 Hz"), Check("noise", WARNING, "much")]
    assert share.findings(checks, {"lan": GOOD | change}) == ["noise: much", *([finding] if finding else [])]


def test_of_a_run_the_ten_seconds_around_the_greatest_force_are_shown() -> None:
    """A push of 1 s along the second axis, at 30 s of 40: rows each 10 ms from 25 s on, in mm."""
    time_s = np.arange(0.0, 40.0, 0.001)
    push = np.where((time_s > 29.5) & (time_s < 30.5), np.cos(np.pi * (time_s - 30.0)), 0.0)
    force = np.stack([0.1 * push, -2.0 * push], axis=1)
    x = np.stack([time_s, 0.01 * push], axis=1)
    rows = {"time_ns": (time_s * 1e9).astype(np.int64), "force_N": force, "position_m": x, "set_position_m": 0.5 * x}
    part = {name: np.array(values) for name, values in share.shown(rows).items()}
    assert part["time_s"] == pytest.approx(np.arange(1000) / 100.0, abs=1.1e-3)
    there = np.cos(np.pi * (part["time_s"] - 5.0)) * (np.abs(part["time_s"] - 5.0) < 0.5)
    assert part["force_N"] == pytest.approx(-2.0 * there, abs=0.01)
    assert part["position_mm"] == pytest.approx(10.0 * there, abs=0.05)
    assert part["set_position_mm"] == pytest.approx(5.0 * there, abs=0.05)


@pytest.mark.parametrize(("limit", "push"), [(None, 0.3), (12.0, 0.3), (0.4, 0.2)])
def test_the_pushes_are_weak(limit: float | None, push: float) -> None:
    class Weak:
        force_limit = limit

    assert share.push_N(Weak()) == push  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--share"], "--share needs a device"), (["--duration", "5"], "--duration 5.0: it needs --share"),
        (["--device", "serial:/nowhere", "--share", "--duration", "2"], "--duration is 2.0; allowed: 3 to 600 s"),
        (["--device", "simulated", "--share"], "--device"),
    ],
)  # fmt: skip
def test_bad_flags_are_refused(
    words: list[str], says: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["doctor", *words]) == 2
    assert says in capsys.readouterr().err


def test_files_that_are_there_stay(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hapnet-serial.png").write_text("earlier")
    with pytest.raises(InvalidParameter, match=r"hapnet-serial\.png: this file exists: move it"):
        share.Files("serial:/dev/ttyACM0", tmp_path)
    assert (tmp_path / "hapnet-serial.png").read_text() == "earlier"


def test_a_picture_is_drawn_also_of_runs_that_failed(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    from hapnet.ext.pictures.shared_device import draw

    rows = {"time_ns": np.arange(0, 4 * 10**9, 10**6), "force_N": np.zeros((4000, 1))}
    rows |= {"position_m": np.zeros((4000, 1)), "set_position_m": np.zeros((4000, 1))}
    runs = {"lan": GOOD | {"shown": share.shown(rows)}, "4g": {"exit_code": 2}}
    files = share.Files("serial:/dev/ttyACM0", tmp_path)
    share.write(share.report("serial", {}, [Check("rate", OK, "1000 Hz")], runs), files, draw)
    assert files.picture.read_bytes().startswith(b"\x89PNG")
    assert json.loads(files.report.read_text("utf-8"))["findings"] == ["4g: the run ended with exit code 2"]


@pytest.mark.slow
def test_an_emulated_axis_is_measured_and_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is pushed, and touches the wall in both runs; the file has it all and names nobody, the picture is drawn."""
    monkeypatch.chdir(tmp_path)
    with Emulator("serial", tmp_path, more=("--operator", "press")) as emulator:
        with started("doctor", "--device", emulator.device, "--share", "--duration", 5) as program:
            code, stdout, stderr = program.end()
        assert code == 0, stderr
    text = (tmp_path / "hapnet-serial.json").read_text("utf-8")
    for word in (str(tmp_path), getpass.getuser() + "/", str(Path.home()), "/dev", emulator.device):
        assert word not in text
    made = json.loads(text)
    names = [check["name"] for check in made["checks"]]
    assert {"rate", "resolution", "velocity", "own damping", "force and motion"} <= set(names)
    assert len(set(names)) == len(names)
    for link in ("lan", "4g"):
        run = made["runs"][link]
        assert run["exit_code"] == 0
        assert run["passive"] is True
        assert run["contacts"] >= 1
        assert run["round_trip_p50_ms"] > (60.0 if link == "4g" else 0.0)  # twice 35 ms, less what is resent sooner
        force, x = (np.array(run["shown"][name]) for name in ("force_N", "position_mm"))
        assert 0.3 * run["peak_force_N"] < np.abs(force).max() <= 1.001 * run["peak_force_N"]  # each 10 ms a row
        assert x[np.argmax(np.abs(force))] > 20.0  # the wall is at 20 mm
    assert (tmp_path / "hapnet-serial.png").read_bytes().startswith(b"\x89PNG")
    assert "hapnet-serial.json and hapnet-serial.png hold no names" in stdout
