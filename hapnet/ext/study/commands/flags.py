"""The flags that several of these commands share."""

from __future__ import annotations

from typing import Annotated, Any

import typer

Workers = Annotated[int, typer.Option(min=0, max=1024, help="Processes on this machine; 0: one per core.")]
Dask = Annotated[
    str | None, typer.Option(metavar="tcp://HOST:PORT", help="Use the workers of this Dask scheduler instead.")
]
RetryFailed = Annotated[bool, typer.Option("--retry-failed", help="Run the failed cases again.")]


def dry_run(help: str) -> Any:
    """The flag `--dry-run` of a command, with its help text."""
    return typer.Option("--dry-run", help=help)
