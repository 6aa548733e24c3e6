"""The command: what it prints, its JSON, and one line with exit code 2 for bad input."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from netem import PRESETS
from netem.cli import main


def test_profiles_lists_all(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["profiles"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1:]] == list(PRESETS)
    assert main(["profiles", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out) == dict(PRESETS)


def test_show_prints_the_profile_back_with_what_it_does(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", "latency 40ms 10ms loss 10%", "--seed", "3", "--count", "2000"]) == 0
    out = capsys.readouterr().out
    assert "delay 40ms 10ms loss 10%" in out
    assert "#" in out


def test_show_json_is_the_object_alone(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    words = ["show", "delay 40ms 10ms 50% distribution normal loss 10%", "--count", "20000"]
    assert main([*words, "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["offered"] == 20_000 == found["delivered"] + found["lost"]
    assert found["lost"] == pytest.approx(2000, abs=5 * (20_000 * 0.1 * 0.9) ** 0.5)
    assert found["delay_p50_ms"] == pytest.approx(40.0, rel=0.03)
    assert found["delay_std_ms"] == pytest.approx(10.0, rel=0.05)
    assert sum(found["counts"]) == found["delivered"]
    assert main([*words, "--json", str(tmp_path / "out.json")]) == 0
    assert json.loads((tmp_path / "out.json").read_text()) == found


def test_show_takes_a_preset_with_overrides(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", "--profile", "geo", "--delay", "300ms", "--loss", "0%", "--count", "10", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["profile"].startswith("delay 300ms 10ms")


def test_a_link_that_delivers_nothing_has_no_delays(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["show", "loss 100%", "--count", "10", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["delay_p50_ms"] is found["delay_std_ms"] is found["delay_correlation"] is None
    assert main(["show", "loss 100%", "--count", "10"]) == 0


@pytest.mark.parametrize("command", [[], ["--help"], ["show", "--help"], ["profiles", "--help"]])
def test_help(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(command) == 0
    assert "Usage: netem" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("command", "named"),
    [
        (["show", "dely 40ms"], "dely"),
        (["show", "--profile", "dialup"], "dialup"),
        (["show", "loss 1%", "--loss", "2%"], "not both"),
        (["show", "--interval", "5"], "interval"),
        (["show", "--count", "many"], "--count"),
        (["show", "--frequency", "5"], "--frequency"),
        (["show", "--count", "1", "--json", "/nowhere/at/all"], "/nowhere/at/all"),
        (["relay"], "relay"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    command: list[str], named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(command) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert named in captured.err
