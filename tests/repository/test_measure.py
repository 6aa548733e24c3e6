"""The programs that measure hapnet: one command lists and runs them, and pages call them as they are."""

import ast
import re
import subprocess
import sys

import pytest

from tests.conftest import ROOT
from tests.measure.__main__ import PROGRAMS, first_line, main

CALLS = sorted({
    (name, options)
    for page in ROOT.rglob("*.md")
    if ".venv" not in page.parts
    for name, options in re.findall(r"python -m tests\.measure (\w+)([^`\n]*)`", page.read_text("utf-8"))
})  # fmt: skip


def parameters(name: str) -> set[str]:
    """Of a program's `main`; the program is not imported."""
    defined = {one.name: one for one in ast.parse(PROGRAMS[name].read_text("utf-8")).body if hasattr(one, "name")}
    assert isinstance(defined["main"], ast.FunctionDef)
    return {each.arg for each in defined["main"].args.args}


def test_the_command_lists_every_program_with_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    shown = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in shown] == list(PROGRAMS)
    assert all(len(line.split()) > 3 for line in shown)
    assert main(["no-such-program"]) == 2


@pytest.mark.parametrize(("name", "options"), CALLS)
def test_pages_call_programs_with_options_that_they_have(name: str, options: str) -> None:
    assert {flag.replace("-", "_") for flag in re.findall(r"--([\w-]+)", options)} <= parameters(name)


def test_help_says_what_a_program_measures() -> None:
    words = [sys.executable, "-m", "tests.measure", "changed_walls", "--help"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    assert first_line(PROGRAMS["changed_walls"])[:40] in done.stdout
    assert "--moments" in done.stdout
