"""The command that replays: its output, and what it refuses."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import pytest

from hapnet.errors import HapnetError
from hapnet.params import Params
from hapnet.plant.operator import Impedance
from hapnet.recording.hand import recorded_hand
from hapnet.recording.mcap import read_recording, save
from hapnet.recording.samples import Recording
from hapnet.simulation.replay import read_original
from tests.conftest import mostly_slow
from tests.support.replays import Capture, here as here, recorded, rewritten, run, with_meta


@pytest.mark.slow
def test_the_command_writes_all_and_compares_in_words(tmp_path: Path, capsys: Capture) -> None:
    recorded(tmp_path / "a.mcap")
    assert run("replay", "a.mcap", "--out", "again") == 0
    out, err = capsys.readouterr()
    assert not err
    assert out.splitlines()[1:] == [
        "The replay is identical to the original: every value of every sample that both have. "
        "More: -v, or hapnet report again/run.mcap"
    ]
    assert run("replay", "a.mcap", "--out", "again", "-v") == 0
    out, _ = capsys.readouterr()
    assert "hand: press, generated again from its parameters" in out
    assert "identical to the original" in out
    assert "original   replay" in out
    files = {path.name for path in (tmp_path / "again").iterdir()}
    assert files == {"run.mcap", "figure.png", "replay.png", "summary.json"}
    assert run("replay", "again/run.mcap", "--coupling", "zoh", "--delay", "150ms", "--out", "other") == 0
    out, _ = capsys.readouterr()
    assert "differs from the original: the device by" in out
    summary = json.loads((tmp_path / "other" / "summary.json").read_text("utf-8"))
    assert summary["coupling"] == "zoh"
    assert summary["links"]["up"]["profile"].startswith("delay 150ms")
    assert summary["replay"]["of"] == ["again/run.mcap"]
    assert summary["replay"]["identical"] is False
    assert summary["replay"].keys() >= {"hand", "max_position_difference_m", "rms_position_difference_m"}
    assert summary["replay"]["original"].keys() == summary["replay"]["replay"].keys()
    kept = read_recording(tmp_path / "other" / "run.mcap").summary
    assert kept["replay"] == summary["replay"]
    assert kept["motion"] == summary["motion"]


def test_a_recording_is_an_operator_everywhere(tmp_path: Path) -> None:
    recorded(tmp_path / "a.mcap")
    assert run("simulate", "--operator", "a.mcap", "--duration", "1", "--out", "b") == 0
    first, second = read_recording("a.mcap").device, read_recording("b/run.mcap").device
    n = len(second["time_ns"])
    assert second["operator_target_m"] == pytest.approx(first["operator_target_m"][:n], abs=1e-12)
    hand = recorded_hand("a.mcap", 1, Impedance())
    assert hand.reference(5.0) == tuple(first["operator_target_m"][-1])


@pytest.mark.parametrize(
    ("argv", "reported"),
    mostly_slow(
        [
            (["replay", "nothing.mcap"], "cannot read recording nothing.mcap"),
            (["replay", "own_hand.py"], "own_hand.py is not a recording"),
            (["replay", "a.mcap", "a.mcap", "a.mcap"], "one recording, or the device's and the world's"),
            (["replay", "a.mcap", "a.mcap"], "one must hold a device's samples"),
            (["replay", "a.mcap", "--duration", "0"], "above 0 in virtual time"),
            (["replay", "a.mcap", "--delay", "soon"], "soon"),
            (["replay", "a.mcap", "--set", "hardware=mine:Device"], "a real device does not run in virtual time"),
            (["replay", "run.mcap", "--out", "."], "a directory other than the recording's"),
            (["replay", "bare.mcap"], "does not contain the parameters of its run"),
            (["simulate", "--operator", "a.mcap", "--dof", "2", "--scene", "free"], "a recording with 2 axes"),
            (["simulate", "--operator", "nothing.mcap"], "cannot read recording nothing.mcap"),
            (["simulate", "--operator", "empty.mcap"], "a recording with the device's side"),
        ],
        6,
    ),
    ids=lambda value: "-".join(value)[:40] if isinstance(value, list) else "",
)
def test_what_cannot_be_replayed_is_told_in_one_line(
    tmp_path: Path, argv: list[str], reported: str, capsys: Capture
) -> None:
    recorded(tmp_path / "a.mcap", duration_s=0.2)
    save(read_recording("a.mcap"), "run.mcap")
    rewritten(tmp_path / "a.mcap", lambda whole: with_meta(whole, params=None), "bare.mcap")
    rewritten(tmp_path / "a.mcap", lambda whole: dataclasses.replace(whole, device=None), "empty.mcap")
    before = (tmp_path / "run.mcap").read_bytes()
    assert run(*argv) == 2
    _, err = capsys.readouterr()
    assert err.startswith("hapnet: ")
    assert reported in err
    assert len(err.splitlines()) == 1
    assert (tmp_path / "run.mcap").read_bytes() == before


@pytest.mark.parametrize(
    ("meta", "reported"),
    [
        ({"seed": "one"}, "seed of the recording"),
        ({"seed": None}, "seed of the recording"),
        ({"params": [1]}, "does not contain the parameters of its run"),
        ({"params": {"duration_s": "long"}}, "duration_s"),
        ({"params": {"device": {"servo_hz": -1.0}}}, "device.servo_hz"),
        ({"params": {"coupling": "glue"}}, "coupling"),
    ],
)
def test_settings_that_are_none_are_told_in_one_line(tmp_path: Path, meta: dict[str, Any], reported: str) -> None:
    recorded(tmp_path / "a.mcap", duration_s=0.2)
    rewritten(tmp_path / "a.mcap", lambda whole: with_meta(whole, **meta), "b.mcap")
    with pytest.raises(HapnetError, match=reported) as info:
        read_original([tmp_path / "b.mcap"])
    assert "\n" not in str(info.value)


@pytest.mark.parametrize("summary", [{"a": 1}, {"device": 7, "world": None, "theorem": {"margin_J": 0.0}}, [1]])
def test_a_summary_that_does_not_fit_is_told_in_one_line(tmp_path: Path, summary: Any) -> None:
    recorded(tmp_path / "a.mcap", duration_s=0.2)
    rewritten(tmp_path / "a.mcap", lambda whole: dataclasses.replace(whole, summary=summary), "b.mcap")
    with pytest.raises(HapnetError, match="summary does not fit"):
        read_original([tmp_path / "b.mcap"])


def test_settings_of_another_version_are_told(tmp_path: Path) -> None:
    recorded(tmp_path / "a.mcap", duration_s=0.2)

    def newer(recording: Recording) -> Recording:
        params = {**recording.meta["params"], "device": {"new": 3, "servo_hz": 1000.0}, "texture": "soft"}
        return with_meta(recording, params=params)

    original = read_original([rewritten(tmp_path / "a.mcap", newer, "new.mcap")])
    assert original.notes == ("this version does not have these parameters and leaves them out: device.new, texture",)
    assert original.params.device == Params().device
