"""Help and versions: complete, quick, plain in a pipe."""

import importlib
import inspect
import json
import os
import platform
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

import pytest

from hapnet import cli
from netem import cli as netem_cli
from tests.support.commands import Capture, empty_directory as empty_directory, python

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
    "export",
    "bench",
    "doctor",
    "devices",
    "emulate",
)
HEAVY = ("matplotlib", "zenoh", "mcap", "numpy", "msgpack", "msgspec", "asyncio")


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


def test_help_loads_nothing_heavy() -> None:
    """Of no command: one process prints them all."""
    asked = [["--help"], ["--version"], *([command, "--help"] for command in COMMANDS)]
    code = f"import sys\nfrom hapnet.cli import main\nfor argv in {asked!r}: main(argv)\nprint(*sys.modules)"
    loaded = set(python(code, COLUMNS="200").splitlines()[-1].split())
    assert "hapnet.cli" in loaded
    assert not loaded & set(HEAVY)


def of_hapnet(code: str) -> set[str]:
    """The modules of hapnet and netem, and heavy ones, that are loaded once `code` has run."""
    loaded = python(f"import sys\n{code}\nprint(*sys.modules)").splitlines()[-1].split()
    return {name for name in loaded if name.partition(".")[0] in ("hapnet", "netem", *HEAVY)}


@pytest.mark.parametrize("argv", [[], ["--help"], ["-h"], ["--version"]], ids=" ".join)
def test_the_list_of_commands_needs_none_of_them(argv: list[str]) -> None:
    found = of_hapnet(f"sys.argv[1:] = {argv!r}\nfrom hapnet.__main__ import main\nmain()")
    ours = {"hapnet", "hapnet.__main__", "hapnet.cli", "hapnet.commands", "hapnet.errors"}
    ours |= {f"hapnet.commands.{name}" for name in ("output", "progress")}
    ours |= {"hapnet.extras", "hapnet.ext", "hapnet.ext.compiled", "hapnet.ext.compiled.progress"}  # without numba
    theirs = {"netem", "netem.errors", "netem.version_flag", "netem.versions"}
    assert ours <= found <= ours | theirs


def test_a_command_loads_no_other() -> None:
    found = of_hapnet("from hapnet.cli import main\nmain(['run', '--help'])")
    assert {name for name in cli.commands() if f"hapnet.commands.{name}" in found} == {"run"}


def test_the_list_says_of_each_command_what_its_own_help_begins_with(capsys: Capture) -> None:
    assert set(COMMANDS) < set(cli.commands())
    for name, text in cli.commands().items():
        found = getattr(importlib.import_module(f"hapnet.commands.{name}"), name)
        assert " ".join(inspect.getdoc(found).partition("\n\n")[0].split()) == text
        assert cli.main([name, "--help"]) == 0
    assert not capsys.readouterr().err


def test_the_pages_example_is_a_command_once_it_is_in_the_folder(tmp_path: Path) -> None:
    folder = tmp_path / "hapnet"
    shutil.copytree(Path(cli.__file__).parent, folder, ignore=shutil.ignore_patterns("__pycache__"))
    page = (folder / "README.md").read_text("utf-8").partition("**A command.**")[2]
    (folder / "commands" / "greet.py").write_text(page.partition("```python\n")[2].partition("```")[0], "utf-8")

    def hapnet(*argv: str) -> str:
        command = [sys.executable, "-m", "hapnet", *argv]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=True).stdout

    listed = hapnet("--help")
    assert listed.index("Thousands of cases") < listed.index("Say hello to somebody.")
    assert "Somebody's name." in hapnet("greet", "--help")
    assert hapnet("greet", "Ada", "--scene", "box") == "hello Ada in box\n"
    assert json.loads(hapnet("greet", "Ada", "--json", "-")) == {"length": 3}


def test_the_package_is_one_module_until_a_name_is_used() -> None:
    assert of_hapnet("import hapnet") == {"hapnet"}
    assert of_hapnet("import netem") == {"netem", "netem.errors"}


def test_no_module_loads_matplotlib_before_a_figure_is_drawn() -> None:
    """Whatever is imported; a module whose extra is not installed cannot be."""
    code = """
import contextlib, importlib, pkgutil, hapnet, netem
for package in hapnet, netem:
    for found in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if not found.name.endswith(("__main__", "netem.plot")):  # the latter is imported to draw
            with contextlib.suppress(ImportError):
                importlib.import_module(found.name)
"""
    found = of_hapnet(code)
    assert {"hapnet.ext.pictures.run", "hapnet.ext.pictures.sweep"} <= found
    assert "matplotlib" not in found


@pytest.mark.parametrize("argv", ["--help", "run --help", "run --show-params"])
def test_a_reader_that_has_left_ends_a_command_quietly(argv: str) -> None:
    """`| head -1`: the exit code is that of a process that SIGPIPE ended, and nothing is said."""
    reader, writer = os.pipe()
    os.close(reader)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "hapnet", *argv.split()], stdout=writer, stderr=subprocess.PIPE, timeout=60
        )
    finally:
        os.close(writer)
    assert (done.returncode, done.stderr) == (128 + signal.SIGPIPE, b"")


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
    reported = dict(line.split(maxsplit=1) for line in rest)
    assert reported["python"].startswith(platform.python_version())
    assert platform.release() in reported["platform"]
    assert reported["cpus"].startswith(str(os.cpu_count()))
    for package in ("numpy", "eclipse-zenoh", "msgpack", "msgspec", "typer", "rich", "mcap", "matplotlib"):
        assert reported[package] == metadata.version(package)
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
