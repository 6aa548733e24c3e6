"""The example that repeats the verdict: it agrees with the summary, and with no recording that was tampered with."""

import dataclasses
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from examples.verdict_of_recordings import judge
from hapnet.params import Params
from hapnet.recording.mcap import read_recording, save
from hapnet.recording.samples import Columns, Event, Recording
from hapnet.simulation.simulation import simulate
from tests.conftest import ENVIRONMENT, ROOT, mostly_slow
from tests.repository.test_examples import EXAMPLES, printed
from tests.support.commands import Capture
from tests.support.processes import read_json, started
from tests.support.scene_runs import words, write_files

PRINTED_J = 1e-9
"""To a nanojoule energies are printed."""

SLACK_J = 1e-12
LOSSY = "delay 40ms 10ms loss 2%"
BASE = Params().set({"operator": "press", "duration_s": 2.5, "record_hz": 1000.0, "link.up": LOSSY, "link.down": LOSSY})


def scene(name: str, files: Path) -> dict[str, Any]:
    """What to set for a scene of this name, with a hand that touches it."""
    if name == "wall":
        return {"scene": "wall"}
    if name == "mujoco":
        pytest.importorskip("mujoco", reason="MuJoCo is not installed: hapnet-haptics[mujoco]")
        from tests.support.mujoco_models import BLOCK, model

        return {"scene": model(files / "m.xml", BLOCK), "operator": "sine"}
    if name == "mesh":
        pytest.importorskip("igl", reason="libigl is not installed")
    return {"scene": words(name, write_files(files)), "dof": 3, "operator": "tests.support.scene_runs:Stroke"}


def reported(said: str) -> dict[str, list[float]]:
    """The least margins and slacks that were printed [J], by side."""
    lines = re.findall(r"^(device|world|both): margin (\S+) mJ(?: and slack (\S+) mJ)? at least", said, re.MULTILINE)
    return {side: [float(energy) / 1e3 for energy in energies if energy] for side, *energies in lines}


def agrees(verdict: str, said: str, summary: Any, device: Columns, world: Columns) -> None:
    """With a side's own account to within one tick's or step's work, which ends between two looks at the account."""
    found = reported(said)
    for side, columns in (("device", device), ("world", world)):
        margin, slack = found[side]
        ledger = summary[side]["ledger"]
        due = np.abs(np.diff(columns["work_J"], prepend=0.0)).max() + PRINTED_J
        assert ledger["margin_J"] - PRINTED_J <= margin <= ledger["margin_J"] + due
        assert slack == pytest.approx(ledger["slack_J"], abs=PRINTED_J)
        assert columns["margin_J"][-1] == pytest.approx(ledger["margin_end_J"], abs=SLACK_J)
        assert columns["work_J"][-1] == pytest.approx(ledger["work_J"], abs=SLACK_J)
    passive = summary["verdict"]["passive"]
    assert verdict.partition(":")[0] == ("passive" if passive else "not passive")


@pytest.mark.parametrize("servo", mostly_slow(["sampled", "continuous"], 1))
@pytest.mark.parametrize("name", mostly_slow(["wall", "sphere", "mujoco", "mesh"], 3))
def test_it_agrees_with_the_summary_of_a_simulation(name: str, servo: str, tmp_path: Path, capsys: Capture) -> None:
    result = simulate(BASE.set({**scene(name, tmp_path), "device.servo": servo}), seed=1)
    device, world = result.recording.device, result.recording.world
    assert device is not None
    save(result.recording, tmp_path / "run.mcap")
    verdict = judge([str(tmp_path / "run.mcap")])
    said = capsys.readouterr().out
    agrees(verdict, said, result.summary, device, world)
    assert verdict == "passive"
    [both] = reported(said)["both"]
    assert both == pytest.approx(result.summary["theorem"]["margin_J"], abs=2.0 * PRINTED_J)
    assert np.abs(world["work_J"]).max() > 1e-4  # it was touched


