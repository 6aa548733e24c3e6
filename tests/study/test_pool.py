"""Workers that are processes of this machine: one that dies takes nothing with it but its task."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from hapnet.errors import HapnetError
from hapnet.study import export, pool
from hapnet.study.pool import LocalPool
from hapnet.study.runner import Sweep
from hapnet.study.task import Task, run
from tests.conftest import ENVIRONMENT
from tests.processes import until
from tests.study.sweeps import TOUCHY, journal_of, known

AXES = """
[[vary]]
world.wall.stiffness = [3000, 13, 1000]
seed = "0:3"
[[vary]]
world.wall.stiffness = [666]
"""
WHY = "its worker was killed by SIGKILL, out of memory perhaps, 2 times"


def test_a_case_that_kills_its_worker_is_a_row_that_says_so(tmp_path: Path) -> None:
    """And all others have their results, the same as without workers."""
    journal = journal_of(tmp_path, TOUCHY + AXES)
    workers = LocalPool(2)
    Sweep(journal, workers, lambda done: None).run()
    processes = [worker.process for worker in workers._workers]
    workers.close()
    assert not any(process.is_alive() for process in processes)
    rows = list(journal.rows())
    assert [row.error for row in rows if row.case.values["world.wall.stiffness"] == 666.0] == [WHY]
    spared = tuple(row.case for row in rows if row.error != WHY)
    assert len(spared) == 9
    here = {result.number: (result.measures, result.error) for result in run(Task(journal.fixed, spared))}
    assert {row.case.number: (row.measures, row.error) for row in rows if row.error != WHY} == here
    assert len(known(export.table(journal))["case"]) == 10
    journal.close()


@pytest.mark.slow
def test_a_worker_killed_from_outside_costs_no_case(tmp_path: Path) -> None:
    journal = journal_of(tmp_path, TOUCHY + "[vary]\nseed = '0:40'")
    workers = LocalPool(1)
    killed: list[int] = []

    def progress(done: int) -> None:
        pid = workers._workers[0].process.pid
        if done >= 10 and not killed and pid is not None:
            os.kill(pid, signal.SIGKILL)
            killed.append(pid)

    Sweep(journal, workers, progress).run()
    workers.close()
    assert killed
    assert journal.count() == (40, 40, 0)
    journal.close()


def test_workers_never_hear_ctrl_c() -> None:
    """Held back from the first instruction on, in a process that has started no other before; then ignored."""
    code = (
        "from pathlib import Path; from hapnet.study.pool import LocalPool; pool = LocalPool(2)\n"
        "def show(): [print(Path(f'/proc/{w.process.pid}/status').read_text()) for w in pool._workers]\n"
        "show()\n"
        "while not all(worker.ready for worker in pool._workers): pool.wait(0.1)\n"
        "show(); pool.close()"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30, env=ENVIRONMENT)
    assert (told.returncode, told.stderr) == (0, "")
    blocked, ignored = (
        [int(word, 16) >> (signal.SIGINT - 1) & 1 for word in re.findall(rf"{name}:\s*(\w+)", told.stdout)]
        for name in ("SigBlk", "SigIgn")
    )
    assert blocked == [1, 1, 1, 1]
    assert ignored[2:] == [1, 1]


def test_processes_that_do_not_start_are_an_error_not_a_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "_serve", os._exit)  # its argument is no exit code: it fails
    workers = LocalPool(2)

    def wait() -> bool:
        assert workers.wait(0.1) == []
        return False

    with pytest.raises(HapnetError, match="worker processes do not start: ended by itself with exit code 1"):
        until(wait)
    workers.close()
