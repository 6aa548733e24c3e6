"""What every command writes: the summary for people and for machines, recordings and figures in one directory."""

from __future__ import annotations

import json
import os
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapnet.errors import HapnetError

if TYPE_CHECKING:
    from rich.console import Console

    from hapnet.record import Recording


def console(json_to: str | None) -> Console:
    """Where words for people go: standard error if the JSON object has standard output for itself."""
    from rich.console import Console

    class Patient(Console):
        def on_broken_pipe(self) -> None:
            """Who read our words has gone (``| head``): say no more, but end the run and write its files."""
            self.quiet = True
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.file.fileno())

    return Patient(stderr=json_to == "-", highlight=False, soft_wrap=True)


def run_directory(out: Path | None, seed: int | None) -> Path:
    """The directory for everything a command writes, made if need be: `out`, or runs/<UTC time>-<seed>."""
    name = f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{seed}"
    path = out if out is not None else Path("runs") / name
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise HapnetError(f"cannot write to {path}: {error.strerror or error}") from None
    return path


def write_json(value: dict[str, Any] | list[dict[str, Any]], json_to: str | None) -> None:
    """`--json`: to a file, to standard output for "-", nowhere for None."""
    if json_to is None:
        return
    text = json.dumps(value, indent=2, allow_nan=False)
    if json_to == "-":
        sys.stdout.write(text + "\n")
        return
    try:
        Path(json_to).write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise HapnetError(f"cannot write {json_to}: {error.strerror or error}") from None


def save_figure(recording: Recording, path: Path) -> Path:
    """Draw the run's figure."""
    from hapnet import report

    report.save_figure(report.figure(recording), path)
    return path


def show_warnings(out: Console, warnings: tuple[str, ...]) -> None:
    """A line each, before what they warn of begins."""
    for warning in warnings:
        out.print(f"warning: {warning}", style="yellow", markup=False)


def show_summary(out: Console, summary: dict[str, Any]) -> None:
    """The summary as a table."""
    from hapnet import report

    out.print(report.summary_text(summary))
