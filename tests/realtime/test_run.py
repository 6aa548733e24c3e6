"""Real processes over Zenoh on loopback, as a user starts them."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from hapnet import cli
from hapnet.assembly import memory
from hapnet.recording.mcap import read_recording
from hapnet.transport.config import free_address
from tests.conftest import ENVIRONMENT, mostly_slow
from tests.support.processes import assert_accounts_agree, assert_passive, child_of, read_json, size, started


@pytest.mark.parametrize(
    "more", [(), pytest.param(("--realtime",), marks=pytest.mark.slow)], ids=["thread", "realtime"]
)
def test_the_main_job(more: tuple[str, ...], tmp_path: Path) -> None:
    """Both processes, the default link in both directions: passive, accounts agree, everything written reads back."""
    out = tmp_path / "run"
    with started("run", "--duration", 3, "--seed", 1, "--json", "-", "--out", out, *more) as program:
        code, stdout, stderr = program.end()
        assert not program.alive
    assert code == 0, stderr
    summary = json.loads(stdout)
    assert "\x1b" not in stderr
    assert "Traceback" not in stderr
    assert "left" not in stderr  # the verdict comes first
    assert_passive(summary)
    assert_accounts_agree(summary)
    assert summary["energy"]["up"]["sent_nJ"] > 0
    assert summary["seed"] == 1
    assert summary["duration_s"] == pytest.approx(3.0, abs=0.5)
    for way in ("up", "down"):
        link = summary["links"][way]
        assert link["profile"] == "delay 40ms 10ms loss 2%"
        assert 30.0 <= link["delay_p50_ms"] <= 50.0
        assert link["offered"] >= 50
        assert link["delivered"] + link["lost"] <= link["offered"]
    up = summary["links"]["up"]
    # at least 600 messages at 2 %: 12 expected, standard deviation 3.5; none lost has a chance of 5e-6
    assert up["offered"] >= 600
    assert 0 < up["lost"] < 0.06 * up["offered"]
    assert summary["motion"]["contacts"] >= 1
    assert summary["motion"]["peak_penetration_m"] > 0.0
    servo = summary["device"]["servo"]
    # the servo runs for the 3 s; the side ends up to 0.5 s after it, as above
    assert 2900 <= servo["ticks"] + servo["skipped"] <= 1000.0 * summary["duration_s"] + 100
    assert summary == read_json(out / "summary.json")
    assert {file.name for file in out.iterdir()} == {
        "device.mcap", "world.mcap", "report.html", "figure.png", "summary.json", "params.toml", "log.jsonl",
    }  # fmt: skip
    device, world = (read_recording(out / f"{side}.mcap") for side in ("device", "world"))
    assert not device.torn
    assert not world.torn
    assert device.device["time_s"][-1] == pytest.approx(3.0, abs=0.5)
    for way, receiver in (("down", device), ("up", world)):
        flow = summary["path"][way]
        assert flow == receiver.summary["path"][way]
        assert all(flow[name] is not None for name in ("arrived", "overtaken", "jitter_p50_ms", "age_p50_ms"))
    assert len(world.world["time_s"]) == pytest.approx(summary["world"]["step"]["count"], abs=2)
    assert (out / "figure.png").stat().st_size > 20_000

    with started("report", out / "device.mcap", out / "world.mcap", "--json", tmp_path / "r.json") as program:
        code, stdout, stderr = program.end()
    assert (code, stderr) == (0, "")
    assert "\x1b" not in stdout
    report = read_json(tmp_path / "r.json")
    for key in ("theorem", "device", "world", "energy", "links", "motion"):
        assert report[key] == summary[key]
    assert {file.name for file in out.glob("device-world*")} == {
        "device-world.html", "device-world.png", "device-world-link.png", "device-world-servo.png",
    }  # fmt: skip
    for way in ("up", "down"):
        link = summary["links"][way]
        assert sum(count for _, count in link["delay_histogram_ms"]) == link["delivered"]
        edges = [edge for edge, _ in link["delay_histogram_ms"]]
        assert 25.0 < edges[0] < edges[-1] < 55.0


@pytest.mark.slow
def test_energy_that_passes_through_the_link_is_judged_at_both_ports_at_once(tmp_path: Path) -> None:
    """A soft wall takes far more than d^2 out at the world's port, while far more comes in at the hand's."""
    out = tmp_path / "run"
    soft = {"world.wall.stiffness": 100, "world.wall.damping": 0, "operator_model.goal_m": 0.2}
    words = [word for name, value in soft.items() for word in ("--set", f"{name}={value}")]
    with started("run", "--coupling", "pd", *words, "--duration", 4, "--json", "-", "--out", out) as program:
        code, stdout, stderr = program.end()
    assert code == 0, stderr
    summary = json.loads(stdout)
    margins = [summary[side]["ledger"]["margin_J"] for side in ("device", "world")]
    assert sum(margins) < -0.02
    assert 0.0 <= summary["theorem"]["margin_J"] <= summary["theorem"]["bound_J"] == pytest.approx(0.15)
    files = [out / f"{side}.mcap" for side in ("device", "world")]
    for file in files:
        assert read_recording(file).meta["tuning"] == summary["tuning"] != {}
    for asked, line in (
        (files, "PASSIVE: gave out at most"),
        (files[:1], "PASSIVITY NOT KNOWN: this coupling is passive only at both ports together"),
    ):
        with started("report", *asked, "--json", tmp_path / "r.json") as program:
            code, stdout, stderr = program.end()
        assert (code, stderr) == (0, "")
        assert stdout.startswith(line)
        reported = read_json(tmp_path / "r.json")["theorem"]["margin_J"]
        assert reported == (summary["theorem"]["margin_J"] if len(asked) == 2 else None)


@pytest.mark.slow
@pytest.mark.parametrize("more", mostly_slow([(("--realtime",),), ((),)], 0, 1), ids=["realtime", "thread"])
def test_a_deadband_sends_less_and_shuffles_all_the_same_and_no_files_are_left(
    more: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(ENVIRONMENT, "TMPDIR", str(tmp_path))
    words = ("--duration", 3, "--seed", 1, "--deadband", 0.2, "--json", "-", "--no-files")
    with started("run", *words, *more) as program:
        code, stdout, stderr = program.end()
    assert code == 0, stderr
    assert list(tmp_path.iterdir()) == []
    summary = json.loads(stdout)
    assert_passive(summary)
    assert_accounts_agree(summary)
    assert summary["energy"]["up"]["credited_nJ"] > 0
    assert 20 < summary["world"]["received"] < 200  # of 600 and more
    assert summary["device"]["outages"]["count"] == summary["world"]["outages"]["count"] == 0


@pytest.mark.parametrize(
    ("number", "code", "more"),
    [
        pytest.param(signal.SIGINT, 130, (), marks=pytest.mark.soak),
        pytest.param(signal.SIGINT, 130, ("--realtime",), marks=pytest.mark.slow),
        pytest.param(signal.SIGTERM, 143, (), marks=pytest.mark.soak),
    ],
)
def test_a_signal_stops_a_run_cleanly(number: signal.Signals, code: int, more: tuple[str, ...], tmp_path: Path) -> None:
    out = tmp_path / "run"
    words = ("--duration", 60, "--operator", "sine", "--json", tmp_path / "s.json", "--out", out, *more)
    with started("run", "-v", *words) as program:
        program.until_line("device: paired")
        program.until("samples on disk", lambda: size(out / "device.mcap") > 20_000)
        program.process.send_signal(number)
        got, stdout, stderr = program.end()
        assert not program.alive
    assert got == code
    assert not stderr
    assert "PASSIVE" in stdout
    summary = read_json(tmp_path / "s.json")
    assert summary["energy"]["up"]["sent_nJ"] > 0
    assert_accounts_agree(summary)
    assert_passive(summary)
    for side in ("device", "world"):
        assert not read_recording(out / f"{side}.mcap").torn
    assert (out / "figure.png").exists()


def test_ctrl_c_while_the_processes_start_leaves_no_traceback(tmp_path: Path) -> None:
    """The terminal's Ctrl-C goes to the whole group: the children are still importing."""
    out = tmp_path / "run"
    with started("run", "--out", out) as program:
        program.until("its directory", (out / "params.toml").exists)
        os.killpg(program.process.pid, signal.SIGINT)
        code, stdout, stderr = program.end()
        assert not program.alive
    assert code == 130
    assert not stderr
    assert "stopped before both processes ran" in stdout


