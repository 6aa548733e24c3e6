"""`hapnet transparency`, as a user types it."""

import json
from pathlib import Path

import pytest

from hapnet import cli


@pytest.mark.slow
def test_a_local_model_transmits_the_wall_up_to_20_hz_over_a_delay_and_a_wave_does_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--coupling", "pspm,wave", "--link", "far=delay 40ms", "--seeds", "0:1", "--out", str(tmp_path)]
    assert cli.main(["transparency", *words]) == 0
    (row,) = [line for line in capsys.readouterr().out.splitlines() if "pspm" in line]
    assert "above 20" in row
    found = json.loads((tmp_path / "transparency.json").read_text("utf-8"))["curves"]
    assert found[0]["off_3dB_hz"]["median"] is None
    assert found[1]["off_3dB_hz"]["median"] < 5.0  # a quarter period of a round trip of 80 ms is 3 Hz
    assert (tmp_path / "transparency.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--coupling", "best"], "--coupling is "),
        (["--set", "coupling=zoh"], "--set: coupling zoh: here --coupling sets it; leave it out"),
        (["--set", "link.up=4g"], "--set: link.up 4g: here --link sets it; leave it out"),
        (["--link", "moon"], "--link is "),
        (["--seeds", "3:3"], "--seeds is "),
        (["--motion", "along-z"], "--motion along-z: only a tool has it, as in --scene tool:box"),
        (["--scene", "tool:box", "--motion", "up"], "--motion is "),
        (["--scene", "tool:box", "--z-width"], "--z-width with tool:box: it needs a scene with a wall, not a tool"),
        (["--scene", "tool:box", "--coupling", "wave"], "--coupling is "),
    ],
)
def test_what_is_wrong_is_one_line(words: list[str], named: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["transparency", *words]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"hapnet: {named}")


@pytest.mark.slow
def test_a_tool_is_moved_and_turned_in_units_of_each(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--scene", "tool:box", "--coupling", "pspm", "--link", "lan", "--seeds", "0:1", "--motion", "about-y"]
    assert cli.main(["transparency", *words, "--out", str(tmp_path)]) == 0
    assert "Nm/rad" in capsys.readouterr().out
    (curve,) = json.loads((tmp_path / "transparency.json").read_text("utf-8"))["curves"]
    assert curve["motion"] == "about-y"
    assert len(curve["stiffness_Nm_per_rad"]) == len(curve["true_damping_Nms_per_rad"]) == len(curve["frequency_hz"])
    assert (tmp_path / "transparency-about-y.png").stat().st_size > 10_000
