"""Commands: their parameters, and what they print and write."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from hapnet import cli
from tests.conftest import ENVIRONMENT, mostly_slow
from tests.support.commands import QUICK, Capture, empty_directory as empty_directory, summary_of

NO_MORE = {"up_timeline": "", "down_timeline": "", "path_s": 0.0}


# What cannot be written: one line, exit code 3


def test_a_simulation_whose_files_cannot_be_written_is_shown_all_the_same(capsys: Capture) -> None:
    for name in ("run.mcap", "figure.png.part", "summary.json"):
        (Path("out") / name).mkdir(parents=True)  # in the way
    (Path("out") / "run.mcap" / "x").touch()
    assert cli.main(["simulate", "--duration", "0.2", "--out", "out", "--json", "s.json"]) == 3
    out, err = capsys.readouterr()
    assert "gave out at most" in out
    assert err == (
        "hapnet: cannot write recording out/run.mcap: Is a directory; "
        "cannot write figure out/figure.png: Is a directory; cannot write out/summary.json: Is a directory\n"
    )
    assert json.loads(Path("s.json").read_text("utf-8"))["theorem"]["margin_J"] > 0.0


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_summary_that_finds_no_room_is_exit_code_3(capsys: Capture) -> None:
    assert cli.main([*QUICK, "--json", "/dev/full"]) == 3
    assert (
        capsys.readouterr().err == "hapnet: cannot write /dev/full: No space left on device: the disk of /dev is full\n"
    )
    command = [sys.executable, "-m", "hapnet", *QUICK, "--json"]
    asked = ([*command, "-"], 3), ([*command, "s.json"], 0), ([*command[:4], "--show-params"], 3)
    with Path("/dev/full").open("w") as full:
        for argv, code in asked:  # words that nobody can read are no loss
            done = subprocess.run(argv, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60, env=ENVIRONMENT)
            assert done.returncode == code
            assert "Traceback" not in done.stderr
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run([*command, "-"], stdout=write, stderr=subprocess.PIPE, text=True, timeout=60, env=ENVIRONMENT)
    os.close(write)
    assert done.returncode == 3
    assert done.stderr.endswith("hapnet: cannot write standard output: Broken pipe\n")
    assert "Traceback" not in done.stderr


# Parameters


def shown_values(text: str) -> dict[str, Any]:
    """What `--show-params` printed, with the defaults that it comments out."""
    return tomllib.loads(re.sub(r"(?m)^# (?=\w+ = )", "", text))


def test_shown_parameters_read_back_the_same(capsys: Capture, tmp_path: Path) -> None:
    changes = ["--set", "world.wall.stiffness=30000", "--set", "device.stiffness=[[100,5],[5,80]]", "--scene", "free"]
    assert cli.main(["run", "--show-params", *changes, "--dof", "2", "--loss", "5%"]) == 0
    shown = capsys.readouterr().out
    table = tomllib.loads(shown)
    assert "damping" not in table["device"]  # nobody set it
    assert "\n# damping = 0.1 " in shown
    assert table["world"]["wall"]["stiffness"] == 30000
    assert table["device"]["stiffness"] == [[100, 5], [5, 80]]
    assert table["link"]["up"] == table["link"]["down"] == "delay 40ms 10ms loss 5%"
    file = tmp_path / "p.toml"
    file.write_text(shown, "utf-8")
    for command in ("run", "simulate", "device", "reproduce"):
        argv = [command, *(["fig5"] if command == "reproduce" else []), "--show-params", "--params", str(file)]
        assert cli.main(argv) == 0
        if command in ("run", "simulate"):  # the others set some parameters by themselves
            assert capsys.readouterr().out == shown.replace("set by: flag", "set by: file")


def test_the_schema_of_parameters_is_printed_and_asked_for_with_them(capsys: Capture) -> None:
    assert cli.main(["simulate", "--show-params", "--schema", "--dof", "2"]) == 0
    assert json.loads(capsys.readouterr().out)["properties"]["dof"]["default"] == 2
    assert cli.main(["simulate", "--schema"]) == 2
    assert capsys.readouterr().err == "hapnet: --schema alone: it needs --show-params\n"


def test_what_overrides_what(capsys: Capture, tmp_path: Path) -> None:
    """The file, then named options and link flags, then --set."""
    file = tmp_path / "p.toml"
    file.write_text('coupling = "zoh"\nduration_s = 3.0\nrecord_hz = 50.0\n', "utf-8")
    argv = ["run", "--show-params", "--params", str(file), "--duration", "4", "--set", "duration_s=5"]
    assert cli.main([*argv, "--uplink", "lan", "--link", "delay 7ms", "--dof", "0"]) == 0
    table = shown_values(capsys.readouterr().out)
    assert (table["coupling"], table["record_hz"], table["duration_s"]) == ("zoh", 50.0, 5.0)
    assert (table["link"]["up"], table["link"]["down"]) == ("lan", "delay 7ms")


def test_defaults_of_run_and_of_one_side(capsys: Capture) -> None:
    assert cli.main(["run", "--show-params"]) == 0
    table = shown_values(capsys.readouterr().out)
    assert (table["duration_s"], table["scene"], table["operator"]) == (10.0, "wall", "press")
    assert table["link"] == dict.fromkeys(("up", "down"), "delay 40ms 10ms loss 2%") | NO_MORE
    assert cli.main(["device", "--show-params"]) == 0
    table = shown_values(capsys.readouterr().out)
    assert table["link"] == {"up": "", "down": ""} | NO_MORE
    assert table["duration_s"] == 0.0


# What is written, and where


def test_silence_and_timelines_reach_the_side_they_are_for(capsys: Capture, tmp_path: Path) -> None:
    def shown(*argv: str) -> dict[str, Any]:
        assert cli.main([*argv, "--show-params"]) == 0
        return shown_values(capsys.readouterr().out)

    file = tmp_path / "line.txt"
    file.write_text("at 1s: down\nat 2.5s: up  # again\n", "utf-8")
    flags = ("--on-silence", "release", "--silence-after", "0.2", "--timeline", str(file))
    both, device, world = shown("run", *flags), shown("device", *flags), shown("world", *flags)
    for params, sides in ((both, ("device", "world")), (device, ("device",)), (world, ("world",))):
        for side in ("device", "world"):
            expected = ("release", 0.2) if side in sides else ("hold", 0.5)
            assert (params[side]["on_silence"], params[side]["silence_after_s"]) == expected
        assert params["link"]["up_timeline"] == params["link"]["down_timeline"] == "at 1s: down; at 2.5s: up"
    only = shown("simulate", "--timeline", "at 1s: down", "--up-timeline", "at 2s: up")
    assert (only["link"]["up_timeline"], only["link"]["down_timeline"]) == ("at 2s: up", "at 1s: down")


def test_a_deadband_is_a_flag_wherever_a_coupling_is_run(capsys: Capture) -> None:
    for command in ("run", "simulate", "device", "world", "play"):
        assert cli.main([command, "--deadband", "0.1", "--show-params"]) == 0
        assert shown_values(capsys.readouterr().out)["wire"]["deadband"] == 0.1
    assert cli.main(["simulate", "--deadband", "2"]) == 2
    assert "--deadband is 2" in capsys.readouterr().err


def test_json_on_standard_output_is_alone(capsys: Capture, empty_directory: Path) -> None:
    assert cli.main([*QUICK, "--json", "-", "--seed", "3"]) == 0
    out, err = capsys.readouterr()
    summary = json.loads(out)
    assert summary["seed"] == 3
    assert "gave out at most" in err
    assert not list(empty_directory.iterdir())


def test_json_in_a_file_leaves_words_on_standard_output(capsys: Capture) -> None:
    summary = summary_of(*QUICK)
    out, err = capsys.readouterr()
    assert summary["duration_s"] == 0.2
    assert "PASSIVE" in out
    assert "\x1b" not in out
    assert "\r" not in out
    assert not err


def test_a_seed_repeats_a_simulation() -> None:
    first, again, other = (summary_of(*QUICK, "--seed", seed) for seed in ("1", "1", "2"))
    for summary in (first, again, other):
        del summary["wall_clock"]
    assert first == again
    assert first["links"] != other["links"]


def test_set_and_link_flags_reach_the_simulation() -> None:
    summary = summary_of(*QUICK, "--uplink", "delay 3ms", "--downlink", "delay 9ms", "--coupling", "zoh")
    assert summary["links"]["up"]["profile"] == "delay 3ms"
    assert summary["links"]["up"]["delay_p50_ms"] == pytest.approx(3.0, abs=1e-6)
    assert summary["links"]["down"]["delay_p50_ms"] == pytest.approx(9.0, abs=1e-6)
    assert summary["coupling"] == "zoh"
    assert summary["device"]["reservoir_min_J"] is None


@pytest.mark.slow
def test_out_gets_everything_and_report_reads_it(tmp_path: Path, empty_directory: Path) -> None:
    out = tmp_path / "made" / "here"
    assert cli.main(["simulate", "--duration", "0.5", "--out", str(out)]) == 0
    assert {file.name for file in out.iterdir()} == {"run.mcap", "figure.png", "summary.json"}
    assert not list(empty_directory.iterdir())
    simulated = json.loads((out / "summary.json").read_text("utf-8"))
    reported = summary_of("report", str(out / "run.mcap"), "--out", str(out))
    assert {key: reported[key] for key in ("theorem", "device", "world", "links", "seed")} == {
        key: simulated[key] for key in ("theorem", "device", "world", "links", "seed")
    }
    assert (out / "run.png").stat().st_size > 10_000


@pytest.mark.slow
def test_two_lines_and_all_tables_on_demand(tmp_path: Path, capsys: Capture) -> None:
    short = ("--duration", "3", "--out", str(tmp_path))
    wall = "The wall of 3000 N/m felt like 514 of the 600 N/m that this device can render. More: -v, or "
    begin = ["PASSIVE: gave out at most ", wall]
    assert cli.main(["simulate", *short]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line[: len(start)] for line, start in zip(lines, begin, strict=True)] == begin
    assert cli.main(["report", str(tmp_path / "run.mcap")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line[: len(start)] for line, start in zip(lines, begin, strict=True)] == begin
    begin = ["PASSIVE: ", "tracking error (rms): ", "largest force: ", "wall: 3000 N/m, felt as 514.3 N/m ",
             "path: round trip ", "coupling pspm, "]  # fmt: skip
    for command in (["simulate", *short, "-v"], ["report", str(tmp_path / "run.mcap"), "--verbose"]):
        assert cli.main(command) == 0
        out = capsys.readouterr().out
        lines = out.splitlines()
        assert [line[: len(start)] for line, start in zip(lines, begin, strict=False)] == begin
        assert lines[-1].startswith("files: ")
        assert all(f"\n{title}" in out for title in ("both ports", "sides", "shuffled energy", "path, ", "motion"))
        assert "[J]" not in out


def test_default_directory_names_time_and_seed(empty_directory: Path) -> None:
    assert cli.main(["simulate", "--duration", "0.1", "--seed", "42"]) == 0
    (made,) = (empty_directory / "runs").iterdir()
    assert made.name.endswith("Z-42")


@pytest.mark.parametrize("figure", mostly_slow(["fig4", "fig5", "fig6"], 1))
def test_reproduce_says_that_numbers_are_reconstructed(figure: str, capsys: Capture, tmp_path: Path) -> None:
    assert cli.main(["reproduce", figure, "--duration", "1", "--out", str(tmp_path / "r"), "--json", "-"]) == 0
    out, err = capsys.readouterr()
    summary = json.loads(out)
    assert summary["reconstructed"] is True
    assert summary["theorem"]["margin_J"] >= 0
    assert "reconstructed" in err
    assert {file.name for file in (tmp_path / "r").iterdir()} == {f"{figure}.{end}" for end in ("png", "mcap", "json")}


def test_what_the_scene_does_not_read_is_refused(capsys: Capture) -> None:
    assert cli.main([*QUICK, "--scene", "free", "--set", "world.wall.stiffness=30000"]) == 2
    out, err = capsys.readouterr()
    said = "world.wall.stiffness 30000.0: the scene free does not read it; leave it out"
    assert (out, err) == ("", f"hapnet: --set: {said}\n")


def test_range_harvest_with_too_little_damping_is_warned_of_and_with_none_refused(capsys: Capture) -> None:
    argv = [*QUICK, "--servo", "sampled", "--set", "device.harvest=range", "--set"]
    assert cli.main([*argv, "device.own_damping=0.1"]) == 0
    assert "warning: the range harvest may not be passive" in capsys.readouterr().out
    assert cli.main([*argv, "device.own_damping=0"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "device.harvest is 'range'" in line


def test_what_the_link_loses_is_resent(capsys: Capture) -> None:
    """Half of all is lost at first, 1 of 2,048 after ten resends of a millisecond each."""
    link = ["--delay", "1ms", "--jitter", "0ms", "--loss", "50%", "--resend", "10 1ms"]
    assert cli.main(["simulate", "--duration", "1", "--no-files", *link, "--json", "-"]) == 0
    summary = json.loads(capsys.readouterr().out)
    for way in ("up", "down"):
        found = summary["links"][way]
        assert found["profile"] == "delay 1ms loss 50% resend 10 1ms"
        assert found["resent"] >= found["recovered"] > 20
        assert found["lost"] < 10
        assert found["delay_p99_ms"] <= 11.0
