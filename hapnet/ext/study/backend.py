"""The places where tasks run, with the same interface: processes of this machine, or a cluster."""

from __future__ import annotations

from typing import Protocol

from hapnet.ext.study.task import CaseResult, Task, run
from hapnet.processes.pool import EndedTask, Progress, WorkerPool

TaskOutcome = EndedTask[Task, list[CaseResult]]


class Backend(Protocol):
    """Workers. `close` ends the workers that this process started, even while they run a task."""

    @property
    def workers(self) -> int:
        """The number of tasks that run at once, which may change."""

    @property
    def room(self) -> int:
        """The number of tasks that may be submitted now: a few more than run at once, so that no worker is idle."""

    def submit(self, task: Task) -> None: ...

    def wait(self, limit_s: float) -> list[TaskOutcome]:
        """The tasks that have ended since the last call; waits up to `limit_s` [s] for one."""

    def close(self) -> None: ...


def local_workers(count: int) -> Backend:
    """`count` processes of this machine."""
    return WorkerPool(_work, count)


def _work(task: Task, progress: Progress) -> list[CaseResult]:
    return run(task)


class ThisProcess:
    """A single worker, this process itself, so that no process is started and all modules are already loaded."""

    workers = 1

    def __init__(self) -> None:
        self._tasks: list[Task] = []

    @property
    def room(self) -> int:
        return 1 - len(self._tasks)

    def submit(self, task: Task) -> None:
        self._tasks.append(task)

    def wait(self, limit_s: float) -> list[TaskOutcome]:
        return [EndedTask(task, run(task)) for task in [self._tasks.pop()]]

    def close(self) -> None: ...


def few_workers(count: int) -> Backend:
    """This process for a `count` of 1, otherwise `count` processes: 1 needs no guard in the program's main module."""
    return ThisProcess() if count == 1 else local_workers(count)
