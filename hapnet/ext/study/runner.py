"""Runs the cases without a result: groups them into tasks, submits these to workers, and stores the results."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable
from math import ceil

from hapnet.ext.study.backend import Backend, TaskOutcome
from hapnet.ext.study.case import DEADBAND
from hapnet.ext.study.journal import Journal
from hapnet.ext.study.spec import LINK, Case
from hapnet.ext.study.task import CaseResult, Task

TASK_S = 1.5
"""The wanted duration of a task [s]: much longer than its submission, but short, as a dead worker loses the task."""
COMMIT_S = 0.5
"""The longest time until results are written to the disk [s]."""
ATTEMPTS = 2
"""How often a case is tried: if a worker dies, its cases are tried again, each alone, to find the cause."""

TOGETHER = 8
"""The number of cases by which a task may grow if they share its reference run over an ideal link."""

_WAIT_S = 0.2
_WEIGHT = 0.3  # of the newest task in the mean time of a case


def _reference(case: Case) -> tuple[str, ...]:
    """A key that is equal for cases that share a reference run over an ideal link.

    Such cases are run one after the other, so that the reference run is made only once.
    """
    values = [repr(value) for name, value in case.values.items() if name.partition(".")[0] != LINK and name != DEADBAND]
    return *values, str(case.seed)


class Sweep:
    """Runs the cases of `journal` that have no result on the workers of `backend`.

    progress : called often with the number of cases that have a result. clock : [s].
    """

    def __init__(
        self,
        journal: Journal,
        backend: Backend,
        progress: Callable[[int], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._journal, self._backend, self._progress, self._clock = journal, backend, progress, clock
        self._pending = deque(sorted(journal.pending(), key=_reference))
        self._sharing = Counter(hash(_reference(case)) for case in self._pending)
        self._alone: deque[tuple[Case, int]] = deque()
        self._running = self._suspects = 0
        self._case_s: float | None = None
        self._fresh: list[CaseResult] = []
        self._committed_s = clock()
        self.done: int = journal.count()[1]

    def run(self) -> None:
        """Run all cases. Whatever ends this, the results of all finished cases are in the journal.

        Raises HapnetError: the workers or the journal cannot be used any more.
        """
        self._progress(self.done)
        try:
            while self._pending or self._alone or self._running:
                self._hand_out()
                for outcome in self._backend.wait(_WAIT_S):
                    self._running -= 1
                    self._suspects -= outcome.task.attempt > 0
                    self._take(outcome)
                self._hand_out()  # before the slow write to the disk
                if self._clock() - self._committed_s >= COMMIT_S:
                    self._commit()
                self._progress(self.done)
        finally:
            self._commit()

    def _hand_out(self) -> None:
        room = self._backend.room
        if self._alone or self._suspects:  # no task may wait at a worker that a suspect case may kill
            room = min(room, self._backend.workers - self._running)
        for _ in range(room):
            if self._alone:
                case, attempt = self._alone.popleft()
                task = Task(self._journal.fixed, (case,), attempt)
            elif self._pending:
                task = Task(self._journal.fixed, self._next())
            else:
                return
            self._backend.submit(task)
            self._running += 1
            self._suspects += task.attempt > 0

    def _next(self) -> tuple[Case, ...]:
        """The cases of the next task: about `TASK_S` of work, less near the end, so that all workers end together.

        Cases with the same reference run stay together, as each worker that needs this run makes it. A small group is
        never split, so that the run is made once; a large group is split near the end, too.
        """
        share = ceil(len(self._pending) / (2 * max(1, self._backend.workers)))
        size = 1 if self._case_s is None else max(1, min(share, int(TASK_S / max(self._case_s, 1e-6))))
        cases = [self._pending.popleft() for _ in range(size)]
        reference = _reference(cases[-1])
        most = size + TOGETHER
        if self._sharing[hash(reference)] > 1 + TOGETHER:
            most = min(share, most)
        while len(cases) < most and self._pending and _reference(self._pending[0]) == reference:
            cases.append(self._pending.popleft())
        return tuple(cases)

    def _take(self, outcome: TaskOutcome) -> None:
        task, results = outcome.task, outcome.result
        if results is None:
            if task.attempt + 1 < ATTEMPTS:
                self._alone.extend((case, task.attempt + 1) for case in task.cases)
                return
            results = [CaseResult(case.number, {}, f"{outcome.error}, {ATTEMPTS} times") for case in task.cases]
        else:
            mean_s = sum(result.wall_s or 0.0 for result in results) / len(results)
            self._case_s = mean_s if self._case_s is None else self._case_s + _WEIGHT * (mean_s - self._case_s)
        self._fresh += results
        self.done += len(results)

    def _commit(self) -> None:
        if self._fresh:
            self._journal.record(self._fresh)
            self._fresh = []
        self._committed_s = self._clock()
