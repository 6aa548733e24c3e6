"""The output of the `netem` command: JSON, errors in one line, and nothing to a reader that has left."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

from netem.errors import NetemError


def unread() -> int:
    """Return the exit code of SIGPIPE, silently, after the reader of the output has closed it."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 141


def fail(message: str) -> int:
    """Print an error in one line; returns the exit code."""
    sys.stderr.write(f"netem: {' '.join(message.split())}\n")
    return 2


def check_writable(name: str, target: str | None) -> None:
    """Raise NetemError before a long run, not after it, if `target` cannot be written."""
    if target in (None, "-"):
        return
    try:
        with open(str(target), "ab"):
            pass
    except OSError as error:
        raise NetemError(f"{name}: cannot write {target}: {error.strerror}") from error


def write_json(result: object, target: str) -> None:
    """Write `result` to a file, or to standard output for "-". Raises NetemError if that fails."""
    text = json.dumps(result, indent=2)
    if target == "-":
        sys.stdout.write(text + "\n")
        return
    try:
        Path(target).write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise NetemError(f"--json: cannot write {target}: {error.strerror}") from error
