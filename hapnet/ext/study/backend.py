"""Where tasks run: in processes of this machine, or on a cluster. A study's runner needs to know no more."""

from __future__ import annotations

from typing import Protocol

from hapnet.ext.study.task import CaseResult, Task, run
from hapnet.processes.pool import EndedTask, Progress, WorkerPool

TaskOutcome = EndedTask[Task, list[CaseResult]]


class Backend(Protocol):
    """Workers. `close` ends those that this process started, even while they work."""

    @property
    def workers(self) -> int:
        """How many tasks run at once; the number may change."""

    @property
    def room(self) -> int:
        """How many tasks may be submitted now; a few more than run, so that no worker is idle."""

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
    """One worker, which is this very process: no other is started, and what it needs is loaded already."""

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
    """This process, or `count` others: for a program that may have no guard for its main module."""
    return ThisProcess() if count == 1 else local_workers(count)
