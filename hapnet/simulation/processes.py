"""Worker processes of this machine. They outlive their tasks, and each may die without harm to the others.

`concurrent.futures` gives up everything under way when one process is killed, and `multiprocessing.Pool` waits for ever
for what that one was doing. Pebble survives a worker that dies over its task, but its workers share one pipe under one
lock: when one is killed that holds the lock, the whole pool is lost. Hence these, with a pipe for each worker.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeVar

from hapnet.errors import HapnetError
from hapnet.loading import cause

Task = TypeVar("Task")
Result = TypeVar("Result")
Progress = Callable[[float], None]
"""Called with the share that is done, 0 to 1."""

START_LIMIT = 3
"""So many processes in a row that died before they were ready: the next would too."""
_END_S = 2.0
_WAIT_S = 0.2
_SAY_EVERY_S = 0.1
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


class WorkerDied(HapnetError):
    """The process that ran a task has ended: it was killed, or it ended by itself."""


@dataclass(frozen=True)
class Outcome(Generic[Task, Result]):
    """A task that is over: its result or, if there is none, the error: what it raised, or `WorkerDied`."""

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

    work : at the top of a module, which the processes import. Tasks and results can be pickled; no task is None.

    Raises
    ------
    HapnetError : from `wait`, when processes do not start.
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
        """How many tasks may be submitted now."""
        return sum(worker.task is None for worker in self._workers)

    @property
    def shares(self) -> float:
        """The sum of the shares that the running tasks have done."""
        return sum(worker.share for worker in self._workers)

    def submit(self, task: Task) -> None:
        worker = next(worker for worker in self._workers if worker.task is None)
        worker.task = task
        with suppress(OSError):  # it is dead: `wait` will see
            worker.pipe.send(task)

    def wait(self, limit_s: float) -> list[Outcome[Task, Result]]:
        """The tasks that have ended since the last call; waits up to `limit_s` for news of one."""
        ready = wait([worker.pipe for worker in self._workers], limit_s)
        outcomes = [self._receive(worker) for worker in list(self._workers) if worker.pipe in ready]
        return [outcome for outcome in outcomes if outcome is not None]

    def close(self) -> None:
        """End the processes, with whatever they are doing."""
        for worker in self._workers:
            worker.process.kill()
            worker.pipe.close()
        for worker in self._workers:
            worker.process.join(_END_S)
        self._workers.clear()

    def _receive(self, worker: _Worker[Task]) -> Outcome[Task, Result] | None:
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
        return Outcome(task, value) if kind == "result" else Outcome(task, None, value)

    def _replace(self, worker: _Worker[Task]) -> Outcome[Task, Result] | None:
        """A new process takes the place of one that died."""
        worker.process.join(_END_S)
        self._workers.remove(worker)
        worker.pipe.close()
        how = _died(worker.process.exitcode)
        self._stillborn += not worker.ready
        if self._stillborn >= START_LIMIT:
            raise HapnetError(f"worker processes do not start: {how}")
        self._start()
        return None if worker.task is None else Outcome(worker.task, None, WorkerDied(f"its worker {how}"))

    def _start(self) -> None:
        ours, theirs = self._context.Pipe()
        process = self._context.Process(target=_serve, args=(theirs, self._work), daemon=True, name="hapnet-worker")
        with for_children():
            process.start()
            theirs.close()  # the child holds the only one: when it dies, ours is at its end
            self._workers.append(_Worker(process, ours))  # before Ctrl-C may come again: it is one to be closed


def in_processes(
    work: Callable[[Sequence[Task], Progress], list[Result]],
    shares: Sequence[Sequence[Task]],
    progress: Progress | None = None,
) -> list[list[Result]]:
    """``work(share, progress)`` for every share, each in a process of its own; the results in the order of the shares.

    `progress` is told the mean of what each `work` tells.

    Raises
    ------
    HapnetError : a process died, of lack of memory for example. Whatever `work` raises.
    """
    found: list[list[Result] | None] = [None] * len(shares)
    pool = WorkerPool(work, len(shares))
    try:
        for cases in shares:
            pool.submit(cases)
        while None in found:
            for outcome in pool.wait(_WAIT_S):
                if isinstance(outcome.error, WorkerDied):
                    raise HapnetError(f"a part of the runs is missing: {outcome.error}")
                if outcome.error is not None:
                    raise outcome.error
                found[next(k for k, cases in enumerate(shares) if cases is outcome.task)] = outcome.result
            if progress is not None:
                progress((len(shares) - found.count(None) + pool.shares) / len(shares))
    finally:
        pool.close()
    return [part for part in found if part is not None]


def usable_cores() -> int:
    """How many cores this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def for_children() -> Iterator[None]:
    """Processes started in here leave Ctrl-C to their parent, and use one thread each."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    masked = None
    if hasattr(signal, "pthread_sigmask"):
        resource_tracker.ensure_running()  # started with the first process, it would let Ctrl-C through to that one
        masked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
        if masked is not None:  # last: a Ctrl-C that came meanwhile is raised here
            signal.pthread_sigmask(signal.SIG_SETMASK, masked)


def _serve(pipe: Connection, work: Callable[[Any, Progress], Any]) -> None:
    """A worker's life; it ends when nobody is left to read results. Ctrl-C, blocked so far, is for the parent."""
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
    """Sends a share now and then only, however often it is told."""
    last_s = 0.0

    def report(share: float) -> None:
        nonlocal last_s
        if (now_s := time.monotonic()) - last_s >= _SAY_EVERY_S:
            last_s = now_s
            with suppress(OSError):
                pipe.send(("share", share))

    return report


def _picklable(error: Exception) -> Exception:
    """`error`, or its words where it does not survive the way to another process."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # a class of the user's own may do anything
        return HapnetError(cause(error))
    return error


def _died(code: int | None) -> str:
    if code is not None and code < 0:
        with suppress(ValueError):
            name = signal.Signals(-code).name
            return f"was killed by {name}{', out of memory perhaps' if name == 'SIGKILL' else ''}"
    return f"ended by itself with exit code {code}"
