"""`hapnet sweep`: the flags of `run` and `plot`. `hapnet.commands.sweeping` does the work; it is imported on demand."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from hapnet.commands import complete, flags
from hapnet.commands.options import json_target

RUN = "run"


class RunByDefault(TyperGroup):
    """`hapnet sweep SPEC.toml` is `hapnet sweep run SPEC.toml`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        asked_for_words = ctx.resilient_parsing and not args  # TAB: offer the names of both commands
        if not asked_for_words and (not args or args[0] not in self.commands):
            args = [RUN, *args]
        return super().parse_args(ctx, args)

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        """The names of both commands, and what may follow `run`, whose name may be left out."""
        default = self.commands[RUN]
        within = default.make_context(RUN, [], parent=ctx, resilient_parsing=True)
        offered = [*super().shell_complete(ctx, incomplete), *default.shell_complete(within, incomplete)]
        if not incomplete.startswith("-"):
            offered += default.params[0].shell_complete(within, incomplete)
        return offered


app: typer.Typer = typer.Typer(
    cls=RunByDefault,
    help="Thousands of cases over parameters, links and seeds, in virtual time; `hapnet sweep plot` draws them.",
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.command(
    RUN,
    short_help="Run every case that a spec describes; `hapnet sweep SPEC.toml` is enough.",
    epilog="`hapnet sweep SPEC.toml` does the same. `hapnet sweep plot DIRECTORY` draws the results.",
)
def run(
    spec: Annotated[
        Path, typer.Argument(metavar="SPEC.toml", help="What is fixed and what varies.", autocompletion=complete.specs)
    ],
    workers: flags.Workers = 0,
    dask: flags.Dask = None,
    assign: flags.Assign = None,
    table: Annotated[
        str, typer.Option("--format", help="Format of the results: csv, parquet, both; auto: both if pyarrow is there.")
    ] = "auto",
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", help="Check the spec, list its first and last cases, estimate the time by a few."),
    ] = False,
    retry_failed: flags.RetryFailed = False,
    fresh: Annotated[bool, typer.Option("--fresh", help="Discard all results of this sweep, and start again.")] = False,
    json_to: flags.Json = None,
    out: Annotated[
        Path | None, typer.Option(help="Directory for all output files.", show_default="runs/sweep-<SPEC>")
    ] = None,
) -> int:
    """Run every combination of parameters, links and seeds that SPEC.toml lists, in virtual time.

    After a stop or a crash the same command continues: it runs only cases without a result. A case that fails gets a
    row that says why.

    Writes results.csv (and results.parquet), sorted by case, and journal.sqlite, from which a later run continues.
    """
    json_target(json_to)
    from hapnet.commands import sweeping

    how = sweeping.Options(workers, dask, table, dry_run=dry_run, retry_failed=retry_failed, fresh=fresh)
    return sweeping.run(spec, assign or [], how, json_to, out)


@app.command(short_help="Draw the results of a sweep as a heat map.")
def plot(
    directory: Annotated[Path, typer.Argument(metavar="DIRECTORY", help="The directory of a sweep.")],
    x: Annotated[
        str | None, typer.Option(metavar="NAME", help="Parameter on the x axis; alone: a line with quartiles.")
    ] = None,
    y: Annotated[str | None, typer.Option(metavar="NAME", help="Parameter on the y axis.")] = None,
    value: Annotated[
        str | None, typer.Option(metavar="METRIC", help="The metric to show.", show_default="energy_out_J")
    ] = None,
    where: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE", help="Only these cases; may be repeated.")
    ] = None,
    stat: Annotated[
        str | None,
        typer.Option(
            help="Statistic over a cell's cases: median, mean, min, max, p90, ...",
            show_default="the worst case for energy and margins, otherwise the median",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.png", help="Write the figure here.", show_default="DIRECTORY/METRIC-X-Y.png"),
    ] = None,
) -> int:
    """Draw one metric of a sweep over two varied parameters as a heat map, or over one as a line with quartiles.

    Without --x and --y: the two parameters with the most values. Works while the sweep runs.
    """
    from hapnet.commands import sweeping

    return sweeping.plot(directory, x, y, value, where or [], stat, out)
