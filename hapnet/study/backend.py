"""Where tasks run: the processes of this machine, or a cluster. The runner of a study knows no more of them."""

from __future__ import annotations

from typing import Protocol

from hapnet.simulation.processes import Outcome, Progress, WorkerPool
from hapnet.study.task import CaseResult, Task, run

TaskOutcome = Outcome[Task, list[CaseResult]]


class Backend(Protocol):
    """Workers. `close` ends those that this process started, with whatever they are doing."""

    @property
    def workers(self) -> int:
        """How many tasks run at once; may change."""

    @property
    def room(self) -> int:
        """How many tasks may be submitted now; workers that are never idle have some waiting."""

    def submit(self, task: Task) -> None: ...

    def wait(self, limit_s: float) -> list[TaskOutcome]:
        """The tasks that have ended since the last call; waits up to `limit_s` for one."""

    def close(self) -> None: ...


def local_workers(count: int) -> Backend:
    """`count` processes of this machine."""
    return WorkerPool(_work, count)


def _work(task: Task, progress: Progress) -> list[CaseResult]:
    return run(task)
