"""Worker processes on this machine. Each runs many tasks, and may die without harm to the others.

If one process is killed, `concurrent.futures` gives up all running tasks, and `multiprocessing.Pool` waits for ever for
that process's task. Pebble survives a worker that dies during its task, but its workers share one pipe under one lock:
if a worker is killed while it holds the lock, the whole pool is lost. So here each worker has its own pipe.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeVar

from hapnet.errors import HapnetError
from hapnet.loading import cause
from hapnet.processes.start import for_children, how_it_ended

Task = TypeVar("Task")
Result = TypeVar("Result")
Progress = Callable[[float], None]
"""Called with the fraction that is done, 0 to 1."""

START_LIMIT = 3
"""The pool gives up after this many processes in a row have died before they were ready."""
_END_S = 2.0
_WAIT_S = 0.2
_PROGRESS_EVERY_S = 0.1


class WorkerDied(HapnetError):
    """The process that ran a task has ended: it was killed, or it ended by itself."""


@dataclass(frozen=True)
class EndedTask(Generic[Task, Result]):
    """A task that has ended, with its result or its error, which is `WorkerDied` if the process ended."""

    task: Task
    result: Result | None
    error: Exception | None = None


@dataclass
class _Worker(Generic[Task]):
    process: BaseProcess
    pipe: Connection
    ready: bool = False
    task: Task | None = None
    share: float = 0.0


class WorkerPool(Generic[Task, Result]):
    """`workers` processes, each of which runs ``work(task, progress)`` for one task at a time.

    work : a function at the top level of a module that the processes import. Tasks and results must be picklable; no
    task is None.

    Raises HapnetError: from `wait`, if processes do not start.
    """

    def __init__(self, work: Callable[[Task, Progress], Result], workers: int) -> None:
        self._work = work
        self._context = multiprocessing.get_context("spawn")
        self._stillborn = 0
        self._workers: list[_Worker[Task]] = []
        try:
            for _ in range(workers):
                self._start()
        except BaseException:
            self.close()
            raise

    @property
    def workers(self) -> int:
        return len(self._workers)

    @property
    def room(self) -> int:
        """Number of tasks that may be submitted now."""
        return sum(worker.task is None for worker in self._workers)

    @property
    def shares(self) -> float:
        """The sum of the fractions done of the running tasks."""
        return sum(worker.share for worker in self._workers)

    def submit(self, task: Task) -> None:
        worker = next(worker for worker in self._workers if worker.task is None)
        worker.task = task
        with suppress(OSError):  # the worker is dead: `wait` will notice
            worker.pipe.send(task)

    def wait(self, limit_s: float) -> list[EndedTask[Task, Result]]:
        """Return the tasks that have ended since the last call; waits up to `limit_s` for a worker's message."""
        ready = wait([worker.pipe for worker in self._workers], limit_s)
        outcomes = [self._receive(worker) for worker in list(self._workers) if worker.pipe in ready]
        return [outcome for outcome in outcomes if outcome is not None]

    def close(self) -> None:
        """Kill the processes, even in the middle of a task."""
        for worker in self._workers:
            worker.process.kill()
            worker.pipe.close()
        for worker in self._workers:
            worker.process.join(_END_S)
        self._workers.clear()

    def _receive(self, worker: _Worker[Task]) -> EndedTask[Task, Result] | None:
        try:
            kind, value = worker.pipe.recv()
        except (EOFError, OSError):
            return self._replace(worker)
        if kind == "ready":
            worker.ready, self._stillborn = True, 0
            return None
        if kind == "share":
            worker.share = value
            return None
        task, worker.task, worker.share = worker.task, None, 0.0
        assert task is not None
        return EndedTask(task, value) if kind == "result" else EndedTask(task, None, value)

    def _replace(self, worker: _Worker[Task]) -> EndedTask[Task, Result] | None:
        """Replace a process that died."""
        worker.process.join(_END_S)
        self._workers.remove(worker)
        worker.pipe.close()
        how = how_it_ended(worker.process.exitcode)
        how += ", perhaps out of memory" * how.endswith("SIGKILL")
        self._stillborn += not worker.ready
        if self._stillborn >= START_LIMIT:
            raise HapnetError(f"worker processes do not start: {how}")
        self._start()
        return None if worker.task is None else EndedTask(worker.task, None, WorkerDied(f"its worker {how}"))

    def _start(self) -> None:
        ours: Any
        ours, theirs = self._context.Pipe()  # of another class on Windows
        process = self._context.Process(target=_serve, args=(theirs, self._work), daemon=True, name="hapnet-worker")
        resource_tracker.ensure_running()  # started together with the first process, it would unblock Ctrl-C there
        with for_children(one_thread=True):
            process.start()
            theirs.close()  # only the child holds it now: when it dies, our end reads EOF
            self._workers.append(_Worker(process, ours))  # before Ctrl-C is unblocked, so that `close` ends it too


def in_processes(
    work: Callable[[Sequence[Task], Progress], list[Result]],
    shares: Sequence[Sequence[Task]],
    progress: Progress | None = None,
) -> list[list[Result]]:
    """Run ``work(share, progress)`` for every share, each in its own process. Returns results in the shares' order.

    `progress` is called with the mean of the workers' progress.

    Raises HapnetError: a process died, for example because memory ran out. Also whatever `work` raises.
    """
    found: list[list[Result] | None] = [None] * len(shares)
    pool = WorkerPool(work, len(shares))
    try:
        for cases in shares:
            pool.submit(cases)
        while None in found:
            for outcome in pool.wait(_WAIT_S):
                if isinstance(outcome.error, WorkerDied):
                    raise HapnetError(f"some of the runs are missing: {outcome.error}")
                if outcome.error is not None:
                    raise outcome.error
                found[next(k for k, cases in enumerate(shares) if cases is outcome.task)] = outcome.result
            if progress is not None:
                progress((len(shares) - found.count(None) + pool.shares) / len(shares))
    finally:
        pool.close()
    return [part for part in found if part is not None]


def dealt(
    work: Callable[[Sequence[Task], Progress], list[Result]],
    tasks: Sequence[Task],
    workers: int,
    progress: Progress | None = None,
) -> list[Result]:
    """Deal the tasks to this many processes, as cards are dealt, and return the results in the tasks' order.

    `work` and errors are as with `in_processes`.
    """
    parts = in_processes(work, [tasks[k::workers] for k in range(workers)], progress)
    return [parts[k % workers][k // workers] for k in range(len(tasks))]


def usable_cores() -> int:
    """Number of cores that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _serve(pipe: Connection, work: Callable[[Any, Progress], Any]) -> None:
    """Run a worker's main loop until its pipe has no reader. It ignores Ctrl-C, which is for the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(EOFError, OSError):
        pipe.send(("ready", None))
        while True:
            task = pipe.recv()
            try:
                answer = "result", work(task, _reporter(pipe))
            except Exception as error:
                answer = "error", _picklable(error)
            pipe.send(answer)


def _reporter(pipe: Connection) -> Progress:
    """A progress function that sends the fraction only from time to time, however often it is called."""
    last_s = 0.0

    def report(share: float) -> None:
        nonlocal last_s
        if (now_s := time.monotonic()) - last_s >= _PROGRESS_EVERY_S:
            last_s = now_s
            with suppress(OSError):
                pipe.send(("share", share))

    return report


def _picklable(error: Exception) -> Exception:
    """`error`, or an error with its message if it cannot be pickled."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # a user's class may raise anything
        return HapnetError(cause(error))
    return error
