"""Help and versions: complete, quick, plain in a pipe."""

import json
import os
import platform
import signal
import subprocess
import sys
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

import pytest

from hapnet import cli
from netem import cli as netem_cli
from tests.conftest import ROOT
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


def test_eight_commands_are_in_front(capsys: Capture) -> None:
    assert cli.main(["--help"]) == 0
    front, _, rest = capsys.readouterr().out.partition("\nResearch:\n")
    listed = [line.split()[0] for line in front.partition("\nCommands:\n")[2].splitlines() if line]
    assert listed == ["run", "play", "device", "world", "simulate", "report", "devices", "doctor"]
    assert all(f"\n  {name} " in f"\n{rest}" for name in cli.COMMANDS.keys() - set(listed))


HELPS = [[name] for name in sorted(cli.COMMANDS.keys() - {"sweep"})] + [["sweep", "run"], ["sweep", "plot"], []]


@pytest.mark.parametrize("columns", [40, 80])
@pytest.mark.parametrize("flag", ["--help", "--help-all"])
@pytest.mark.parametrize("command", HELPS, ids=" ".join)
def test_help_fits_its_terminal(
    command: list[str], flag: str, columns: int, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No line is wider, but for one word that is; below 60 columns a text is no narrower than 30."""
    monkeypatch.setenv("COLUMNS", str(columns))
    assert cli.main([*command, flag]) == 0
    lines = capsys.readouterr().out.splitlines()
    for line in lines:
        assert len(line) <= columns or len(line.split()) <= (2 if line.startswith("  -") else 1) or "Usage:" in line
        assert len(line) - len(line.lstrip()) <= columns - 30
    if flag == "--help" and columns == 80:
        assert len(lines) <= 50


def test_help_all_has_every_flag(capsys: Capture) -> None:
    assert cli.main(["run", "--help"]) == 0
    short = capsys.readouterr().out
    assert cli.main(["run", "--help-all"]) == 0
    whole = capsys.readouterr().out
    hidden = {"--profile", "--files"}  # the latter before a slash
    flags = {name for option in cli._command("run").params for name in (*option.opts, *option.secondary_opts)} - hidden
    assert {flag for flag in flags if f"{flag} " in whole or f"{flag}," in whole or f"{flag}\n" in whole} == flags
    assert "\n`hapnet run --help-all` lists 17 more flags" in short
    assert "--help-all" not in whole
    assert "--on-silence" not in short


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
    ours |= {"hapnet.commands.output"}
    ours |= {f"hapnet.{name}" for name in ("loading", "installing")}
    theirs = {"netem", "netem.command_help", "netem.errors", "netem.version_flag", "netem.versions"}
    assert ours <= found <= ours | theirs


def test_a_command_loads_no_other() -> None:
    found = of_hapnet("from hapnet.cli import main\nmain(['run', '--help'])")
    assert {name for name, (where, _) in cli.COMMANDS.items() if where.partition(":")[0] in found} == {"run"}


@pytest.mark.parametrize("name", sorted(cli.COMMANDS.keys() - {"sweep"}))  # it is two commands, each with its help
def test_the_help_of_a_command_begins_with_its_line_in_the_list(
    name: str, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    assert cli.main([name, "--help"]) == 0
    out, err = capsys.readouterr()
    usage, line, *_ = (line.strip() for line in out.splitlines() if line.strip())
    assert usage.startswith(f"Usage: hapnet {name} ")
    assert line == cli.commands()[name]
    assert not err


GREETING = """[hapnet.commands]
greet = hapnet_greet:greet
run = hapnet_greet:greet
torn = hapnet_greet:missing
"""


@pytest.mark.slow
def test_the_pages_example_is_a_command_once_its_package_is_installed(tmp_path: Path) -> None:
    page = (Path(cli.__file__).parent / "README.md").read_text("utf-8").partition("**A command.**")[2]
    (tmp_path / "hapnet_greet.py").write_text(page.partition("```python\n")[2].partition("```")[0], "utf-8")
    about = tmp_path / "hapnet_greet-1.0.dist-info"
    about.mkdir()
    about.joinpath("METADATA").write_text(
        "Metadata-Version: 2.1\nName: hapnet-greet\nVersion: 1.0\nSummary: Greets.\n", "utf-8"
    )
    about.joinpath("entry_points.txt").write_text(GREETING, "utf-8")
    path = os.pathsep.join((str(ROOT), str(tmp_path)))

    def hapnet(*argv: str, code: int = 0, **more: str) -> str:
        command, environment = [sys.executable, "-m", "hapnet", *argv], {**os.environ, "PYTHONPATH": path, **more}
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60, env=environment)
        assert done.returncode == code, done.stderr
        return done.stderr if code else done.stdout

    listed = hapnet("--help")
    assert listed.index("thousands of cases") < listed.index("Of other packages:") < listed.index("greet ")
    assert listed.index("greet ") < listed.index("Greets.")
    assert "Run both sides" in listed  # a package cannot replace hapnet's own
    assert "Run both sides" in hapnet("run", "--help")
    assert "Somebody's name." in hapnet("greet", "--help")
    assert hapnet("greet", "Ada", "--scene", "box") == "hello Ada in box\n"
    assert json.loads(hapnet("greet", "Ada", "--json", "-")) == {"length": 3}
    assert hapnet("gret", code=2).startswith("hapnet: unknown command 'gret'; did you mean greet?")
    assert hapnet("torn", code=2).count("\n") == 1
    offered = hapnet(code=0, _HAPNET_COMPLETE="complete_bash", COMP_WORDS="hapnet\ngre", COMP_CWORD="1")
    assert offered.split() == ["greet"]


def test_the_list_loads_no_package_that_publishes_a_command(tmp_path: Path) -> None:
    (tmp_path / "hapnet_greet.py").write_text("raise AssertionError", "utf-8")
    (tmp_path / "hapnet_greet-1.0.dist-info").mkdir()
    (tmp_path / "hapnet_greet-1.0.dist-info" / "METADATA").write_text("Name: hapnet-greet\n", "utf-8")
    (tmp_path / "hapnet_greet-1.0.dist-info" / "entry_points.txt").write_text(GREETING, "utf-8")
    listed = python(f"import sys; sys.path.append({str(tmp_path)!r}); from hapnet.cli import main; main(['--help'])")
    assert "A command of hapnet-greet." in listed


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
