"""`hapnet tune`: its flags. `hapnet.commands.tuning` does the work; it is imported on demand."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hapnet.commands import complete, flags
from hapnet.commands.options import json_target


def tune(
    spec: Annotated[
        Path,
        typer.Argument(
            metavar="SPEC.toml", help="What is searched, what is wanted, and the cases.", autocompletion=complete.specs
        ),
    ],
    workers: flags.Workers = 0,
    dask: flags.Dask = None,
    assign: flags.Assign = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Check the spec, say what would run, estimate the time by a few cases.")
    ] = False,
    retry_failed: flags.RetryFailed = False,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Discard all results of this tuning, and start again.")
    ] = False,
    json_to: flags.Json = None,
    out: Annotated[
        Path | None, typer.Option(help="Directory for all output files.", show_default="runs/tune-<SPEC>")
    ] = None,
) -> int:
    """Search the parameters that are best for an objective and break no constraint; score them on other cases.

    SPEC.toml names the parameters with their ranges, the objective, the constraints, and the cases as a sweep's does:
    see examples/tune/pspm.toml. After a stop or a crash the same command continues.

    Writes found.toml (for --params), trials.csv, a figure, results.csv with all cases, and journal.sqlite.
    """
    json_target(json_to)
    from hapnet.commands import tuning

    how = tuning.Options(workers, dask, dry_run=dry_run, retry_failed=retry_failed, fresh=fresh)
    return tuning.run(spec, assign or [], how, json_to, out)
