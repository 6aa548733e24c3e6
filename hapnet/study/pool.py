"""Workers on this machine: processes that outlive their tasks, each of which may die without harm to the others.

`concurrent.futures` gives up all that is under way when one process is killed, and `multiprocessing.Pool` waits for
ever for what it was doing: hence this.
"""

from __future__ import annotations

import multiprocessing
import signal
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess

from hapnet.errors import HapnetError
from hapnet.simulation.batch.processes import for_children
from hapnet.study.backend import Outcome
from hapnet.study.task import Task, run

_START_LIMIT = 3
"""So many processes in a row that died before they were ready: the next would too."""
_END_S = 2.0


@dataclass
class _Worker:
    process: BaseProcess
    pipe: Connection
    ready: bool = False
    task: Task | None = None


class LocalPool:
    """So many processes, as a `Backend`.

    Raises
    ------
    HapnetError : from `wait`, when processes do not start.
    """

    def __init__(self, workers: int) -> None:
        self._context = multiprocessing.get_context("spawn")
        self._stillborn = 0
        self._workers: list[_Worker] = []
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
        return sum(worker.task is None for worker in self._workers)

    def submit(self, task: Task) -> None:
        worker = next(worker for worker in self._workers if worker.task is None)
        worker.task = task
        with suppress(OSError):  # it is dead: `wait` will see
            worker.pipe.send(task)

    def wait(self, limit_s: float) -> list[Outcome]:
        ready = wait([worker.pipe for worker in self._workers], limit_s)
        outcomes = [self._hear(worker) for worker in list(self._workers) if worker.pipe in ready]
        return [outcome for outcome in outcomes if outcome is not None]

    def close(self) -> None:
        for worker in self._workers:
            worker.process.kill()
            worker.pipe.close()
        for worker in self._workers:
            worker.process.join(_END_S)
        self._workers.clear()

    def _hear(self, worker: _Worker) -> Outcome | None:
        try:
            results = worker.pipe.recv()
        except (EOFError, OSError):
            return self._bury(worker)
        if not worker.ready:
            worker.ready, self._stillborn = True, 0
            return None
        task, worker.task = worker.task, None
        assert task is not None
        return Outcome(task, results)

    def _bury(self, worker: _Worker) -> Outcome | None:
        """Another takes the place of one that died."""
        worker.process.join(_END_S)
        code = worker.process.exitcode
        self._workers.remove(worker)
        worker.pipe.close()
        how = _died(code)
        self._stillborn += not worker.ready
        if self._stillborn >= _START_LIMIT:
            raise HapnetError(f"worker processes do not start: {how}")
        self._start()
        return None if worker.task is None else Outcome(worker.task, None, f"its worker {how}")

    def _start(self) -> None:
        ours, theirs = self._context.Pipe()
        process = self._context.Process(target=_serve, args=(theirs,), daemon=True, name="hapnet-sweep")
        with for_children():
            process.start()
            theirs.close()  # the child holds the only one: when it dies, ours is at its end
            self._workers.append(_Worker(process, ours))  # before Ctrl-C may come again: it is one to be closed


def _serve(pipe: Connection) -> None:
    """A worker's life; it ends when nobody is left to hear of results. Ctrl-C, held back so far, is for who waits."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(EOFError, OSError):
        pipe.send(None)
        while True:
            pipe.send(run(pipe.recv()))


def _died(code: int | None) -> str:
    if code is not None and code < 0:
        with suppress(ValueError):
            name = signal.Signals(-code).name
            return f"was killed by {name}{', out of memory perhaps' if name == 'SIGKILL' else ''}"
    return f"ended by itself with exit code {code}"
