"""How cases become tasks, and what becomes of those whose worker dies; on a backend that runs nothing."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from hapnet.errors import HapnetError
from hapnet.ext.study import task as task_module
from hapnet.ext.study.backend import TaskOutcome
from hapnet.ext.study.journal import Journal
from hapnet.ext.study.runner import ATTEMPTS, COMMIT_S, TASK_S, TOGETHER, Sweep
from hapnet.ext.study.spec import Case
from hapnet.ext.study.task import CaseResult, Task, run
from hapnet.processes.pool import EndedTask, WorkerDied
from tests.study.sweeps import SHORT, TOUCHY, journal_of


class Pretended:
    """A backend that says at once how long each case took, or that the worker died."""

    def __init__(
        self, workers: int, case_s: Callable[[Case], float], deadly: tuple[int, ...] = (), ahead: int = 1
    ) -> None:
        self.workers, self._case_s, self._deadly, self._ahead = workers, case_s, deadly, ahead
        self.tasks: list[Task] = []
        self.now_s = 0.0
        self._running: list[Task] = []
        self.beside_suspects: list[int] = []
        self.most = 0

    @property
    def room(self) -> int:
        return self._ahead * self.workers - len(self._running)

    def submit(self, task: Task) -> None:
        assert self.room
        assert task.cases
        self.tasks.append(task)
        self._running.append(task)
        if any(task.attempt for task in self._running):
            self.beside_suspects.append(len(self._running))
        self.most = max(self.most, len(self._running))

    def wait(self, limit_s: float) -> list[TaskOutcome]:
        task = self._running.pop(0)
        self.now_s += sum(map(self._case_s, task.cases)) / self.workers
        if any(case.number in self._deadly for case in task.cases):
            return [EndedTask(task, None, WorkerDied("its worker died"))]
        return [EndedTask(task, [CaseResult(c.number, {"m": 1.0}, None, self._case_s(c), "w") for c in task.cases])]

    def close(self) -> None: ...


SWEEPS = journal_of.__module__
MANY_LINKS = f"[vary]\nlink = {[f'delay {k}ms' for k in range(1, 101)]}"
MANY = "[vary]\nseed = '0:1000'"


def quick(tmp_path: Path) -> Journal:
    """Of many cases, and not waiting for the disk."""
    journal = journal_of(tmp_path, MANY)
    journal._db.execute("PRAGMA synchronous = OFF")
    return journal


def swept(tmp_path: Path, backend: Pretended) -> list[str | None]:
    """The error of each case, once all have run."""
    journal = quick(tmp_path)
    Sweep(journal, backend, lambda done: None, lambda: backend.now_s).run()
    assert journal.count()[:2] == (1000, 1000)
    errors = [row.error for row in journal.rows()]
    journal.close()
    return errors


@pytest.mark.parametrize("case_s", [0.005, 0.1, 20.0])
def test_tasks_take_about_the_same_time_whatever_a_case_takes(tmp_path: Path, case_s: float) -> None:
    backend = Pretended(2, lambda case: case_s)
    swept(tmp_path, backend)
    sizes = [len(task.cases) for task in backend.tasks]
    assert sum(sizes) == 1000
    assert sizes[:2] == [1, 1]  # nobody knows yet
    assert max(sizes) * case_s <= max(TASK_S, case_s)
    if case_s > TASK_S:
        assert set(sizes) == {1}
    elif case_s == 0.1:
        assert sizes.count(int(TASK_S / case_s)) > 0.8 * len(sizes)
    assert sizes[-1] <= max(1, sizes[len(sizes) // 2] // 2)  # all workers end together


def test_cases_that_share_a_reference_run_stay_together(tmp_path: Path) -> None:
    """All four links of a seed, though a task would be shorter else; but no task grows without end."""
    links = "[vary]\nseed = '0:40'\nlink = ['lan', '4g', 'dsl', 'wifi']"
    journal = journal_of(tmp_path, links)
    backend = Pretended(2, lambda case: 1.2)
    Sweep(journal, backend, lambda done: None, lambda: backend.now_s).run()
    journal.close()
    seeds = [{case.seed for case in task.cases} for task in backend.tasks]
    assert all(len(one) == 1 for one in seeds)
    assert len(seeds) == 40  # so each reference run is made once
    (tmp_path / "many").mkdir()
    many = journal_of(tmp_path / "many", MANY_LINKS)
    backend = Pretended(2, lambda case: 1.2)
    Sweep(many, backend, lambda done: None, lambda: backend.now_s).run()
    many.close()
    assert max(len(task.cases) for task in backend.tasks) == 1 + TOGETHER


def test_tasks_follow_when_cases_become_longer(tmp_path: Path) -> None:
    backend = Pretended(1, lambda case: 0.01 if case.seed < 300 else 0.5)
    swept(tmp_path, backend)
    late = [len(task.cases) for task in backend.tasks if task.cases[0].seed >= 500]
    assert set(late) <= {1, 2, 3, 4}


def test_a_lost_task_costs_only_the_case_that_kills(tmp_path: Path) -> None:
    backend = Pretended(2, lambda case: 0.1, deadly=(40, 700))
    errors = swept(tmp_path, backend)
    assert {n: error for n, error in enumerate(errors) if error is not None} == dict.fromkeys(
        (40, 700), f"its worker died, {ATTEMPTS} times"
    )
    runs = [case.number for task in backend.tasks for case in task.cases]
    assert runs.count(40) == ATTEMPTS
    again = [task for task in backend.tasks if task.attempt]
    assert again
    assert all(len(task.cases) == 1 for task in again)
    assert len(runs) == 1000 + len(again)  # nothing else was run twice


def test_nothing_waits_at_a_worker_that_may_be_killed_again(tmp_path: Path) -> None:
    """As tasks do otherwise, so that no worker is idle."""
    backend = Pretended(2, lambda case: 0.1, deadly=(40, 700), ahead=3)
    errors = swept(tmp_path, backend)
    assert [number for number, error in enumerate(errors) if error is not None] == [40, 700]
    assert backend.most == 6
    assert set(backend.beside_suspects) <= {1, 2}
    assert backend.beside_suspects


def test_results_reach_the_journal_on_the_way_and_when_it_ends_badly(tmp_path: Path) -> None:
    journal = quick(tmp_path)
    backend = Pretended(1, lambda case: 0.1)
    seen: list[int] = []

    def progress(done: int) -> None:
        behind = done - journal.count()[1]
        assert behind * 0.1 <= COMMIT_S + TASK_S
        seen.append(done)
        if done > 500:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Sweep(journal, backend, progress, lambda: backend.now_s).run()
    assert seen == sorted(seen)
    assert journal.count()[1] == seen[-1]
    journal.close()
    journal = quick(tmp_path)
    again = Pretended(1, lambda case: 0.1)
    Sweep(journal, again, lambda done: None, lambda: again.now_s).run()
    assert journal.count() == (1000, 1000, 0)
    journal.close()
    assert sum(len(task.cases) for task in again.tasks) == 1000 - seen[-1]


def test_a_task_gives_every_case_a_result(tmp_path: Path) -> None:
    """What is wrong with one case is that one's error, in one line."""
    text = f"{TOUCHY}[vary]\nworld.wall.stiffness = [3000, 13, 1000]"
    journal = journal_of(tmp_path, text)
    good, broken, other = run(Task(journal.fixed, tuple(journal.pending())))
    assert (good.error, other.error) == (None, None)
    assert (
        broken.error == f"the scene {SWEEPS}:touchy failed: next_step_s() raised ZeroDivisionError: a step of two lines"
    )
    assert not broken.measures
    assert good.measures
    assert all(
        result.wall_s and result.worker and result.worker.endswith(f":{os.getpid()}") for result in (good, broken)
    )
    journal.close()


def test_measures_are_plain_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import numpy as np

    reported = {"a": np.float64(2.5), "b": float("nan"), "c": None, "d": 3, "e": np.int64(4)}
    monkeypatch.setattr(task_module, "measure", lambda params, seed: reported)
    journal = journal_of(tmp_path, SHORT)
    (result, *_) = run(Task(journal.fixed, tuple(journal.pending()[:1])))
    assert result.measures == {"a": 2.5, "b": None, "c": None, "d": 3, "e": 4.0}
    assert [type(value) for value in result.measures.values()] == [float, type(None), type(None), int, float]
    journal.record([result])
    journal.close()


def test_a_journal_that_cannot_be_written_ends_the_sweep(tmp_path: Path) -> None:
    journal = journal_of(tmp_path, MANY)
    journal._db.execute("PRAGMA query_only = 1")
    backend = Pretended(2, lambda case: 0.1)
    with pytest.raises(HapnetError, match="cannot use the journal"):
        Sweep(journal, backend, lambda done: None, lambda: backend.now_s).run()
    journal.close()
