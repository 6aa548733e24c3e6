"""Parts that `hapnet sweep`, `hapnet compare` and `hapnet tune` share: progress bars, checks, estimates, flags."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from hapnet.commands import output
from hapnet.commands.progress import Progress, duration
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.study import backend as backends, run as running
from hapnet.ext.study.backend import Backend
from hapnet.ext.study.case import check
from hapnet.ext.study.journal import NAME, Journal
from hapnet.ext.study.run import Ran
from hapnet.ext.study.spec import Case, Spec, Values, params_of
from hapnet.ext.study.task import mean_seconds, reason, run_case
from hapnet.processes.pool import usable_cores

if TYPE_CHECKING:
    from rich.console import Console

Part = TypeVar("Part")

INTERRUPTED = 130

REASONS = 3
"""The number of the most frequent reasons or warnings that are shown."""


@contextmanager
def journal_of(
    console: Console, spec: Spec, cases: Sequence[Case], directory: Path, *, fresh: bool, retry_failed: bool
) -> Iterator[Journal]:
    """The journal of these cases in `directory`; a new journal's cases are checked first. Prints how many are done."""
    if fresh or not (directory / NAME).exists():
        check_cases(console, spec, cases)
    with closing(Journal.create_or_resume(output.run_directory(directory, None), spec, cases, fresh=fresh)) as journal:
        again = journal.forget_failed() if retry_failed else 0
        if (before := journal.count()[1]) or again:
            console.print(f"{before} cases are done{f'; {again} failed and are run again' * bool(again)}")
        yield journal


def about(console: Console, ran: Ran) -> dict[str, Any]:
    """Return the numbers of a study's run, for its JSON; print its speed."""
    new = ran.done - ran.before
    if new:
        console.print(f"{new} cases in {ran.lasted_s:.1f} s: {new / ran.lasted_s:.1f} a second")
    return {"cases": ran.total, "done": ran.done, "failed": ran.failed, "run": new, "wall_s": ran.lasted_s}


def run_missing(
    console: Console,
    journal: Journal,
    doing: str,
    backend: Callable[[int], Backend],
    rounds: Iterable[object] = (None,),
    most: int = 0,
) -> Ran:
    """As `hapnet.ext.study.run.run_missing`, with a progress bar, and a warning if another version began the study."""
    if journal.other_version is not None:
        text = f"hapnet {journal.other_version} ran the first of these cases; its results are kept, but may differ"
        output.show_warnings(console, (text,))
    with Progress(output.progress_console(console), doing, max(most, journal.count()[0]), "cases") as bar:
        return running.run_missing(journal, backend, lambda done, _: bar.update(done), rounds, most)


def stop(ran: Ran, how_to_go_on: str) -> int:
    """The exit code of a stopped study; prints how to continue it. Raises HapnetError if an error stopped it."""
    line = f"{ran.done} of {ran.total} cases are done; {how_to_go_on}"
    if isinstance(ran.stopped, HapnetError):
        raise HapnetError(f"{ran.stopped}: {line}") from ran.stopped
    output.complain(f"stopped: {line}")
    return INTERRUPTED


def workers_of(console: Console, workers: int, dask: str | None) -> Callable[[int], Backend]:
    """Return a function that, for a number of cases, starts `workers` processes here (0: one per core), or connects to
    the workers of the scheduler at `dask`.

    Raises InvalidParameter, HapnetError: as `DaskCluster` does, once it is called.
    """
    if dask is None:
        return lambda cases: backends.local_workers(min(workers or usable_cores(), cases))
    if workers:
        raise InvalidParameter("--workers", workers, "", why="with --dask the cluster has its own; leave it out")

    def cluster(_: int) -> Backend:
        from hapnet.ext.study.cluster import DaskCluster

        found = DaskCluster(dask)
        if found.threaded:
            line = "the cluster's workers have several threads; dask worker --nthreads 1 is faster"
            output.show_warnings(console, (line,))
        return found

    return cluster


