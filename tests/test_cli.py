from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tomllib
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

from hapnet import cli
from netem import cli as netem_cli
from tests.conftest import ENVIRONMENT

COMMANDS = (
    "run",
    "simulate",
    "device",
    "world",
    "compare",
    "sweep",
    "reproduce",
    "replay",
    "report",
    "bench",
    "doctor",
)
HEAVY = ("matplotlib", "zenoh", "mcap", "numpy", "msgpack", "asyncio")
QUICK = ("simulate", "--duration", "0.2", "--no-files")
NO_MORE = {"up_timeline": "", "down_timeline": "", "path_s": 0.0}
ADDRESS = "tcp/127.0.0.1:17447"

Capture = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def empty_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Every command runs in a directory of its own, where what it writes shows."""
    directory = tmp_path / "here"
    directory.mkdir()
    monkeypatch.chdir(directory)
    monkeypatch.setattr(sys, "path", list(sys.path))
    return directory


def python(code: str, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=30, env={**os.environ, **environment}
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def summary_of(*argv: str) -> dict[str, Any]:
    assert cli.main([*argv, "--json", "summary.json"]) == 0
    summary: dict[str, Any] = json.loads(Path("summary.json").read_text("utf-8"))
    return summary


# Help


@pytest.mark.parametrize("flag", ["--help", "-h"])
@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command: str, flag: str, capsys: Capture) -> None:
    assert cli.main([command, flag]) == 0
    out, err = capsys.readouterr()
    assert f"hapnet {command}" in out
    assert "--json" in out
    assert not err


def test_no_arguments_are_a_question_for_help(capsys: Capture) -> None:
    assert cli.main([]) == 0
    out, err = capsys.readouterr()
    assert all(command in out for command in COMMANDS)
    assert not err


@pytest.mark.parametrize("argv", [[], ["--help"], ["show", "--help"], ["profiles", "--help"]])
def test_netem_explains_itself(argv: list[str], capsys: Capture) -> None:
    assert netem_cli.main(argv) == 0
    out, err = capsys.readouterr()
    assert "Usage: netem" in out
    assert not err


@pytest.mark.parametrize("argv", [["--help"], ["--version"], *([command, "--help"] for command in COMMANDS)])
def test_help_loads_nothing_heavy(argv: list[str]) -> None:
    code = f"import sys\nfrom hapnet.cli import main\nmain({argv!r})\nprint(*sys.modules, file=sys.stdout)"
    loaded = set(python(code, COLUMNS="200").splitlines()[-1].split())
    assert "hapnet.cli" in loaded
    assert not loaded & set(HEAVY)


def test_help_in_a_pipe_has_no_escape_codes(capsys: Capture) -> None:
    assert cli.main(["run", "--help"]) == 0
    assert "\x1b" not in capsys.readouterr().out


def test_help_says_what_exit_codes_mean(capsys: Capture) -> None:
    assert cli.main(["--help"]) == 0
    words = " ".join(capsys.readouterr().out.split())
    assert "Exit codes: 0 all is well; 2 " in words
    assert "; 3 the run went to its end, but " in words
    assert "128 + N " in words


# Versions


@pytest.mark.parametrize(("program", "main"), [("hapnet", cli.main), ("netem", netem_cli.main)])
def test_versions_for_a_bug_report(program: str, main: Callable[[list[str]], int], capsys: Capture) -> None:
    assert main(["--version"]) == 0
    out, err = capsys.readouterr()
    first, *rest = out.splitlines()
    assert first == f"{program} {metadata.version('hapnet-haptics')}"
    told = dict(line.split(maxsplit=1) for line in rest)
    assert told["python"].startswith(platform.python_version())
    assert platform.release() in told["platform"]
    assert told["cpus"].startswith(str(os.cpu_count()))
    for package in ("numpy", "eclipse-zenoh", "msgpack", "typer", "rich", "mcap", "matplotlib"):
        assert told[package] == metadata.version(package)
    assert not err


def test_what_is_not_installed_is_said_to_be(capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    real = metadata.version

    def version(package: str) -> str:
        if package == "viser":
            raise metadata.PackageNotFoundError(package)
        return real(package)

    monkeypatch.setattr(metadata, "version", version)
    assert cli.main(["--version"]) == 0
    assert "\nviser          not installed\n" in capsys.readouterr().out


# Wrong words are answered with where to read on


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        (["nosuch"], "No such command 'nosuch'; see hapnet --help"),
        (["report"], "Missing argument 'FILE'; see hapnet report --help"),
        (["run", "more"], "Got unexpected extra argument(s) (more); see hapnet run --help"),
    ],
)
def test_wrong_words_are_answered_with_where_to_read_on(argv: list[str], says: str, capsys: Capture) -> None:
    assert cli.main(argv) == 2
    assert capsys.readouterr() == ("", f"hapnet: {says}\n")


def test_a_file_where_a_directory_is_wanted(capsys: Capture, tmp_path: Path) -> None:
    file = tmp_path / "letter"
    file.touch()
    assert cli.main(["simulate", "--duration", "0.1", "--out", str(file)]) == 2
    assert capsys.readouterr().err == f"hapnet: cannot write to {file}: it is a file, but --out must name a directory\n"


def test_completion_that_cannot_be_installed(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    monkeypatch.setenv("HOME", "/proc/no")
    monkeypatch.setattr("shellingham.detect_shell", lambda: ("bash", "/bin/bash"))
    assert cli.main(["--install-completion"]) == 2
    assert capsys.readouterr() == ("", "hapnet: /proc/no: No such file or directory\n")


# What cannot be written: one line, exit code 3


def test_a_simulation_whose_files_cannot_be_written_is_shown_all_the_same(capsys: Capture) -> None:
    for name in ("run.mcap", "figure.png.part", "summary.json"):
        (Path("out") / name).mkdir(parents=True)  # in the way
    (Path("out") / "run.mcap" / "x").touch()
    assert cli.main(["simulate", "--duration", "0.2", "--out", "out", "--json", "s.json"]) == 3
    out, err = capsys.readouterr()
    assert "margin" in out
    assert err == (
        "hapnet: cannot write recording out/run.mcap: Is a directory; "
        "cannot write figure out/figure.png: Is a directory; cannot write out/summary.json: Is a directory\n"
    )
    assert json.loads(Path("s.json").read_text("utf-8"))["theorem"]["margin_J"] > 0.0


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_summary_that_finds_no_room_is_exit_code_3(capsys: Capture) -> None:
    assert cli.main([*QUICK, "--json", "/dev/full"]) == 3
    assert capsys.readouterr().err == "hapnet: cannot write /dev/full: No space left on device\n"
    command = [sys.executable, "-m", "hapnet", *QUICK, "--json"]
    with Path("/dev/full").open("w") as full:
        for to, code in (("-", 3), ("s.json", 0)):  # words that nobody can read are no loss
            done = subprocess.run(
                [*command, to], stdout=full, stderr=subprocess.PIPE, text=True, timeout=30, env=ENVIRONMENT
            )
            assert done.returncode == code
            assert "Traceback" not in done.stderr
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run([*command, "-"], stdout=write, stderr=subprocess.PIPE, text=True, timeout=30, env=ENVIRONMENT)
    os.close(write)
    assert done.returncode == 3
    assert done.stderr.endswith("hapnet: cannot write standard output: Broken pipe\n")
    assert "Traceback" not in done.stderr


# Bad input: one line, exit code 2, nothing written


def bad(*argv: str, says: tuple[str, ...]) -> Any:
    return pytest.param(argv, says, id=" ".join(argv))


BAD = [
    bad("bogus", says=("bogus",)),
    bad("run", "--bogus", says=("--bogus",)),
    bad("reproduce", says=("figure",)),
    bad("report", says=("FILE",)),
    bad("run", "--duration", "soon", says=("--duration", "number")),
    bad("run", "--duration", "-1", says=("duration_s", "-1", "0 to 1e+09")),
    bad("simulate", "--duration", "0", says=("duration_s", "above 0")),
    bad(*QUICK, "--downlink", "loss 100%", says=("did not find each other", "loss 100%")),
    bad("run", "--duration", "nan", says=("duration_s", "nan")),
    bad("run", "--seed", "-1", says=("--seed", "0")),
    bad("run", "--seed", "1.5", says=("--seed",)),
    bad("run", "--profile", "nosuch", says=("nosuch", "lossy-wifi")),
    bad("run", "--resend", "3 8", says=("resend: '8'", "such as 40ms")),
    bad("run", "--link", "resend 3 8ms", "--resend", "2 8ms", says=("resend", "not both")),
    bad("run", "--link", "delay 40ms jiggle 3", says=("jiggle", "delay")),
    bad("run", "--uplink", "delay fast", says=("fast", "unit")),
    bad("run", "--downlink", "loss 200%", says=("200%", "100%")),
    bad("run", "--timeline", "at 3s down", says=("timeline", "at 3s down")),
    bad("run", "--set", "link.up_timeline=at 3s: sideways", says=("sideways",)),
    bad("device", "-e", ADDRESS, "--on-silence", "panic", says=("on_silence", "panic", "hold, release")),
    bad("world", "-l", ADDRESS, "--silence-after", "0", says=("silence_after_s", "above 0")),
    bad("device", "-e", ADDRESS, "--log", "/proc/no/log", says=("/proc/no/log",)),
    bad("device", "-e", ADDRESS, "--log", "-", "--json", "-", says=("--log", "--json has standard output")),
    bad("run", "--delay", "40", says=("40", "ms")),
    bad("run", "--link", "delay 1ms", "--profile", "wifi", says=("wifi", "not both")),
    bad("run", "--scene", "nosuch", says=("nosuch", "paper")),
    bad("run", "--scene", "no_such_module:Scene", says=("no_such_module",)),
    bad("run", "--operator", "nosuch", says=("nosuch", "press")),
    bad("run", "--operator", "nosuch.csv", says=("nosuch.csv", "CSV")),
    bad("run", "--coupling", "nosuch", says=("nosuch", "pspm, zoh")),
    bad("run", "--servo", "nosuch", says=("nosuch", "sampled")),
    bad("run", "--dof", "4", says=("dof", "4", "1, 2 or 3")),
    bad("reproduce", "fig7", says=("fig7", "fig4, fig5, fig6")),
    bad("run", "--set", "device.stifness=3", says=("device.stifness", "device.stiffness")),
    bad("run", "--set", "device.stiffness", says=("device.stiffness", "NAME=VALUE")),
    bad("run", "--set", "device.stiffness=hard", says=("hard", "number")),
    bad("run", "--set", "device.stiffness=[[1,0],[0,1]]", says=("stiffness", "1 x 1")),
    bad("run", "--scene", "free", "--dof", "2", "--set", "device.stiffness=[[1,2],[2,1]]", says=("positive definite",)),
    bad("run", "--scene", "free", "--dof", "2", "--set", "world.stiffness=[[1,2],[2,1]]", says=("positive definite",)),
    bad("run", "--set", "world.mass=-1", says=("world.mass", "-1")),
    bad("simulate", "--set", "hardware=mymodule:Arm", says=("hardware", "mymodule:Arm", "virtual time")),
    bad("run", "--device", "no_such_module:Arm", says=("hardware", "no_such_module:Arm", "ModuleNotFoundError")),
    bad("run", "--params", "nosuch.toml", says=("nosuch.toml",)),
    bad("run", "--json", "no/such/dir.json", says=("no/such/dir.json", "directory")),
    bad("run", "--json", "/", says=("--json", "/", "file")),
    bad("run", "--out", "/proc/no", says=("/proc/no",)),
    bad("simulate", "--out", "/proc/no", says=("/proc/no",)),
    bad("report", "nosuch.mcap", says=("nosuch.mcap",)),
    bad("report", "a.mcap", "b.mcap", "c.mcap", says=("c.mcap", "one recording")),
    bad("bench", "--only", "nosuch", says=("--only", "nosuch", "servo_idle")),
    bad("bench", "--rounds", "0", says=("--rounds", "0", "1 to 1000")),
    bad("bench", "--seconds", "nan", says=("--seconds", "nan")),
    bad("bench", "--beside", "many", says=("--beside", "integer")),
    bad("doctor", "-e", "127.0.0.1:17447", says=("127.0.0.1:17447", "tcp/127.0.0.1:17447")),
    bad("device", "-e", "127.0.0.1:17447", says=("127.0.0.1:17447", "tcp/127.0.0.1:17447")),
    bad("world", "-l", "tcp/127.0.0.1:99999", says=("tcp/127.0.0.1:99999",)),
    bad("device", "-m", "boss", "-e", ADDRESS, says=("boss", "client")),
    bad("device", "--no-multicast-scouting", says=("multicast scouting", "dial")),
    bad("device", "-e", ADDRESS, "--session", "a/b", says=("a/b",)),
    bad("device", "-e", ADDRESS, "--cfg", "nokey", says=("nokey", "KEY:JSON5")),
    bad("device", "-c", "nosuch.json5", says=("nosuch.json5",)),
    bad("device", "-e", ADDRESS, "--record", "/proc/no/x.mcap", says=("/proc/no/x.mcap",)),
    bad("device", "-e", ADDRESS, "--record", "x.mcap", "--operator", "nosuch", says=("nosuch", "press")),
]


@pytest.mark.parametrize(("argv", "says"), BAD)
def test_bad_input_is_one_line_and_exit_code_2(
    argv: tuple[str, ...], says: tuple[str, ...], capsys: Capture, empty_directory: Path
) -> None:
    assert cli.main(list(argv)) == 2
    out, err = capsys.readouterr()
    assert not out
    assert err.count("\n") == 1
    assert err.endswith("\n")
    assert err.startswith("hapnet: ")
    assert err.count("hapnet: ") == 1
    for words in says:
        assert words in err
    assert not list(empty_directory.iterdir())


def test_a_file_that_is_no_recording(capsys: Capture, tmp_path: Path) -> None:
    file = tmp_path / "letter.txt"
    file.write_text("Dear Sir or Madam,\n" * 50, "utf-8")
    assert cli.main(["report", str(file)]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "letter.txt is not a recording" in err
    assert list(tmp_path.glob("letter*")) == [file]


@pytest.mark.parametrize(
    ("text", "says"), [("x = = 3", "TOML"), ("nosuch = 3", "nosuch"), ("[device]\nmass = 'big'", "device.mass")]
)
def test_parameter_files_that_do_not_fit(text: str, says: str, capsys: Capture, tmp_path: Path) -> None:
    file = tmp_path / "bad.toml"
    file.write_text(text, "utf-8")
    assert cli.main(["run", "--params", str(file)]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert says in err


def test_a_recorded_hand_with_fewer_axes_than_the_scene(capsys: Capture, tmp_path: Path) -> None:
    hand = tmp_path / "hand.csv"
    hand.write_text("time_s,x_m\n" + "".join(f"{i / 100},{i / 1000}\n" for i in range(100)), "utf-8")
    assert cli.main(["simulate", "--scene", "free", "--dof", "3", "--operator", str(hand)]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "hand.csv" in err


# Parameters


def test_shown_parameters_read_back_the_same(capsys: Capture, tmp_path: Path) -> None:
    changes = ["--set", "world.wall.stiffness=30000", "--set", "device.stiffness=[[100,5],[5,80]]", "--scene", "free"]
    assert cli.main(["run", "--show-params", *changes, "--dof", "2", "--loss", "5%"]) == 0
    shown = capsys.readouterr().out
    table = tomllib.loads(shown)
    assert table["world"]["wall"]["stiffness"] == 30000
    assert table["device"]["stiffness"] == [[100, 5], [5, 80]]
    assert table["link"]["up"] == table["link"]["down"] == "delay 40ms 10ms loss 5%"
    file = tmp_path / "p.toml"
    file.write_text(shown, "utf-8")
    for command in ("run", "simulate", "device", "reproduce"):
        argv = [command, *(["fig5"] if command == "reproduce" else []), "--show-params", "--params", str(file)]
        assert cli.main(argv) == 0
        assert capsys.readouterr().out == shown


def test_the_schema_of_parameters_is_printed_and_asked_for_with_them(capsys: Capture) -> None:
    assert cli.main(["simulate", "--show-params", "--schema", "--dof", "2"]) == 0
    assert json.loads(capsys.readouterr().out)["properties"]["dof"]["default"] == 2
    assert cli.main(["simulate", "--schema"]) == 2
    assert capsys.readouterr().err == "hapnet: --schema is 'given alone'; allowed: with --show-params\n"


def test_what_overrides_what(capsys: Capture, tmp_path: Path) -> None:
    """The file, then named options and link flags, then --set."""
    file = tmp_path / "p.toml"
    file.write_text('coupling = "zoh"\nduration_s = 3.0\nrecord_hz = 50.0\n', "utf-8")
    argv = ["run", "--show-params", "--params", str(file), "--duration", "4", "--set", "duration_s=5"]
    assert cli.main([*argv, "--uplink", "lan", "--link", "delay 7ms", "--dof", "0"]) == 0
    table = tomllib.loads(capsys.readouterr().out)
    assert (table["coupling"], table["record_hz"], table["duration_s"]) == ("zoh", 50.0, 5.0)
    assert (table["link"]["up"], table["link"]["down"]) == ("lan", "delay 7ms")


def test_defaults_of_run_and_of_one_side(capsys: Capture) -> None:
    assert cli.main(["run", "--show-params"]) == 0
    table = tomllib.loads(capsys.readouterr().out)
    assert (table["duration_s"], table["scene"], table["operator"]) == (10.0, "wall", "press")
    assert table["link"] == dict.fromkeys(("up", "down"), "delay 40ms 10ms loss 2%") | NO_MORE
    assert cli.main(["device", "--show-params"]) == 0
    table = tomllib.loads(capsys.readouterr().out)
    assert table["link"] == {"up": "", "down": ""} | NO_MORE
    assert table["duration_s"] == 0.0


# What is written, and where


def test_silence_and_timelines_reach_the_side_they_are_for(capsys: Capture, tmp_path: Path) -> None:
    def shown(*argv: str) -> dict[str, Any]:
        assert cli.main([*argv, "--show-params"]) == 0
        return tomllib.loads(capsys.readouterr().out)

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
        assert tomllib.loads(capsys.readouterr().out)["wire"]["deadband"] == 0.1
    assert cli.main(["simulate", "--deadband", "2"]) == 2
    assert "wire.deadband is 2" in capsys.readouterr().err


def test_json_on_standard_output_is_alone(capsys: Capture, empty_directory: Path) -> None:
    assert cli.main([*QUICK, "--json", "-", "--seed", "3"]) == 0
    out, err = capsys.readouterr()
    summary = json.loads(out)
    assert summary["seed"] == 3
    assert "margin" in err
    assert not list(empty_directory.iterdir())


def test_json_in_a_file_leaves_words_on_standard_output(capsys: Capture) -> None:
    summary = summary_of(*QUICK)
    out, err = capsys.readouterr()
    assert summary["duration_s"] == 0.2
    assert "passive" in out
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


def test_five_lines_and_all_tables_on_demand(tmp_path: Path, capsys: Capture) -> None:
    short = ("--duration", "0.5", "--out", str(tmp_path))
    begin = ["passive: ", "tracking error (rms): ", "largest force: ", "path: round trip ", "files: "]
    assert cli.main(["simulate", *short]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line[: len(start)] for line, start in zip(lines, begin, strict=True)] == begin
    assert lines[-1].startswith(f"files: run.mcap, figure.png, summary.json in {tmp_path}; ")
    assert cli.main(["report", str(tmp_path / "run.mcap")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line[: len(start)] for line, start in zip(lines, begin, strict=True)] == begin
    for command in (["simulate", *short, "-v"], ["report", str(tmp_path / "run.mcap"), "--verbose"]):
        assert cli.main(command) == 0
        out = capsys.readouterr().out
        assert out.startswith("passive: ")
        assert all(f"\n{title}" in out for title in ("both ports", "sides", "shuffled energy", "path, ", "motion"))
        assert "[J]" not in out


def test_default_directory_names_time_and_seed(empty_directory: Path) -> None:
    assert cli.main(["simulate", "--duration", "0.1", "--seed", "42"]) == 0
    (made,) = (empty_directory / "runs").iterdir()
    assert made.name.endswith("Z-42")


@pytest.mark.parametrize("figure", ["fig4", "fig5", "fig6"])
def test_reproduce_says_that_numbers_are_reconstructed(figure: str, capsys: Capture, tmp_path: Path) -> None:
    assert cli.main(["reproduce", figure, "--duration", "1", "--out", str(tmp_path / "r"), "--json", "-"]) == 0
    out, err = capsys.readouterr()
    summary = json.loads(out)
    assert summary["reconstructed"] is True
    assert summary["theorem"]["margin_J"] >= 0
    assert "reconstructed" in err
    assert {file.name for file in (tmp_path / "r").iterdir()} == {f"{figure}.{end}" for end in ("png", "mcap", "json")}


def test_what_the_scene_does_not_read_is_warned_of_once_and_first(capsys: Capture) -> None:
    assert cli.main([*QUICK, "--scene", "free", "--set", "world.wall.stiffness=30000"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("warning: world.wall.stiffness is 30000, but the scene free does not read it\n")
    assert out.count("warning") == 1


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