@pytest.mark.parametrize("servo", ["sampled", "continuous"])
def test_it_agrees_that_a_plain_coupling_is_not_passive(servo: str, tmp_path: Path, capsys: Capture) -> None:
    """With relaxed fingers, as in examples/link_study.py."""
    hand = {"operator_model.mass": 0.1, "operator_model.damping": 0.5, "operator_model.stiffness": 20.0}
    changes = {**hand, "link.up": "delay 60ms", "link.down": "delay 60ms", "coupling": "zoh", "rendering": "paper"}
    result = simulate(BASE.set({**changes, "device.servo": servo, "operator": "sine", "duration_s": 3.25}), seed=1)
    assert result.summary["verdict"]["passive"] is False
    save(result.recording, tmp_path / "run.mcap")
    assert judge([str(tmp_path / "run.mcap")]).startswith("not passive: ")
    [both] = reported(capsys.readouterr().out)["both"]
    assert both == pytest.approx(result.summary["theorem"]["margin_J"], abs=2.0 * PRINTED_J)


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("name", "servo"),
    mostly_slow([("mujoco", "continuous"), ("mesh", "sampled"), ("wall", "sampled"), ("mujoco", "sampled")], 0, 1),
)
def test_it_agrees_with_the_summary_of_two_processes(name: str, servo: str, tmp_path: Path) -> None:
    """Started as a user starts it. What a servo that is late adds to the summary's doubts is in no sample."""
    more = [f"--set={key}={value}" for key, value in scene(name, tmp_path).items()]
    out = tmp_path / "run"
    argv = [
        "run",
        *more,
        f"--set=device.servo={servo}",
        "--set=record_hz=1000",
        "--duration",
        3,
        "--seed",
        1,
        "--out",
        out,
    ]
    with started(*argv) as program:
        code, _, stderr = program.end()
    assert code == 0, stderr
    summary = read_json(out / "summary.json")
    files = [out / "device.mcap", out / "world.mcap"]
    command = [sys.executable, str(EXAMPLES["verdict_of_recordings"]), *map(str, files)]
    said = printed(command, tmp_path)
    verdict = said.splitlines()[-1]
    device, world = read_recording(files[0]).device, read_recording(files[1]).world
    assert device is not None
    assert world is not None
    if summary["verdict"]["passive"] is not None:
        agrees(verdict, said, summary, device, world)
    assert verdict == "passive"
    [both] = reported(said)["both"]
    assert both == pytest.approx(sum(reported(said)[side][0] for side in ("device", "world")), abs=2.0 * PRINTED_J)


# -- tampered with -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def run() -> Recording:
    """Much is shuffled, at the default rate of samples."""
    changes = {"operator": "sine", "operator_model.frequency_hz": 1.5, "device.damping": 2.0, "rendering": "paper"}
    return simulate(BASE.set({**changes, "device.servo": "sampled", "record_hz": 200.0}), seed=1).recording


def spent(device: Columns, world: Columns) -> None:
    """Less work than there was, with all that follows from it."""
    middle = len(device["time_s"]) // 2
    for name in ("work_J", "margin_J", "slack_J"):
        device[name][middle:] -= 2.0


def claimed(device: Columns, world: Columns) -> None:
    more = 1e-6 + device["sent_J"][-1] - world["credited_J"][-1]
    for name in ("credited_J", "margin_J", "account_J"):
        world[name][-3:] += more


def early(device: Columns, world: Columns) -> None:
    """What was credited in all is as before, but it was there before it was sent."""
    more = world["credited_J"][-1] - world["credited_J"]
    for name in ("credited_J", "margin_J", "account_J"):
        world[name] += more


def praised(device: Columns, world: Columns) -> None:
    device["margin_J"] += 1e-6


def scaled(device: Columns, world: Columns) -> None:
    world["work_J"][-3:] += 1e-6


