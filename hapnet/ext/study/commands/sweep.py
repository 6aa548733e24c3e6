"""`hapnet sweep` and `hapnet sweep plot`: run thousands of cases in virtual time, and draw their results."""

from __future__ import annotations

import re
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapnet.commands import complete, flags, output
from hapnet.commands.typed import Command
from hapnet.ext.study.commands import flags as own
from hapnet.ext.study.spec import SEED, Case, Spec, in_file, value_words
from hapnet.params import Params
from netem.command_help import PlainGroup

if TYPE_CHECKING:
    from rich.console import Console

RUN = "run"

_SHOWN = 3  # cases that --dry-run shows at each end of the list


class RunByDefault(PlainGroup):
    """`hapnet sweep SPEC.toml` is `hapnet sweep run SPEC.toml`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        completing = ctx.resilient_parsing and not args  # TAB: offer the names of both commands
        if not completing and (not args or args[0] not in self.commands):
            args = [RUN, *args]
        return super().parse_args(ctx, args)

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        """Offer the names of both commands, and the arguments of `run`, whose name may be left out."""
        default = self.commands[RUN]
        within = default.make_context(RUN, [], parent=ctx, resilient_parsing=True)
        offered = [*super().shell_complete(ctx, incomplete), *default.shell_complete(within, incomplete)]
        if not incomplete.startswith("-"):
            offered += default.params[0].shell_complete(within, incomplete)
        return offered


app: typer.Typer = typer.Typer(cls=RunByDefault, add_completion=False)


@app.command(
    RUN,
    cls=Command,
    short_help="Run every case that a spec describes; `hapnet sweep SPEC.toml` is enough.",
    epilog="`hapnet sweep SPEC.toml` does the same. `hapnet sweep plot DIRECTORY` draws the results.",
)
def run(
    spec: Annotated[
        Path, typer.Argument(metavar="SPEC.toml", help="Fixed and varied parameters.", autocompletion=complete.specs)
    ],
    workers: own.Workers = 0,
    dask: own.Dask = None,
    assign: flags.Assign = None,
    table: Annotated[
        str, typer.Option("--format", help="Format of the results: csv, parquet, both; auto: both if pyarrow is there.")
    ] = "auto",
    dry_run: Annotated[
        bool, own.dry_run("Check the spec, list its first and last cases, estimate the time by a few.")
    ] = False,
    retry_failed: own.RetryFailed = False,
    fresh: Annotated[bool, typer.Option("--fresh", help="Discard all results of this sweep, and start again.")] = False,
    json_to: flags.Json = None,
    out: Annotated[Path | None, flags.out_in("runs/sweep-<SPEC>")] = None,
) -> int:
    """Run every combination of parameters, links and seeds that SPEC.toml lists, in virtual time.

    After a stop or a crash the same command continues: it runs only cases without a result. A case that fails has a
    row with the reason.

    Writes results.csv (and results.parquet), sorted by case, and journal.sqlite, from which a later run continues.
    """
    from hapnet.ext.study.commands import studies
    from hapnet.ext.study.sweep import SweepResult
    from hapnet.recording.export import formats
    from hapnet.summary.causes import INCOMPLETE

    endings = formats(table)
    words = output.console(json_to)
    backend = studies.workers_of(words, workers, dask)
    with in_file(spec):
        wanted = Spec.read(spec, studies.assigned("--set", assign or ()))
    directory = out or Path("runs") / f"sweep-{wanted.name}"
    cases = wanted.cases()
    if (twice := wanted.count - len(cases)) > 0:
        words.print(f"{twice} cases are repetitions in the spec: each case is run once")
    if dry_run:
        can_run = studies.check_cases(words, wanted, cases)
        _show(words, cases, directory)
        studies.estimate_cases(words, wanted.fixed, can_run, len(can_run), workers, dask)
        return 0
    with studies.journal_of(words, wanted, cases, directory, fresh=fresh, retry_failed=retry_failed) as journal:
        ran = studies.run_missing(words, journal, "sweeping", backend)
        written = output.Written()
        found = SweepResult.of(journal)
        files: list[Path] = []
        with written.part():
            files = found.write(directory, endings)
        done, failed, about = ran.done, ran.failed, studies.about(words, ran)
        if found.broken:
            written.broken.append(
                f"in {found.broken} of {done} cases (claim_kept) the coupling claims to be passive, and was not"
            )
        reasons = found.errors
        if failed:
            words.print(f"{failed} of {ran.total} cases failed:", style="yellow")
            for why, times in reasons.most_common(studies.REASONS):
                words.print(f"  {times} x {why}", markup=False)
        if files:
            figure = f"; a figure: hapnet sweep plot {directory}" * (done > failed)
            words.print(f"results: {', '.join(map(str, files))}{figure}", markup=False)
        with written.part():
            output.write_json({**about, "errors": dict(reasons), "files": [str(file) for file in files]}, json_to)
        if ran.stopped is not None:
            return studies.stop(ran, "the same command continues")
        from hapnet.summary.causes import INCOMPLETE  # here, since it loads numpy

        return written.code(INCOMPLETE if failed else 0)


@app.command(cls=Command, short_help="Draw the results of a sweep as a heat map.")
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
    from hapnet.ext.pictures.style import save_figure
    from hapnet.ext.pictures.sweep import draw
    from hapnet.ext.study.commands.studies import assigned
    from hapnet.ext.study.grid import grid
    from hapnet.ext.study.journal import Journal

    with closing(Journal.look(directory)) as journal:
        found = grid(journal, x, y, value, assigned("--where", where or ()), _units())
    figure = draw(found, stat, where or [], journal.name)
    along = [axis.name for axis in (found.x, found.y) if axis is not None]
    path = out or directory / f"{'-'.join([found.metric, *along])}.png"
    save_figure(figure, path)
    output.console(None).print(f"figure: {path}", markup=False)
    return 0


def _show(console: Console, cases: list[Case], directory: Path) -> None:
    seeds = len({case.seed for case in cases})
    console.print(f"{len(cases)} cases, {seeds} seed{'s' * (seeds != 1)}, into {directory}", markup=False)
    for case in [*cases[:_SHOWN], *cases[max(_SHOWN, len(cases) - _SHOWN) :]]:
        if case.number == len(cases) - _SHOWN > _SHOWN:
            console.print("  ...")
        settings = [f"{name} = {value_words(name, value)}" for name, value in case.values.items()]
        console.print(f"  {case.number}: {', '.join([*settings, f'{SEED} = {case.seed}'])}", markup=False)


def _units() -> dict[str, str]:
    """The units of the parameters that have one."""
    return {name: unit[1] for name, _, meaning in Params().described() if (unit := re.search(r"\[([^]]+)\]", meaning))}
