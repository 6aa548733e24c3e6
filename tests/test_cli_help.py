"""Help and versions: complete, quick, plain in a pipe."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable
from importlib import metadata

import pytest

from hapnet import cli
from netem import cli as netem_cli
from tests.commands import Capture, python
from tests.commands import empty_directory as empty_directory

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
