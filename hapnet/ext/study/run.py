"""Runs the cases of a journal that have no result, for commands and for functions of `hapnet`."""

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
"""Called now and then with the number of finished cases and the number of all cases."""


@dataclass(frozen=True)
class Ran:
    """The numbers of cases after a run: in `total`, with a result `before`, and `done` now.

    stopped : the exception that ended the run early; None: all cases are done.
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

    rounds : each step may add cases, which are run before the next step. most : the largest final number of cases.

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
    """The parameters of some cases without a result, each with its share of the ticks of `count` such cases."""
    some = spread(journal.pending())
    for case in some:
        with suppress(HapnetError, NetemError):  # the error becomes the result of this case
            params = params_of(journal.fixed, case.given)
            yield params, count / len(some) * params.duration_s * params.device.servo_hz


def run_all(
    journal: Journal, workers: int, progress: Progress | None, rounds: Iterable[object] = (None,), most: int = 0
) -> None:
    """As `run_missing`, for a program: run to the end, or raise the exception that stopped the run.

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
    """The journal of these cases in `directory`, from which a later run continues; None: a temporary directory.

    Cases that failed before are run again.

    Raises HapnetError: the directory has another spec's journal, or cannot be written.
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
