"""The work of `hapnet tune`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hapnet.commands import output
from hapnet.commands.studies import assigned, check_cases, estimate_cases, local_or_dask, run_missing
from hapnet.errors import InvalidParameter
from hapnet.study import export, tune_results
from hapnet.study.journal import NAME, Journal
from hapnet.study.search import Search, base, most_cases
from hapnet.study.search_space import need_library
from hapnet.study.spec import SEED, in_file, value_words
from hapnet.study.tune_spec import TuneSpec

if TYPE_CHECKING:
    from rich.console import Console

    from hapnet.study.backend import Backend

TRIALS, FOUND, FIGURE = "trials.csv", "found.toml", "tune.png"
"""The files beside the journal."""


@dataclass(frozen=True)
class Options:
    """How to run a tuning: see `hapnet tune --help`."""

    workers: int = 0
    dask: str | None = None
    dry_run: bool = False
    retry_failed: bool = False
    fresh: bool = False


def run(file: Path, assignments: list[str], how: Options, json_to: str | None, out: Path | None) -> int:
    """Search, and write what was found.

    Returns 3 if no trial keeps all constraints or cases of the found values failed, 4 if a case was not passive whose
    coupling claims to be.
    """
    if how.dask is not None and how.workers:
        raise InvalidParameter("--workers", how.workers, "left out with --dask: the cluster has its own")
    words = output.console(json_to)
    with in_file(file):
        spec = TuneSpec.read(file, assigned("--set", assignments))
    need_library()
    directory = out or Path("runs") / f"tune-{spec.name}"
    tuned, scored = base(spec)
    whole = spec.whole(spec.defaults)
    if how.dry_run:
        can_run = check_cases(words, whole, [*tuned, *scored])
        _show(words, spec, directory)
        estimate_cases(words, whole.fixed, can_run, most_cases(spec), how.workers, how.dask)
        return 0
    if how.fresh or not (directory / NAME).exists():
        check_cases(words, whole, [*tuned, *scored])
    journal = Journal.create_or_resume(output.run_directory(directory, None), whole, [*tuned, *scored], fresh=how.fresh)
    try:
        return _run(words, spec, journal, directory, how, json_to)
    finally:
        journal.close()


def _run(words: Console, spec: TuneSpec, journal: Journal, directory: Path, how: Options, json_to: str | None) -> int:
    again = journal.forget_failed() if how.retry_failed else 0
    _, before, _ = journal.count()
    if before or again:
        words.print(f"{before} cases are done{f'; {again} failed and are run again' * bool(again)}")
    search = Search(spec, journal)

    def workers(cases: int) -> Backend:
        return local_or_dask(words, how.workers, how.dask, cases)

    ran = run_missing(words, journal, "tuning", workers, search.rounds(), most_cases(spec))
    new = ran.done - before
    if new:
        words.print(f"{new} cases in {ran.lasted_s:.1f} s: {new / ran.lasted_s:.1f} a second")
    written = output.Written()
    files = _write(search, journal, directory, written, ended=ran.stopped is None)
    if ran.stopped is None:
        _tell(words, search, written)
    if files:
        words.print(f"files: {', '.join(files)} in {directory}", markup=False)
    with written.part():
        about = {"cases": ran.total, "done": ran.done, "failed": ran.failed, "run": new, "wall_s": ran.lasted_s}
        told = {**about, **tune_results.as_dict(search), "files": [str(directory / name) for name in files]}
        output.write_json(told, json_to)
    if ran.stopped is not None:
        return ran.stop("the same command goes on")
    return written.code()


def _write(search: Search, journal: Journal, directory: Path, written: output.Written, *, ended: bool) -> list[str]:
    """Write the files; returns their names. The values found are written only if the search has `ended`."""
    from hapnet.report.files import save_figure
    from hapnet.study.tune_figure import draw

    files: list[str] = []
    with written.part():
        columns = export.table(journal)
        broken = sum(value == 0.0 for value in columns.get("claim_kept", ()))
        if broken:
            of = f"in {broken} of {len(columns['case'])} cases (claim_kept)"
            written.broken.append(f"{of} the coupling claims to be passive, and was not")
        files += [path.name for path in export.write(columns, directory, ("csv",))]
    if not search.trials:
        return files
    with written.part():
        tune_results.write_trials(search, directory / TRIALS)
        files.append(TRIALS)
    with written.part():
        save_figure(draw(search), directory / FIGURE)
        files.append(FIGURE)
    if search.best is None or not ended:
        (directory / FOUND).unlink(missing_ok=True)  # of another search with the same cases
    else:
        with written.part():
            tune_results.write_found(search.spec, search.trials[search.best].values, directory / FOUND)
            files.append(FOUND)
    return files


def _tell(words: Console, search: Search, written: output.Written) -> None:
    """Print the tables, and note what is missing from a good result."""
    scores, best = search.scores, search.best
    assert scores is not None
    for table in tune_results.tables(search.spec, scores):
        words.print(table)
    for name in search.unmeasured:
        output.show_warnings(words, (f"no case to tune on has a value of {name}: it had no part in the search",))
    if best is None:
        verdicts = search.verdicts()
        nearest = min(range(len(verdicts)), key=lambda i: verdicts[i].excess)
        why = [str(one) for one, held in zip(search.spec.goal.constraints, verdicts[nearest].held, strict=True)
               if not held.met]  # fmt: skip
        told = f"no trial of {len(verdicts)} keeps all constraints and has a finite objective; the nearest, {nearest},"
        without = "has cases that failed" if verdicts[nearest].failed else "has too many cases without a value"
        written.missing.append(f"{told} {'breaks: ' + ', '.join(why) if why else without}")
        return
    default, found = scores[0].verdicts(search.spec)
    assert found is not None
    if search.trials[best].values == search.spec.defaults:
        words.print("no trial is better than the defaults")
    elif default.allowed and default.objective <= found.objective:
        words.print("the defaults, which are outside of the ranges, are better than every trial", style="yellow")
    _, scored = scores[1].verdicts(search.spec)
    if scored is not None and scored.failed:
        written.missing.append(f"{scored.failed} of the cases to score on failed with the values found")
    elif scored is not None and not scored.allowed:
        words.print("on the cases to score on the values found break a constraint", style="yellow")


def _show(words: Console, spec: TuneSpec, directory: Path) -> None:
    tuned, scored = base(spec)
    words.print(
        f"{spec.trials} trials of {len(tuned)} cases, scored on {len(scored)} others, into {directory}", markup=False
    )
    for one in spec.space:
        words.print(f"  {one.name}: {one}, default {value_words(one.name, one.default)}", markup=False)
    for heading, told in (("objective", spec.goal.terms), ("constraints", spec.goal.constraints)):
        words.print(f"  {heading}: {', '.join(map(str, told)) or 'none'}", markup=False)
    own = {one.name for one in spec.space}
    for part, cases in zip(tune_results.PARTS, (tuned, scored), strict=True):
        case = cases[0]
        shown = [f"{name} = {value_words(name, value)}" for name, value in case.values.items() if name not in own]
        words.print(f"  first case of {part}: {', '.join([*shown, f'{SEED} = {case.seed}'])}", markup=False)
