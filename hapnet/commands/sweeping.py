"""The work of `hapnet sweep` and `hapnet sweep plot`."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hapnet.commands import output
from hapnet.commands.studies import REASONS, assigned, check_cases, estimate_cases, local_or_dask, run_missing
from hapnet.errors import InvalidParameter
from hapnet.params import Params
from hapnet.study import export
from hapnet.study.journal import NAME, Journal
from hapnet.study.spec import SEED, Case, Spec, in_file, value_words

if TYPE_CHECKING:
    from rich.console import Console

_SHOWN = 3  # cases that --dry-run shows at each end of the list


@dataclass(frozen=True)
class Options:
    """How to run a sweep: see `hapnet sweep --help`."""

    workers: int = 0
    dask: str | None = None
    table: str = "auto"
    dry_run: bool = False
    retry_failed: bool = False
    fresh: bool = False


def run(file: Path, assignments: list[str], how: Options, json_to: str | None, out: Path | None) -> int:
    """Run the cases without a result, and write the results of all.

    Returns 3 if cases failed (their rows lack measures), 4 if the coupling of a case claims to be passive but was not.
    """
    endings = export.formats(how.table)
    if how.dask is not None and how.workers:
        raise InvalidParameter("--workers", how.workers, "left out with --dask: the cluster has its own")
    words = output.console(json_to)
    with in_file(file):
        spec = Spec.read(file, assigned("--set", assignments))
    directory = out or Path("runs") / f"sweep-{spec.name}"
    cases = spec.cases()
    if (twice := spec.count - len(cases)) > 0:
        words.print(f"{twice} cases are repetitions in the spec: each case is run once")
    if how.dry_run:
        can_run = check_cases(words, spec, cases)
        _show(words, spec, cases, directory)
        estimate_cases(words, spec.fixed, can_run, len(can_run), how.workers, how.dask)
        return 0
    if how.fresh or not (directory / NAME).exists():
        check_cases(words, spec, cases)
    journal = Journal.create_or_resume(output.run_directory(directory, None), spec, cases, fresh=how.fresh)
    try:
        return _run(words, journal, directory, how, endings, json_to)
    finally:
        journal.close()


def plot(
    directory: Path,
    x: str | None,
    y: str | None,
    metric: str | None,
    where: list[str],
    stat: str | None,
    out: Path | None,
) -> int:
    """Draw the figure, and print its path."""
    from hapnet.report.files import save_figure
    from hapnet.study.grid import grid
    from hapnet.study.heatmap import draw

    journal = Journal.look(directory)
    try:
        found = grid(journal, x, y, metric, assigned("--where", where), _units())
    finally:
        journal.close()
    figure = draw(found, stat, where, journal.name)
    along = [axis.name for axis in (found.x, found.y) if axis is not None]
    path = out or directory / f"{'-'.join([found.metric, *along])}.png"
    save_figure(figure, path)
    output.console(None).print(f"figure: {path}", markup=False)
    return 0


def _run(
    words: Console, journal: Journal, directory: Path, how: Options, endings: tuple[str, ...], json_to: str | None
) -> int:
    again = journal.forget_failed() if how.retry_failed else 0
    total, before, _ = journal.count()
    if before or again:
        words.print(f"{before} of {total} cases are done{f'; {again} failed and are run again' * bool(again)}")
    ran = run_missing(words, journal, "sweeping", lambda cases: local_or_dask(words, how.workers, how.dask, cases))
    written = output.Written()
    columns = export.table(journal)
    files: list[Path] = []
    with written.part():
        files = export.write(columns, directory, endings)
    done, failed, new = ran.done, ran.failed, ran.done - before
    if new:
        words.print(f"{new} cases in {ran.lasted_s:.1f} s: {new / ran.lasted_s:.1f} a second")
    broken = sum(value == 0.0 for value in columns.get("claim_kept", ()))
    if broken:
        written.broken.append(
            f"in {broken} of {done} cases (claim_kept) the coupling claims to be passive, and was not"
        )
    reasons = Counter(error for error in columns["error"] if error is not None)
    if failed:
        words.print(f"{failed} of {total} cases failed:", style="yellow")
        for why, times in reasons.most_common(REASONS):
            words.print(f"  {times} x {why}", markup=False)
    if files:
        figure = f"; a figure: hapnet sweep plot {directory}" * (done > failed)
        words.print(f"results: {', '.join(map(str, files))}{figure}", markup=False)
    with written.part():
        about = {"cases": total, "done": done, "failed": failed, "run": new, "wall_s": ran.lasted_s}
        output.write_json({**about, "errors": dict(reasons), "files": [str(file) for file in files]}, json_to)
    if ran.stopped is not None:
        return ran.stop("the same command goes on")
    return written.code(output.INCOMPLETE if failed else 0)


def _show(words: Console, spec: Spec, cases: list[Case], directory: Path) -> None:
    seeds = len({case.seed for case in cases})
    words.print(f"{len(cases)} cases, {seeds} seed{'s' * (seeds != 1)}, into {directory}", markup=False)
    for case in [*cases[:_SHOWN], *cases[max(_SHOWN, len(cases) - _SHOWN) :]]:
        if case.number == len(cases) - _SHOWN > _SHOWN:
            words.print("  ...")
        told = [f"{name} = {value_words(name, value)}" for name, value in case.values.items()]
        words.print(f"  {case.number}: {', '.join([*told, f'{SEED} = {case.seed}'])}", markup=False)


def _units() -> dict[str, str]:
    """The units of the parameters that have one."""
    return {name: unit[1] for name, _, meaning in Params().described() if (unit := re.search(r"\[([^]]+)\]", meaning))}
