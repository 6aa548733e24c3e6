"""Runs the cases of a journal that have no result, whoever asks: a command, or a function of `hapnet`."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory

from hapnet.errors import HapnetError
from hapnet.ext.study.backend import Backend, few_workers
from hapnet.ext.study.journal import Journal
from hapnet.ext.study.runner import Sweep
from hapnet.ext.study.spec import Case, Spec, params_of
from hapnet.ext.study.task import spread
from hapnet.loading import extension
from hapnet.params import Params
from hapnet.processes.pool import usable_cores
from netem.errors import NetemError

Progress = Callable[[int, int], None]
"""Called now and then with how many cases are done, and how many there are."""


@dataclass(frozen=True)
class Ran:
    """The state of the cases after a run: their `total`, how many had a result `before`, and how many are `done` now.

    stopped : what ended the run before all were done; None: nothing did.
    """

    total: int
    before: int
    done: int
    failed: int
    lasted_s: float
    stopped: KeyboardInterrupt | HapnetError | None


def run_missing(
    journal: Journal,
    backend: Callable[[int], Backend],
    progress: Progress = lambda done, total: None,
    rounds: Iterable[object] = (None,),
    most: int = 0,
) -> Ran:
    """Run the cases of `journal` that have no result, on ``backend(number of these cases)``.

    rounds : each step of it may add cases, which are run before the next step. most : so many there may be in the end.

    Raises HapnetError: the backend is not available; no case was run.
    """
    total, before, _ = journal.count()
    most = max(most, total)
    began = time.monotonic()
    stopped: KeyboardInterrupt | HapnetError | None = None
    workers: Backend | None = None
    try:
        with extension("compiled").background(_runs(journal, most - before)):
            for _ in rounds:
                total, done, _ = journal.count()
                if done < total:
                    workers = workers or backend(most - done)
                    Sweep(journal, workers, lambda done: progress(done, most)).run()
    except (KeyboardInterrupt, HapnetError) as ended:
        if workers is None and isinstance(ended, HapnetError):
            raise
        stopped = ended
    finally:
        if workers is not None:
            workers.close()
    lasted_s = time.monotonic() - began
    total, done, failed = journal.count()
    return Ran(total if stopped is None else most, before, done, failed, lasted_s, stopped)


def _runs(journal: Journal, count: int) -> Iterator[tuple[Params, float]]:
    """The parameters of some of the cases without a result, and how many ticks `count` cases have, by these."""
    some = spread(journal.pending())
    for case in some:
        with suppress(HapnetError, NetemError):  # such a case has its error as its result
            params = params_of(journal.fixed, case.given)
            yield params, count / len(some) * params.duration_s * params.device.servo_hz


def run_all(
    journal: Journal, workers: int, progress: Progress | None, rounds: Iterable[object] = (None,), most: int = 0
) -> None:
    """As `run_missing`, for a program: it runs to the end, or raises what stopped it.

    workers : processes; 1: this one, 0: one per core.
    """
    count = workers or usable_cores()
    ran = run_missing(
        journal, lambda cases: few_workers(min(count, cases)), progress or (lambda done, total: None), rounds, most
    )
    if ran.stopped is not None:
        raise ran.stopped


@contextmanager
def journal_in(
    directory: str | PathLike[str] | None, spec: Spec, cases: list[Case], *, fresh: bool = False
) -> Iterator[Journal]:
    """The journal of these cases in `directory`, where a later run goes on; None: it is kept while it is needed.

    What failed before is run again.

    Raises HapnetError: there is another spec's journal, or nothing can be written.
    """
    with TemporaryDirectory(prefix="hapnet-") as passing:
        into = Path(passing if directory is None else directory)
        try:
            into.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise HapnetError(f"cannot write to {into}: {error.strerror or error}") from None
        with closing(Journal.create_or_resume(into, spec, cases, fresh=fresh)) as journal:
            journal.forget_failed()
            yield journal
