"""What tests of the command line share: a directory of their own, and the summary of a command."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from hapnet import cli
from netem import cli as netem_cli
from tests.support.processes import read_json

QUICK = ("simulate", "--duration", "0.2", "--no-files")
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
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, env={**os.environ, **environment}
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def summary_of(*argv: str) -> dict[str, Any]:
    assert cli.main([*argv, "--json", "summary.json"]) == 0
    return read_json(Path("summary.json"))


class Tab:
    """What the shell is offered after TAB."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
        self._monkeypatch, self._capsys = monkeypatch, capsys

    def __call__(self, program: str, *words: str) -> list[str]:
        """What bash is offered after `words`, the last of which is not finished."""
        self._monkeypatch.setenv("COMP_WORDS", "\n".join((program, *words)))
        self._monkeypatch.setenv("COMP_CWORD", str(len(words)))
        return self.asked(program, "complete_bash").split()

    def line(self, shell: str, line: str) -> str:
        """What zsh or fish is offered after `line`."""
        self._monkeypatch.setenv("_TYPER_COMPLETE_ARGS", line)
        self._monkeypatch.setenv("_TYPER_COMPLETE_FISH_ACTION", "get-args")
        return self.asked(line.partition(" ")[0], f"complete_{shell}")

    def asked(self, program: str, instruction: str) -> str:
        self._monkeypatch.setenv(f"_{program.upper()}_COMPLETE", instruction)
        main = {"hapnet": cli.main, "netem": netem_cli.main}[program]
        try:
            code = main([])
        except SystemExit as ended:
            code = 1 if ended.code else 0
        out, err = self._capsys.readouterr()
        assert (code, err) == (0, "")
        return out
