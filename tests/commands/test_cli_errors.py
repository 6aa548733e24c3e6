"""Bad input on the command line: one line that names what is wrong, and exit code 2."""

import tomllib
from pathlib import Path
from typing import Any

import pytest

from hapnet import cli
from hapnet.ext.study.plans import links_of
from netem import LinkProfile, cli as netem_cli
from netem.presets import ALIASES
from tests.support.commands import ADDRESS, QUICK, Capture, empty_directory as empty_directory

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
    assert capsys.readouterr().err == f"hapnet: --out: cannot write to {file}: it is a file, not a directory\n"


def test_completion_that_cannot_be_installed(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    monkeypatch.setenv("HOME", "/proc/no")
    monkeypatch.setattr("shellingham.detect_shell", lambda: ("bash", "/bin/bash"))
    assert cli.main(["--install-completion"]) == 2
    assert capsys.readouterr() == ("", "hapnet: /proc/no: No such file or directory\n")


# Bad input: one line, exit code 2, nothing written


def bad(*argv: str, says: tuple[str, ...]) -> Any:
    return pytest.param(argv, says, id=" ".join(argv))


BAD = [
    bad("bogus", says=("bogus",)),
    bad("run", "--bogus", says=("--bogus",)),
    bad("reproduce", says=("figure",)),
    bad("report", says=("FILE",)),
    bad("run", "--duration", "soon", says=("--duration", "number")),
    bad("run", "--duration", "-1", says=("--duration", "-1", "0 to 1e+09")),
    bad("simulate", "--duration", "0", says=("--duration", "above 0")),
    bad(*QUICK, "--downlink", "loss 100%", says=("did not find each other", "loss 100%")),
    bad("run", "--duration", "nan", says=("--duration", "nan")),
    bad("run", "--seed", "-1", says=("--seed", "0")),
    bad("run", "--seed", "1.5", says=("--seed",)),
    bad("run", "--profile", "nosuch", says=("nosuch", "lossy-wifi")),
    bad("run", "--resend", "3 8", says=("resend: '8'", "such as 40ms")),
    bad("run", "--link", "resend 3 8ms", "--resend", "2 8ms", says=("resend", "leave one of the two out")),
    bad("run", "--link", "delay 40ms jiggle 3", says=("jiggle", "delay")),
    bad("run", "--uplink", "delay fast", says=("fast", "unit")),
    bad("run", "--downlink", "loss 200%", says=("200%", "100%")),
    bad("run", "--timeline", "at 3s down", says=("timeline", "at 3s down")),
    bad("run", "--set", "link.up_timeline=at 3s: sideways", says=("sideways",)),
    bad("device", "-e", ADDRESS, "--on-silence", "panic", says=("--on-silence", "panic", "hold, release")),
    bad("world", "-l", ADDRESS, "--silence-after", "0", says=("--silence-after", "above 0")),
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
    bad("reproduce", "fig7", says=("fig7", "did you mean fig6, fig5 or fig4?")),
    bad("run", "--set", "device.stifness=3", says=("device.stifness", "device.stiffness")),
    bad("run", "--set", "device.stiffness", says=("device.stiffness", "NAME=VALUE")),
    bad("run", "--set", "device.stiffness=hard", says=("hard", "number")),
    bad("run", "--set", "device.stiffness=[[1,0],[0,1]]", says=("stiffness", "1 x 1")),
    bad("run", "--scene", "free", "--dof", "2", "--set", "device.stiffness=[[1,2],[2,1]]", says=("positive definite",)),
    bad("run", "--scene", "free", "--dof", "2", "--set", "world.stiffness=[[1,2],[2,1]]", says=("positive definite",)),
    bad("run", "--set", "world.mass=-1", says=("world.mass", "-1")),
    bad("simulate", "--set", "hardware=mymodule:Arm", says=("hardware", "mymodule:Arm", "virtual time")),
    bad("simulate", "--device", "omni:x=1", says=("--device", "omni:x=1", "omni?axes=joints")),
    bad("simulate", "--device", "omni", "--dof", "2", says=("dof", "2", "3")),
    bad("run", "--device", "omni", "--servo", "continuous", says=("--servo", "continuous", "sampled")),
    bad("run", "--device", "omni", "--set", "device.mass=0.1", says=("device.mass", "0.1", "links")),
    bad("run", "--device", "no_such_module:Arm", says=("--device", "no_such_module:Arm", "is no_such_module.py in")),
    bad(
        "run", "--follower", "no_such_module:Arm", says=("--follower", "no_such_module:Arm", "is no_such_module.py in")
    ),
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
    argv: tuple[str, ...],
    says: tuple[str, ...],
    capsys: Capture,
    empty_directory: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("hapnet.commands.pair.Pair", None)  # it is refused before anything starts
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


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        ("simulte", "unknown command 'simulte'; did you mean simulate or emulate?"),
        ("run --scene wal", "unknown --scene 'wal'; did you mean wall?"),
        ("simulate --scene shpere", "unknown --scene 'shpere'; did you mean sphere?"),
        ("simulate --coupling psmp", "unknown --coupling 'psmp'; did you mean pspm?"),
        ("transparency --coupling psmp", "unknown --coupling 'psmp'; did you mean pspm?"),
        ("simulate --operator pres", "unknown --operator 'pres'; did you mean press or rest?"),
        ("simulate --rendering papr", "unknown --rendering 'papr'; did you mean paper?"),
        ("run --device seriall", "unknown --device 'seriall'; did you mean serial?"),
        ("run --device serial:prot=x", "--device serial:prot=x: unknown option 'prot'; did you mean port?"),
        ("simulate --profile 4gg", "--profile: unknown profile '4gg'; did you mean 4g?"),
        ("simulate --link wify", "--link: unknown profile 'wify'; did you mean wifi?"),
        ("simulate --link rtae", "--link: unknown profile 'rtae'; did you mean rate?"),
        ("compare --link lossy-wfi", "unknown --link 'lossy-wfi'; did you mean lossy-wifi?"),
        ("compare --bench tap", "unknown --bench 'tap'; did you mean taps?"),
        ("bench --only device_tik", "unknown --only 'device_tik'; did you mean device_tick?"),
        (
            "simulate --scene sphere?radis=20mm",
            "--scene sphere?radis=20mm: unknown property 'radis'; did you mean radius?",
        ),
        ("emulate seral:link=/tmp/a", "unknown device 'seral'; did you mean serial?"),
        (
            "simulate --scene examples.own_world:coridor",
            "examples.own_world: unknown --scene 'coridor'; did you mean corridor?",
        ),
        (
            "simulate --set stiffness=300",
            "--set: unknown parameter 'stiffness'; did you mean device.stiffness, operator_model.stiffness or "
            "world.stiffness?",
        ),
        ("simulate --set renderin=paper", "--set: unknown parameter 'renderin'; did you mean rendering?"),
        ("device --mode pear", "unknown --mode 'pear'; did you mean peer?"),
    ],
)
def test_what_may_be_meant_is_suggested(argv: str, says: str, capsys: Capture) -> None:
    assert cli.main(argv.split()) == 2
    out, err = capsys.readouterr()
    assert (out, err) == ("", f"hapnet: {says}\n")


def test_every_profile_has_the_same_names_everywhere(capsys: Capture) -> None:
    """Also the short ones that comparisons show."""
    for name, profile in {**ALIASES, "4g": "4g"}.items():
        for flags in (["--profile", name], ["--link", name], ["--uplink", name, "--downlink", name]):
            assert cli.main(["simulate", *flags, "--show-params"]) == 0
            table = tomllib.loads(capsys.readouterr().out)["link"]
            assert str(LinkProfile.named(table["up"])) == str(LinkProfile.preset(profile))
        assert cli.main(["simulate", "--link", name, "--delay", "7ms", "--show-params"]) == 0
        words = tomllib.loads(capsys.readouterr().out)["link"]["up"]
        assert LinkProfile.parse(words) == LinkProfile.preset(profile).replace(delay_ns=7_000_000)
        assert links_of([name], ()) == {name: (profile, profile)}
        assert netem_cli.main(["show", name, "--count", "1"]) == 0
        capsys.readouterr()