def check_cases(console: Console, spec: Spec, cases: Sequence[Case]) -> list[Case]:
    """The cases that can run. Prints the first error of the others; raises HapnetError if no case can run."""
    sets: dict[str, list[Case]] = {}
    for case in cases:
        sets.setdefault(case.parameters, []).append(case)
    warnings = Counter[str]()
    wrong: list[str] = []
    can_run: list[Case] = []
    with Progress(output.progress_console(console), "checking", len(sets), "sets of parameters") as progress:
        for done, alike in enumerate(sets.values(), 1):
            try:
                warnings.update(check(params_of(spec.fixed, alike[0].values)))
            except Exception as error:  # a user's own scene may raise anything
                wrong += [reason(error)] * len(alike)
            else:
                can_run += alike
            progress.update(done)
    if len(wrong) == len(cases):
        raise HapnetError(f"no case can run; the first: {wrong[0]}")
    if wrong:
        line = f"{len(wrong)} of {len(cases)} cases cannot run; the first: {wrong[0]}"
        console.print(line, style="yellow", markup=False)
    for warning, times in warnings.most_common(REASONS):
        output.show_warnings(console, (f"{warning} (in {times} of {len(sets)} sets of parameters)",))
    return can_run


@dataclass(frozen=True)
class PartKind(Generic[Part]):
    """Parts of a study that take about the same time.

    name : of a part. some : the parts to time. count : the number of all parts. times : the factor from the time of
    `run`, which may run only a section of a part, to the time of the whole part.
    """

    name: str
    some: Sequence[Part]
    count: int
    times: float = 1.0


def estimate_cases(
    console: Console, fixed: Values, cases: Sequence[Case], count: int, workers: int, dask: str | None = None
) -> None:
    """Print how long `count` such cases take, from a few of them. `workers` and `dask` are as in `workers_of`."""
    failed: list[str] = []

    def run(case: Case) -> None:
        if (error := run_case(fixed, case).error) is not None:
            failed.append(error)

    estimate(console, run, [PartKind("case", cases, count)], workers, dask)
    if failed:
        output.show_warnings(console, (f"the estimate may be wrong, as cases failed; the first: {failed[0]}",))


def estimate(
    console: Console,
    run: Callable[[Part], object],
    kinds: Sequence[PartKind[Part]],
    workers: int,
    dask: str | None = None,
) -> None:
    """Print how long ``run(part)`` takes for all parts, from a few of each kind."""
    lines, sum_s, parts = [], 0.0, 0
    with Progress(output.progress_console(console), "running a few cases to estimate the time"):
        for kind in kinds:
            mean_s, of = mean_seconds(run, kind.some)
            mean_s *= kind.times
            lines.append(f"a {kind.name} takes {mean_s:.2g} s (mean of {of})")
            sum_s, parts = sum_s + mean_s * kind.count, parts + kind.count
    if dask is not None:
        lines.append(f"all of them, {duration(sum_s)} in total, shared by the cluster's workers")
    else:
        at_once = min(workers or usable_cores(), parts)
        lines.append(f"all of them, with {at_once} worker{'s' * (at_once > 1)}: about {duration(sum_s / at_once)}")
    console.print("; ".join(lines))


def names_of(given: Sequence[str] | None) -> list[str]:
    """The names from a flag that may be repeated, and may have several names separated by commas."""
    return [name.strip() for names in given or () for name in names.split(",")]


def deadbands(text: str) -> list[float]:
    """The Weber fractions of ``0,0.1``."""
    try:
        found = [float(word) for word in text.split(",")]
    except ValueError:
        found = []
    if not found or not all(0.0 <= fraction <= 1.0 for fraction in found):
        raise InvalidParameter("--deadband", text, "Weber fractions from 0 (none) to 1, such as 0,0.1")
    return found


def assigned(flag: str, given: Sequence[str]) -> dict[str, str]:
    """Split several NAME=VALUE into names and values. Raises InvalidParameter."""
    found: dict[str, str] = {}
    for word in given:
        name, equals, value = word.partition("=")
        if not equals:
            raise InvalidParameter(flag, word, "NAME=VALUE")
        found[name.strip()] = value.strip()
    return found
