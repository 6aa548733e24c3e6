"""What tests of the command line share: a directory of their own, and the summary of a command."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from hapnet import cli

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
    summary: dict[str, Any] = json.loads(Path("summary.json").read_text("utf-8"))
    return summary
