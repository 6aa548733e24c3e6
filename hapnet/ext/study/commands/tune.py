"""`hapnet tune`: searches the parameters that are best for an objective."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hapnet.commands import complete, flags, output
from hapnet.ext.study.commands import flags as own
from hapnet.ext.study.spec import SEED, in_file, value_words

if TYPE_CHECKING:
    from rich.console import Console

    from hapnet.ext.study.journal import Journal
    from hapnet.ext.study.search import Search
    from hapnet.ext.study.tune_spec import TuneSpec

TRIALS, FOUND, FIGURE = "trials.csv", "found.toml", "tune.png"
"""The files beside the journal."""


def tune(
    spec: Annotated[
        Path,
        typer.Argument(
            metavar="SPEC.toml", help="Searched parameters, objective and cases.", autocompletion=complete.specs
        ),
    ],
    workers: own.Workers = 0,
    dask: own.Dask = None,
    assign: flags.Assign = None,
    dry_run: Annotated[
        bool, own.dry_run("Check the spec, list what would run, estimate the time by a few cases.")
    ] = False,
    retry_failed: own.RetryFailed = False,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Discard all results of this tuning, and start again.")
    ] = False,
    json_to: flags.Json = None,
    out: Annotated[Path | None, flags.out_in("runs/tune-<SPEC>")] = None,
) -> int:
    """SPEC.toml has the parameters with their ranges, the objective, the constraints, and the cases as in a sweep: see
    examples/tune/pspm.toml. After a stop or a crash the same command continues.

    Writes found.toml (for --params), trials.csv, a figure, results.csv with all cases, and journal.sqlite.
    """
    from hapnet.ext.study import tune_results
    from hapnet.ext.study.commands import studies
    from hapnet.ext.study.search import Search, base, most_cases
    from hapnet.ext.study.search_space import need_library
    from hapnet.ext.study.tune_spec import TuneSpec

    words = output.console(json_to)
    backend = studies.workers_of(words, workers, dask)
    with in_file(spec):
        wanted = TuneSpec.read(spec, studies.assigned("--set", assign or ()))
    need_library()
    directory = out or Path("runs") / f"tune-{wanted.name}"
    tuned, scored = base(wanted)
    whole = wanted.whole(wanted.defaults)
    if dry_run:
        can_run = studies.check_cases(words, whole, [*tuned, *scored])
        _show(words, wanted, directory)
        studies.estimate_cases(words, whole.fixed, can_run, most_cases(wanted), workers, dask)
        return 0
    cases = [*tuned, *scored]
    with studies.journal_of(words, whole, cases, directory, fresh=fresh, retry_failed=retry_failed) as journal:
        search = Search(wanted, journal)
        ran = studies.run_missing(words, journal, "tuning", backend, search.rounds(), most_cases(wanted))
        about = studies.about(words, ran)
        written = output.Written()
        files = _write(search, journal, directory, written, ended=ran.stopped is None)
        if ran.stopped is None:
            _report(words, search, written)
        if files:
            words.print(f"files: {', '.join(files)} in {directory}", markup=False)
        with written.part():
            whole_result = {**about, **tune_results.as_dict(search), "files": [str(directory / name) for name in files]}
            output.write_json(whole_result, json_to)
        if ran.stopped is not None:
            return studies.stop(ran, "the same command continues")
        return written.code()


def _write(search: Search, journal: Journal, directory: Path, written: output.Written, *, ended: bool) -> list[str]:
    """Write the files; returns their names. The values found are written only if the search has `ended`."""
    from hapnet.ext.pictures.style import save_figure
    from hapnet.ext.study import tune_results
    from hapnet.ext.study.figures import tuned
    from hapnet.ext.study.sweep import SweepResult

    files: list[str] = []
    with written.part():
        cases = SweepResult.of(journal)
        if cases.broken:
            of = f"in {cases.broken} of {len(cases)} cases (claim_kept)"
            written.broken.append(f"{of} the coupling claims to be passive, and was not")
        files += [path.name for path in cases.write(directory, ("csv",))]
    if not search.trials:
        return files
    with written.part():
        tune_results.write_trials(search, directory / TRIALS)
        files.append(TRIALS)
    with written.part():
        save_figure(tuned(search), directory / FIGURE)
        files.append(FIGURE)
    if search.best is None or not ended:
        (directory / FOUND).unlink(missing_ok=True)  # it may be from another search with the same cases
    else:
        with written.part():
            tune_results.write_found(search.spec, search.trials[search.best].values, directory / FOUND)
            files.append(FOUND)
    return files


def _report(console: Console, search: Search, written: output.Written) -> None:
    """Print the tables, and note why a result is not good."""
    from hapnet.ext.study import tune_results

    scores, best = search.scores, search.best
    assert scores is not None
    for table in tune_results.tables(search.spec, scores):
        console.print(table)
    for name in search.unmeasured:
        output.show_warnings(console, (f"no tuning case has a value of {name}: it had no influence on the search",))
    if best is None:
        verdicts = search.verdicts()
        nearest = min(range(len(verdicts)), key=lambda i: verdicts[i].excess)
        why = [str(one) for one, held in zip(search.spec.goal.constraints, verdicts[nearest].held, strict=True)
               if not held.met]  # fmt: skip
        line = f"no trial of {len(verdicts)} keeps all constraints and has a finite objective; the nearest, {nearest},"
        without = "has cases that failed" if verdicts[nearest].failed else "has too many cases without a value"
        written.missing.append(f"{line} {'breaks: ' + ', '.join(why) if why else without}")
        return
    default, found = scores[0].verdicts(search.spec)
    assert found is not None
    if search.trials[best].values == search.spec.defaults:
        console.print("no trial is better than the defaults")
    elif default.allowed and default.objective <= found.objective:
        console.print("the defaults, which are outside of the ranges, are better than every trial", style="yellow")
    _, scored = scores[1].verdicts(search.spec)
    if scored is not None and scored.failed:
        written.missing.append(f"{scored.failed} of the scoring cases failed with the values found")
    elif scored is not None and not scored.allowed:
        console.print("in the scoring cases the values found break a constraint", style="yellow")


def _show(console: Console, spec: TuneSpec, directory: Path) -> None:
    from hapnet.ext.study.search import base
    from hapnet.ext.study.tune_results import PARTS

    tuned, scored = base(spec)
    console.print(
        f"{spec.trials} trials of {len(tuned)} cases, scored on {len(scored)} others, into {directory}", markup=False
    )
    for one in spec.space:
        console.print(f"  {one.name}: {one}, default {value_words(one.name, one.default)}", markup=False)
    for heading, parts in (("objective", spec.goal.terms), ("constraints", spec.goal.constraints)):
        console.print(f"  {heading}: {', '.join(map(str, parts)) or 'none'}", markup=False)
    own = {one.name for one in spec.space}
    for part, cases in zip(PARTS, (tuned, scored), strict=True):
        case = cases[0]
        shown = [f"{name} = {value_words(name, value)}" for name, value in case.values.items() if name not in own]
        console.print(f"  first case of {part}: {', '.join([*shown, f'{SEED} = {case.seed}'])}", markup=False)