def hollow(device: Columns, world: Columns) -> None:
    """More in the reservoir than there can be."""
    for name, more in (("account_J", 1e-3), ("slack_J", -1e-3)):
        world[name] += more


def missing(device: Columns, world: Columns) -> None:
    device["work_J"][7] = np.nan


def owed(device: Columns, world: Columns) -> None:
    device["deficit_J"][-1] = 1e-6


@pytest.mark.parametrize(
    ("tamper", "says"),
    mostly_slow(
        [
            (spent, "not passive: the device's half of the theorem fails; more came out than d2"),
            (hollow, "not passive: the world's half of the theorem fails"),
            (claimed, "not known: the world credited what the device had not sent"),
            (early, "not known: the world credited what the device had not sent"),
            (praised, "not known: the device's account is not what was recorded of it, or was not recorded"),
            (scaled, "not known: the world's account is not what was recorded of it, or was not recorded"),
            (missing, "not known: the device's account is not what was recorded of it, or was not recorded"),
            (owed, "not known: the device gave out what its reservoir did not have"),
        ],
        2,
    ),
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_it_disagrees_with_what_was_tampered_with(
    run: Recording, tamper: Callable[[Columns, Columns], None], says: str, tmp_path: Path
) -> None:
    """In one file, and in two of one clock, where both ports are the sum of their halves."""
    device, world = ({name: column.copy() for name, column in side.items()} for side in (run.device, run.world))
    assert run.device["sent_J"][-1] > 1e-3
    assert run.world["credited_J"][-1] > 1e-3
    for changed, expected in ((False, "passive"), (True, says)):
        if changed:
            tamper(device, world)
        files = [str(tmp_path / f"{name}.mcap") for name in ("run", "device", "world")]
        for file, sides in zip(files, ((device, world), (device, None), (None, world)), strict=True):
            save(dataclasses.replace(run, device=sides[0], world=sides[1]), file)
        assert judge(files[:1]) == judge(files[1:]) == judge(files[:0:-1]) == expected


def test_of_two_hosts_only_what_was_credited_in_all_can_be_compared(run: Recording, tmp_path: Path) -> None:
    assert run.device is not None
    world = {name: column.copy() for name, column in run.world.items()}
    files = [str(tmp_path / f"{name}.mcap") for name in ("device", "world")]
    save(dataclasses.replace(run, world=None), files[0])
    for tamper, says in ((early, "passive"), (claimed, "not known: the world credited what the device had not sent")):
        tamper(run.device, world)
        save(dataclasses.replace(run, device=None, world=world, meta={**run.meta, "clock": "another"}), files[1])
        assert judge(files) == says


def test_what_is_torn_old_of_one_side_or_of_a_side_that_began_anew_is_not_known(run: Recording, tmp_path: Path) -> None:
    assert judge([str(ROOT / "tests" / "data" / "recording-0.1.0.mcap")]).startswith("not known: the device's account")
    file = tmp_path / "run.mcap"
    save(dataclasses.replace(run, world=None), file)
    assert judge([str(file)]) == "not known: recordings of both sides are needed"
    paired = Event(int(run.meta["origin_ns"]), "paired", "paired with the device")
    for times, says in ((1, "passive"), (2, "not known: a side was restarted")):
        save(dataclasses.replace(run, events=[paired] * times), file)
        assert judge([str(file)]) == says
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 2 // 3])
    assert judge([str(file)]).startswith("not known: a recording is incomplete")


@pytest.mark.parametrize("content", [None, "Dear Sir or Madam"])
def test_a_file_that_is_not_there_or_no_recording_is_named_in_one_line(content: str | None, tmp_path: Path) -> None:
    file = tmp_path / "letter.mcap"
    if content is not None:
        file.write_text(content, "utf-8")
    command = [sys.executable, EXAMPLES["verdict_of_recordings"], file]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert str(file) in done.stderr
    assert "Traceback" not in done.stderr
