"""Runs the cases of a journal that have no result, for `hapnet sweep`, `hapnet compare` and `hapnet tune`."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hapnet.commands import output
from hapnet.commands.progress import Progress
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.simulation.processes import usable_cores
from hapnet.study.backend import Backend, local_workers
from hapnet.study.case import check
from hapnet.study.journal import Journal
from hapnet.study.runner import Sweep
from hapnet.study.spec import Case, Spec, params_of
from hapnet.study.task import reason

if TYPE_CHECKING:
    from rich.console import Console

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
    words: Console,
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
        output.show_warnings(words, (text,))
    total, before, _ = journal.count()
    most = max(most, total)
    began = time.monotonic()
    stopped: KeyboardInterrupt | HapnetError | None = None
    workers: Backend | None = None
    try:
        with Progress(words, doing, most, "cases") as progress:
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


def local_or_dask(words: Console, workers: int, dask: str | None, cases: int) -> Backend:
    """`workers` processes of this machine (0: one per core; no more than `cases`), or those of the scheduler at `dask`.

    Raises
    ------
    InvalidParameter, HapnetError : as `DaskCluster` does.
    """
    if dask is None:
        return local_workers(min(workers or usable_cores(), cases))
    from hapnet.study.cluster import DaskCluster

    cluster = DaskCluster(dask)
    if cluster.threaded:
        output.show_warnings(words, ("the cluster's workers have several threads; dask worker --nthreads 1 is faster",))
    return cluster


def check_cases(words: Console, spec: Spec, cases: Sequence[Case]) -> None:
    """Check the cases before any is run, and print what is wrong; raises HapnetError if none can run."""
    sets: dict[str, list[Case]] = {}
    for case in cases:
        sets.setdefault(case.parameters, []).append(case)
    warnings = Counter[str]()
    wrong: list[str] = []
    with Progress(words, "checking", len(sets), "sets of parameters") as progress:
        for done, alike in enumerate(sets.values(), 1):
            try:
                warnings.update(check(params_of(spec.fixed, alike[0].values)))
            except Exception as error:  # a user's own scene may raise anything
                wrong += [reason(error)] * len(alike)
            progress.update(done)
    if len(wrong) == len(cases):
        raise HapnetError(f"no case can run; the first: {wrong[0]}")
    if wrong:
        line = f"{len(wrong)} of {len(cases)} cases cannot run; the first: {wrong[0]}"
        words.print(line, style="yellow", markup=False)
    for warning, times in warnings.most_common(REASONS):
        output.show_warnings(words, (f"{warning} (in {times} of {len(sets)} sets of parameters)",))


def assigned(flag: str, given: Sequence[str]) -> dict[str, str]:
    """The names and values of several NAME=VALUE. Raises InvalidParameter."""
    found: dict[str, str] = {}
    for word in given:
        name, equals, value = word.partition("=")
        if not equals:
            raise InvalidParameter(flag, word, "NAME=VALUE")
        found[name.strip()] = value.strip()
    return found
