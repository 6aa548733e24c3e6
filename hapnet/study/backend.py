"""Where tasks run: what the runner of a sweep wants of this machine's processes, or of a cluster."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from hapnet.study.task import CaseResult, Task


@dataclass(frozen=True)
class Outcome:
    """A task that is over: the results of its cases or, if its worker died over it, the reason."""

    task: Task
    results: list[CaseResult] | None
    lost: str = ""


class Backend(Protocol):
    """Workers. `close` ends those that it started, with whatever they are doing."""

    @property
    def workers(self) -> int:
        """How many tasks run at once; may change."""

    @property
    def room(self) -> int:
        """How many tasks may be submitted now; workers that are never idle have some waiting."""

    def submit(self, task: Task) -> None: ...

    def wait(self, limit_s: float) -> list[Outcome]:
        """The tasks that have ended since the last call; waits for one so long."""

    def close(self) -> None: ...
