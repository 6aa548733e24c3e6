"""What a shell gets when TAB is pressed: by the protocol of typer's scripts, and by bash itself."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from hapnet import cli
from hapnet.assembly.build import prepare
from hapnet.commands import complete
from hapnet.ext.bench.registry import ROWS
from hapnet.laws import BILATERAL_NAMES, COUPLING_NAMES
from hapnet.params import Params
from hapnet.plant.scenes import SCENES
from netem.profile import PRESETS
from tests.conftest import ENVIRONMENT
from tests.support.commands import Capture, Tab

PROFILES = list(PRESETS)
WALL = [f"world.wall.{name}=" for name in ("stiffness", "damping", "position_m", "half_width_m", "timeline")]


@pytest.fixture(autouse=True)
def directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    return tmp_path


@pytest.fixture
def tab(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> Tab:
    return Tab(monkeypatch, capsys)


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("si", ["simulate"]),
        ("simulate --lin", ["--link"]),
        ("--vers", ["--version"]),
        ("--version si", ["simulate"]),
        ("run --link ", PROFILES),
        ("run --link l", ["lan", "lossy-wifi", "leo"]),
        ("run --uplink 4", ["4g"]),
        ("simulate --downlink ge", ["geo"]),
        (
            "run --scene ",
            [
                *SCENES,
                "sphere",
                "cuboid",
                "cylinder",
                "hole",
                "plane",
                "tool:box",
                "tool:peg",
                "tool:stick",
                "grip:soft",
                "grip:hard",
                "grip:empty",
                "soft",
                "soft:organ",
            ],
        ),
        ("run --scene=w", ["wall"]),
        ("device --operator ", ["rest", "sine", "press", "hand-1"]),
        ("simulate --coupling ", [*COUPLING_NAMES, *BILATERAL_NAMES]),
        ("run --servo ", ["auto", "continuous", "sampled"]),
        ("world --on-silence ", ["hold", "release"]),
        ("device --mode ", ["peer", "client", "router"]),
        ("device -m r", ["router"]),
        ("run --set world.wall.", WALL),
        ("run --set world.wall.st", [WALL[0], "world.wall.stiffness=3000"]),
        ("run --set device.harvest=", [f"device.harvest={value}" for value in ("", "auto", "range", "measured")]),
        ("run --set nosuch", []),
        ("reproduce ", ["fig4", "fig5", "fig6"]),
        ("reproduce fig4 --set dura", ["duration_s=", "duration_s=10"]),
        ("bench --only ", list(ROWS)),
        ("bench --only servo_idle,codec", ["servo_idle,codec_position", "servo_idle,codec_energy"]),
        ("report ", []),
        ("run --duration ", []),
        ("run --scene nosuch --set world.m", ["world.mass=", "world.mass=0.02"]),
    ],
)
def test_what_hapnet_offers(line: str, offered: list[str], tab: Tab) -> None:
    assert tab("hapnet", *line.split(" ")) == offered


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (["--set", "device.harvest", "="], ["auto", "range", "measured"]),
        (["--set", "device.harvest", "=", "m"], ["measured"]),
        (["--set", "device.harvest", "=", ""], []),
        (["--scene", "=", "w"], ["wall"]),
        (["--scene", "=", "wall", "--set", "=", "world.mass", "="], ["0.02"]),
        (["--scene", "=", "wall", "--set", "world.ma"], ["world.mass=", "world.mass=0.02"]),
        (["--set", "world.mass", "=", "0.1", "--coup"], ["--coupling"]),
    ],
)
def test_bash_takes_words_apart(words: list[str], offered: list[str], tab: Tab) -> None:
    """At each =, and the cursor is behind the last word."""
    assert tab("hapnet", "run", *words) == offered


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("", ["profiles", "show", "udp", "tcp", "zenoh", "bench"]),
        ("show ", PROFILES),
        ("show --profile wan-c", ["wan-continental"]),
        ("udp --up wo", ["worst"]),
        ("zenoh --mode ", ["peer", "client"]),
        ("bench ", ["lateness", "core", "udp"]),
        ("--version sh", ["show"]),
    ],
)
def test_what_netem_offers(line: str, offered: list[str], tab: Tab) -> None:
    assert tab("netem", *line.split(" ")) == offered


def test_a_hand_may_be_a_file(directory: Path, tab: Tab) -> None:
    for name in (
        "a.csv",
        "b.mcap",
        "c.txt",
        "two words.csv",
        ".hidden.csv",
        "runs/x/d.csv",
        "runs/x/e.csv",
        "resin/f.csv",
    ):
        (directory / name).parent.mkdir(parents=True, exist_ok=True)
        (directory / name).touch()
    assert tab("hapnet", "run", "--operator", "") == [
        "rest",
        "sine",
        "press",
        "hand-1",
        "a.csv",
        "b.mcap",
        "resin/",
        "runs/",
    ]
    assert tab("hapnet", "run", "--operator", "re") == ["rest", "resin/f.csv"]
    assert tab("hapnet", "run", "--operator", "ru") == ["runs/x/d.csv", "runs/x/e.csv"]
    assert tab("hapnet", "run", "--operator", "runs/x/e") == ["runs/x/e.csv"]
    assert tab("hapnet", "run", "--operator", f"{directory}/resin/") == [f"{directory}/resin/f.csv"]
    assert tab("hapnet", "run", "--operator", "nosuch/") == []


def test_zsh_and_fish_show_what_is_meant_with_its_units(tab: Tab) -> None:
    assert '"world.wall.damping=":"B_w [Ns/m] (rec.)"' in tab.line("zsh", "hapnet run --set world.wall.")
    assert "world.wall.damping=\tB_w [Ns/m] (rec.)\n" in tab.line("fish", "hapnet run --set world.wall.")
    assert f"lan\t{PRESETS['lan']}\n" in tab.line("fish", "netem show l")


@pytest.mark.parametrize("program", ["hapnet", "netem"])
@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_there_is_a_script_for_the_shell(shell: str, program: str, tab: Tab) -> None:
    script = tab.asked(program, f"source_{shell}")
    assert f"_{program.upper()}_COMPLETE=complete_{shell}" in script


def test_nothing_is_said_when_it_fails(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    monkeypatch.setenv("_HAPNET_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", "hapnet 'run")
    monkeypatch.setenv("COMP_CWORD", "not a number")
    assert cli.main([]) == 1
    assert capsys.readouterr() == ("", "")


def test_what_is_offered_is_accepted() -> None:
    """The words that stand here, as importing what knows them takes long, are those that the program takes."""
    for operator in complete.OPERATORS:
        assert prepare(Params().set({"operator": operator}), "continuous").params.operator == operator
    for name, _ in complete.assignments(""):
        Params().get(name.removesuffix("="))
    reported = [
        word for name in Params().flat() for word, _ in complete.assignments(f"{name}=") if not word.endswith("=")
    ]
    assert len(reported) > len(Params().flat()) / 2
    Params().set_words(reported)


def test_bash_completes_the_installed_command(directory: Path) -> None:
    """The script as a shell reads it, and the command's own entry, which sees to signals before it imports."""
    command = directory / "hapnet"
    command.write_text(f"#!{sys.executable}\nimport sys\nfrom hapnet.__main__ import main\nsys.exit(main())\n", "utf-8")
    command.chmod(0o755)
    asks = """
        source <(_HAPNET_COMPLETE=source_bash hapnet)
        complete -p hapnet
        COMP_WORDS=(hapnet simulate --profile l) COMP_CWORD=3
        _hapnet_completion hapnet
        printf '%s\\n' "${COMPREPLY[@]}"
    """
    path = f"{directory}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "--norc", "-c", asks], env={**ENVIRONMENT, "PATH": path}, capture_output=True, text=True, timeout=60
    )
    assert not done.stderr
    assert done.stdout.splitlines() == ["complete -o default -F _hapnet_completion hapnet", "lan", "lossy-wifi", "leo"]
