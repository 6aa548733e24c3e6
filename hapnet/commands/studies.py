"""Runs the cases of a journal that have no result, for `hapnet sweep`, `hapnet compare` and `hapnet tune`."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

from hapnet.commands import output
from hapnet.commands.progress import Progress, duration
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.params import Params
from hapnet.processes.pool import usable_cores
from hapnet.simulation.compiled import coverage
from hapnet.study.backend import Backend, local_workers
from hapnet.study.case import check
from hapnet.study.estimate import mean_seconds, spread
from hapnet.study.journal import Journal
from hapnet.study.runner import Sweep
from hapnet.study.spec import Case, Spec, Values, params_of
from hapnet.study.task import reason, run_case

if TYPE_CHECKING:
    from rich.console import Console

Part = TypeVar("Part")

INTERRUPTED = 130

REASONS = 3
"""Of many reasons or warnings the most frequent ones are shown."""


@dataclass(frozen=True)
class StudyOutcome:
    """The state of the cases after a run: their `total`, how many had a result `before`, and how many are `done` now.

    stopped : what ended the run before all were done; None: nothing did.
    """

    total: int
    before: int
    done: int
    failed: int
    lasted_s: float
    stopped: KeyboardInterrupt | HapnetError | None

    def stop(self, how_to_go_on: str) -> int:
        """The exit code of a stopped study; prints how to continue it. Raises HapnetError if an error stopped it."""
        line = f"{self.done} of {self.total} cases are done; {how_to_go_on}"
        if isinstance(self.stopped, HapnetError):
            raise HapnetError(f"{self.stopped}: {line}") from self.stopped
        output.complain(f"stopped: {line}")
        return INTERRUPTED


def run_missing(
    console: Console,
    journal: Journal,
    doing: str,
    backend: Callable[[int], Backend],
    rounds: Iterable[object] = (None,),
    most: int = 0,
) -> StudyOutcome:
    """Run the cases of `journal` that have no result, on ``backend(number of these cases)``.

    rounds : each step of it may add cases, which are run before the next step. most : so many there may be in the end.

    Raises
    ------
    HapnetError : the backend is not available; no case was run.
    """
    if journal.other_version is not None:
        text = f"hapnet {journal.other_version} ran the first of these cases: its results are kept, and may differ"
        output.show_warnings(console, (text,))
    total, before, _ = journal.count()
    most = max(most, total)
    began = time.monotonic()
    stopped: KeyboardInterrupt | HapnetError | None = None
    workers: Backend | None = None
    try:
        with Progress(output.progress_console(), doing, most, "cases") as progress:
            for _ in rounds:
                total, done, _ = journal.count()
                if done < total:
                    workers = workers or backend(most - done)
                    Sweep(journal, workers, progress.update).run()
    except (KeyboardInterrupt, HapnetError) as ended:
        if workers is None and isinstance(ended, HapnetError):
            raise
        stopped = ended
    finally:
        if workers is not None:
            workers.close()
    lasted_s = time.monotonic() - began
    total, done, failed = journal.count()
    return StudyOutcome(total if stopped is None else most, before, done, failed, lasted_s, stopped)


def workers_of(console: Console, workers: int, dask: str | None) -> Callable[[int], Backend]:
    """What makes, for so many cases, `workers` processes here (0: one per core), or those of the scheduler at `dask`.

    Raises
    ------
    InvalidParameter, HapnetError : as `DaskCluster` does, once it is called.
    """
    if dask is None:
        return lambda cases: local_workers(min(workers or usable_cores(), cases))
    if workers:
        raise InvalidParameter("--workers", workers, "left out with --dask: the cluster has its own")

    def cluster(_: int) -> Backend:
        from hapnet.study.cluster import DaskCluster

        found = DaskCluster(dask)
        if found.threaded:
            line = "the cluster's workers have several threads; dask worker --nthreads 1 is faster"
            output.show_warnings(console, (line,))
        return found

    return cluster


def check_cases(console: Console, spec: Spec, cases: Sequence[Case]) -> list[Case]:
    """The cases that can run. What is wrong with the others is printed; raises HapnetError if none can run."""
    sets: dict[str, list[Case]] = {}
    for case in cases:
        sets.setdefault(case.parameters, []).append(case)
    warnings = Counter[str]()
    wrong: list[str] = []
    can_run: list[Case] = []
    with Progress(output.progress_console(), "checking", len(sets), "sets of parameters") as progress:
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
class Kind(Generic[Part]):
    """Parts of a study that take alike.

    name : of one. some : of them. count : how many there are. params : of one. times : one takes so many times what
    `run` takes with it, if that runs less of it.
    """

    name: str
    some: Sequence[Part]
    count: int
    params: Callable[[Part], Params]
    times: float = 1.0

    @property
    def runs(self) -> Iterator[tuple[Params, float]]:
        """The parameters of a few, and how many ticks of the servo all of them have, by these."""
        known = [self.params(part) for part in spread(self.some)]
        return ((one, self.count * one.duration_s * one.device.servo_hz / len(known)) for one in known)


def estimate_cases(
    console: Console, fixed: Values, cases: Sequence[Case], count: int, workers: int, dask: str | None = None
) -> None:
    """Print how long `count` cases such as these take, by a few of them. `workers` and `dask` as `workers_of`."""
    failed: list[str] = []

    def run(case: Case) -> None:
        if (error := run_case(fixed, case).error) is not None:
            failed.append(error)

    estimate(console, run, [Kind("case", cases, count, lambda case: params_of(fixed, case.values))], workers, dask)
    if failed:
        output.show_warnings(console, (f"the estimate may be wrong, as cases failed; the first: {failed[0]}",))


def estimate(
    console: Console,
    run: Callable[[Part], object],
    kinds: Sequence[Kind[Part]],
    workers: int,
    dask: str | None = None,
) -> None:
    """Print how long ``run(part)`` takes for all parts, by a few of each kind."""
    reported, sum_s, parts = [], 0.0, 0
    with Progress(output.progress_console(), "compiling") as progress:
        coverage.compile_for(run for kind in kinds for run in kind.runs)  # as the run would
        progress.stage("running a few, to see how long they take")
        for kind in kinds:
            mean_s, of = mean_seconds(run, kind.some)
            mean_s *= kind.times
            reported.append(f"a {kind.name} takes {mean_s:.2g} s (mean of {of})")
            sum_s, parts = sum_s + mean_s * kind.count, parts + kind.count
    if dask is not None:
        reported.append(f"all of them, {duration(sum_s)} in all, shared by the cluster's workers")
    else:
        at_once = min(workers or usable_cores(), parts)
        reported.append(f"all of them, with {at_once} worker{'s' * (at_once > 1)}: about {duration(sum_s / at_once)}")
    console.print("; ".join(reported))


def assigned(flag: str, given: Sequence[str]) -> dict[str, str]:
    """The names and values of several NAME=VALUE. Raises InvalidParameter."""
    found: dict[str, str] = {}
    for word in given:
        name, equals, value = word.partition("=")
        if not equals:
            raise InvalidParameter(flag, word, "NAME=VALUE")
        found[name.strip()] = value.strip()
    return found