@pytest.mark.slow
def test_a_run_whose_child_is_killed_says_so(tmp_path: Path) -> None:
    """The other process is ended too, and what was recorded can be read."""
    out = tmp_path / "run"
    with started("run", "-v", "--duration", 60, "--out", out) as program:
        program.until_line("device: paired")
        program.until("samples on disk", lambda: size(out / "device.mcap") > 10_000)
        os.kill(child_of(program.process.pid, "device"), signal.SIGKILL)
        code, _, stderr = program.end()
        assert not program.alive
    assert code == 2
    assert stderr == "hapnet: the device process was killed by SIGKILL\n"
    torn = read_recording(out / "device.mcap")
    assert torn.torn
    assert torn.device is not None


DRIVER = """
from pathlib import Path

class Arm:
    force_limit, resolution = 2.0, 0.0

    def __init__(self, dof):
        self.dof, self.reads = dof, 0
        with Path("made").open("a") as log:
            log.write("once\\n")

    def read(self):
        self.reads += 1
        if self.reads > 100:
            raise OSError("unplugged")
        return (0.0,) * self.dof, (0.0,) * self.dof

    def apply(self, force):
        pass
"""
FAILED = "hapnet: the device driver:Arm failed: read() raised OSError: unplugged\n"


@pytest.mark.slow
def test_a_device_of_ones_own_is_made_once_and_named_when_it_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("driver.py").write_text(DRIVER, "utf-8")
    with started("run", "-v", "--device", "driver:Arm", "--out", "r") as program:
        code, stdout, stderr = program.end()
        assert not program.alive
    assert (code, stderr) == (2, FAILED)
    assert "warning" not in stdout
    assert Path("made").read_text("utf-8") == "once\n"


