"""Workers that are processes of this machine: one that dies takes nothing with it but its task."""

import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.study import export
from hapnet.ext.study.backend import local_workers
from hapnet.ext.study.runner import Sweep
from hapnet.ext.study.task import Task, run
from hapnet.processes import pool
from hapnet.processes.pool import in_processes
from hapnet.processes.start import for_children
from tests.conftest import ENVIRONMENT, mostly_slow
from tests.study.sweeps import TOUCHY, journal_of, known
from tests.support.processes import until

Reported = Callable[[float], None]

AXES = """
[[vary]]
world.wall.stiffness = [3000, 13, 1000]
seed = "0:3"
[[vary]]
world.wall.stiffness = [666]
"""
WHY = "its worker was killed by SIGKILL, perhaps out of memory, 2 times"


@pytest.mark.slow
def test_a_case_that_kills_its_worker_is_a_row_that_says_so(tmp_path: Path) -> None:
    """And all others have their results, the same as without workers."""
    journal = journal_of(tmp_path, TOUCHY + AXES)
    workers = local_workers(2)
    Sweep(journal, workers, lambda done: None).run()
    started = [worker.process for worker in workers._workers]
    workers.close()
    assert not any(process.is_alive() for process in started)
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
    workers = local_workers(1)
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


@pytest.mark.slow
def test_workers_never_hear_ctrl_c() -> None:
    """Held back from the first instruction on, in a process that has started no other before; then ignored."""
    code = (
        "from pathlib import Path; from hapnet.ext.study.backend import local_workers; pool = local_workers(2)\n"
        "def show(): [print(Path(f'/proc/{w.process.pid}/status').read_text()) for w in pool._workers]\n"
        "show()\n"
        "while not all(worker.ready for worker in pool._workers): pool.wait(0.1)\n"
        "show(); pool.close()"
    )
    reported = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, env=ENVIRONMENT)
    assert (reported.returncode, reported.stderr) == (0, "")
    blocked, ignored = (
        [int(word, 16) >> (signal.SIGINT - 1) & 1 for word in re.findall(rf"{name}:\s*(\w+)", reported.stdout)]
        for name in ("SigBlk", "SigIgn")
    )
    assert blocked == [1, 1, 1, 1]
    assert ignored[2:] == [1, 1]


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="no signal can be sent to a thread here")
def test_ctrl_c_that_another_thread_receives_waits_until_a_process_has_started() -> None:
    def receive() -> None:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        signal.pthread_kill(threading.get_ident(), signal.SIGINT)

    started = False

    def start() -> None:
        nonlocal started
        with for_children():
            other = threading.Thread(target=receive)
            other.start()
            other.join()
            started = True

    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        start()
    assert started
    assert signal.getsignal(signal.SIGINT) is handler


def test_ctrl_c_comes_through_again_whichever_of_two_starts_ends_first() -> None:
    """As on an event loop, which starts two programs at once."""
    handler, blocked = signal.getsignal(signal.SIGINT), signal.pthread_sigmask(signal.SIG_BLOCK, ())
    one, other = for_children(), for_children()
    for step in (one.__enter__, other.__enter__):
        step()
        assert signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())
    one.__exit__(None, None, None)
    assert signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())
    other.__exit__(None, None, None)
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == blocked
    assert signal.getsignal(signal.SIGINT) is handler


@pytest.mark.slow
def test_processes_that_do_not_start_are_an_error_not_a_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "_serve", os._exit)  # takes no such arguments: it fails
    workers = local_workers(2)

    def wait() -> bool:
        assert workers.wait(0.1) == []
        return False

    with pytest.raises(HapnetError, match="worker processes do not start: ended with exit code 1"):
        until(wait)
    workers.close()


def at_work(cases: Sequence[str], progress: Reported) -> list[str]:
    """What some words make of a share of work."""
    if "die" in cases:
        os.kill(os.getpid(), signal.SIGKILL)
    if "refuse" in cases:
        raise InvalidParameter("word", "refuse", "another")
    for k in range(len(cases)):
        progress((k + 1) / len(cases))
    return [f"{word}!" for word in cases]


def test_shares_come_back_in_their_order_and_progress_ends_at_one() -> None:
    reported: list[float] = []
    assert in_processes(at_work, [["a", "b", "c"], ["d"]], reported.append) == [["a!", "b!", "c!"], ["d!"]]
    assert reported[-1] == 1.0
    assert all(0.0 <= share <= 1.0 for share in reported)


@pytest.mark.parametrize(
    ("word", "error", "said"),
    mostly_slow(
        [
            (
                "die",
                HapnetError,
                "^some of the runs are missing: its worker was killed by SIGKILL, perhaps out of memory$",
            ),
            ("refuse", InvalidParameter, "^word is 'refuse'; allowed: another$"),
        ],
        1,
    ),
)
def test_a_share_that_is_lost_is_an_error_and_no_endless_wait(word: str, error: type[Exception], said: str) -> None:
    with pytest.raises(error, match=said):
        in_processes(at_work, [[word]])


def test_an_error_that_cannot_leave_its_process_leaves_its_words() -> None:
    class Local(Exception):
        """Of a function: another process cannot import it."""

    reported = pool._picklable(Local("of two\nlines"))
    assert (type(reported), str(reported)) == (HapnetError, "Local: of two lines")
    refused = InvalidParameter("word", 1, "another")
    assert pool._picklable(refused) is refused