def test_a_device_that_fails_ends_its_side_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("driver.py").write_text(DRIVER, "utf-8")
    address = free_address()
    with (
        started("world", "-l", address),
        started("device", "-e", address, "--device", "driver:Arm") as device,
    ):
        code, _, stderr = device.end()
    assert (code, stderr) == (2, FAILED)


@pytest.mark.slow
def test_a_run_that_is_too_long_for_memory_has_its_summary_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its recordings stay; only what needs both of them in memory is missing."""
    monkeypatch.setattr(memory, "installed_bytes", lambda: 1e4)
    out = tmp_path / "run"
    assert cli.main(["run", "--duration", "1", "--out", str(out)]) == 3
    line = capsys.readouterr().err
    assert "no report: duration_s is" in line
    assert "this machine has 10 kB" in line
    summary = read_json(out / "summary.json")
    assert summary["verdict"]["passive"]
    assert summary["theorem"]["margin_J"] is not None
    assert {path.name for path in out.glob("*.mcap")} == {"device.mcap", "world.mcap"}


@pytest.mark.slow
@pytest.mark.parametrize("first", ["device", "world"])
def test_sides_start_in_either_order(first: str, tmp_path: Path) -> None:
    address = free_address()
    argv: dict[str, list[object]] = {"device": ["-e", address, "--operator", "sine"], "world": ["-l", address]}
    second = "world" if first == "device" else "device"

    def side(role: str) -> list[object]:
        return [role, *argv[role], "--duration", 0.5, "--loss", "2%", "--json", tmp_path / f"{role}.json"]

    with started(*side(first)) as early:
        early.until_line(f"waiting for the {second}: ")
        assert address in early.out[0]
        with started(*side(second)) as late:
            ends = [program.end() for program in (early, late)]
    for code, stdout, stderr in ends:
        assert (code, stderr) == (0, "")
        assert "\x1b" not in stdout
    assert f"paired with the {second}" in ends[0][1]
    assert f"paired with the {first}" in ends[1][1]
    device, world = (read_json(tmp_path / f"{role}.json") for role in ("device", "world"))
    assert device["links"]["up"]["profile"] == "loss 2%"
    assert device["device"]["sent_nJ"] == world["world"]["credited_nJ"] + device["energy"]["up"]["in_flight_nJ"]
    assert device["device"]["ledger"]["margin_J"] > 0.0
    assert world["world"]["ledger"]["margin_J"] > 0.0


@pytest.mark.slow
def test_a_killed_process_leaves_a_recording_that_report_repairs(tmp_path: Path) -> None:
    address, file = free_address(), tmp_path / "device.mcap"
    with (
        started("world", "-l", address) as world,
        started("device", "-e", address, "--record", file) as device,
    ):
        device.until("samples on disk", lambda: size(file) > 10_000)
        device.process.send_signal(signal.SIGKILL)
        device.end()
        world.process.send_signal(signal.SIGTERM)
        assert world.end()[0] == 143
    torn = read_recording(file)
    assert torn.torn
    before = file.read_bytes()
    with started("report", file, "--json", tmp_path / "r.json") as program:
        code, _, stderr = program.end()
    assert (code, stderr.count("\n")) == (3, 1)
    assert "device.mcap is incomplete: it ends at " in stderr
    assert file.read_bytes() == before
    copy = read_recording(tmp_path / "device.repaired.mcap")
    assert not copy.torn
    assert (copy.device["time_ns"] == torn.device["time_ns"]).all()
    report = read_json(tmp_path / "r.json")
    page = (tmp_path / "device.html").read_text("utf-8")
    assert "because the process that wrote it was killed or the file was cut off" in page
    assert "a repaired copy is device.repaired.mcap" in page
    assert "PASSIVITY NOT KNOWN: the device&#x27;s recording is incomplete" in page
    assert (tmp_path / "device.png").read_bytes().startswith(b"\x89PNG")
    assert report["device"]["ledger"]["margin_J"] == torn.device["margin_J"].min()
    assert report["world"] is None


@pytest.mark.slow
def test_the_recorded_hand_writes_on_paper(handwriting: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    argv = ["run", "--scene", "paper", "--operator", handwriting, "--json", "-", "--out", out]
    with started(*argv) as program:
        summary = program.summary()
    assert_passive(summary)
    assert_accounts_agree(summary)
    assert summary["motion"]["contacts"] >= 1
    recording = read_recording(out / "world.mcap")
    touching = recording.world["penetration_m"] > 0.0
    path = recording.world["position_m"][touching, :2]
    assert (path.max(axis=0) - path.min(axis=0)).min() > 0.005  # it wrote, in both directions of the surface


@pytest.mark.slow
def test_a_reader_that_leaves_early_does_not_end_the_run(tmp_path: Path) -> None:
    """`hapnet run | head -1`: no traceback, and everything is written."""
    command = [sys.executable, "-m", "hapnet", "run", "--duration", "1", "--out", str(tmp_path / "out")]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    child.stdout.readline()
    child.stdout.close()
    said = child.stderr.read()
    child.stderr.close()
    assert child.wait(timeout=60) == 0
    assert said == b""
    assert (tmp_path / "out" / "figure.png").exists()
