"""The same sweep on a Dask cluster: real schedulers and workers, in processes of their own."""

import os
import re
import signal
import socket
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from hapnet.errors import HapnetError, InvalidParameter, MissingLibrary
from hapnet.ext.study import cluster as module
from hapnet.ext.study.backend import local_workers
from hapnet.ext.study.case import Measures
from hapnet.ext.study.cluster import DaskCluster
from hapnet.ext.study.runner import Sweep
from hapnet.ext.study.spec import Case
from netem.versions import DISTRIBUTION
from tests.study.sweeps import DEADLY, SHORT, TOUCHY, journal_of
from tests.support.processes import Program

DASK = (sys.executable, "-m", "dask")
QUIET = ("--no-dashboard", "--host", "127.0.0.1")


@contextmanager
def dask(workers: int) -> Iterator[tuple[str, Program, list[Program]]]:
    """Address, scheduler and workers of a cluster on this machine."""
    with ExitStack() as stack:
        scheduler = Program("scheduler", "--port", "0", *QUIET, command=DASK)
        stack.callback(scheduler.kill)
        scheduler.until_line("Scheduler at:")
        words = re.search(r"tcp://[\d.]+:\d+", "".join(scheduler.out + scheduler.err))
        started = []
        for _ in range(workers):
            worker = Program("worker", words[0], "--nthreads", "1", "--no-dashboard", command=DASK)
            stack.callback(worker.kill)
            started.append(worker)
        for worker in started:
            worker.until_line("Starting established connection")
        yield words[0], scheduler, started


def swept(directory: Path, text: str, address: str | None) -> list[tuple[Case, Measures, str | None]]:
    """Each case's number, seed, values, measures and error."""
    directory.mkdir()
    journal = journal_of(directory, text)
    backend = local_workers(2) if address is None else DaskCluster(address)
    try:
        Sweep(journal, backend, lambda done: None).run()
    finally:
        backend.close()
    rows = [(row.case, row.measures, row.error) for row in journal.rows()]
    assert journal.count()[0] == journal.count()[1]
    journal.close()
    return rows


@pytest.mark.slow
def test_rows_are_those_of_local_workers(tmp_path: Path) -> None:
    with dask(2) as (address, _, _):
        text = SHORT.replace('"4g"', '"4g", "loss 100%"').replace("0:10", "0:3")
        assert swept(tmp_path / "dask", text, address) == swept(tmp_path / "local", text, None)


@pytest.mark.slow
def test_a_case_that_kills_workers_is_a_row_there_too(tmp_path: Path) -> None:
    with dask(2) as (address, _, _):
        text = f"{TOUCHY}[[vary]]\nseed = '0:3'\n[[vary]]\nworld.wall.stiffness = [{DEADLY}]\n[[vary]]\nseed = [5]"
        rows = swept(tmp_path / "dask", text, address)
    assert [error for _, _, error in rows] == [None] * 3 + ["its Dask worker died, 2 times", None]


@pytest.mark.slow
def test_a_scheduler_that_goes_away_ends_it_and_it_can_go_on(tmp_path: Path) -> None:
    journal = journal_of(tmp_path, SHORT.replace("0.2", "1"))
    with dask(1) as (address, scheduler, _):
        backend = DaskCluster(address)

        def progress(done: int) -> None:
            if done:
                os.killpg(scheduler.process.pid, signal.SIGKILL)

        with pytest.raises(HapnetError, match=f"the connection to the Dask scheduler at {address} is lost"):
            Sweep(journal, backend, progress).run()
        backend.close()
    assert 0 < journal.count()[1] < 40
    local = local_workers(2)
    Sweep(journal, local, lambda done: None).run()
    local.close()
    assert journal.count() == (40, 40, 0)
    journal.close()


@pytest.mark.slow
def test_workers_must_be_there_and_have_this_hapnet(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "REACH_S", 5.0)
    with dask(0) as (address, _, _), pytest.raises(HapnetError, match=f"the Dask scheduler at {address} has no worker"):
        DaskCluster(address)
    monkeypatch.setattr(module, "REACH_S", 30.0)
    with dask(1) as (address, _, _):
        monkeypatch.setattr(module, "versions", lambda: {DISTRIBUTION: "99.0"})
        with pytest.raises(
            HapnetError, match=r"the Dask worker at tcp://.* has hapnet 0\..*: hapnet-haptics 99.0 runs"
        ):
            DaskCluster(address)
        monkeypatch.setattr(module, "DISTRIBUTION", "no-such-thing")
        monkeypatch.setattr(module, "versions", lambda: {"no-such-thing": "99.0"})
        with pytest.raises(HapnetError, match=r"the Dask worker at tcp://.* has no hapnet"):
            DaskCluster(address)


def test_nobody_there_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "REACH_S", 0.5)
    with socket.socket() as taken:  # and never listens
        taken.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(HapnetError, match=f"no Dask scheduler answers at {address} within 0.5 s"):
            DaskCluster(address)


@pytest.mark.parametrize("address", ["localhost:8786", "tcp://localhost", "http://localhost:1", "tcp://a b:1", ""])
def test_what_is_no_address_is_refused(address: str) -> None:
    with pytest.raises(InvalidParameter, match=r"--dask is .*such as tcp://127\.0\.0\.1:8786"):
        DaskCluster(address)


def test_without_the_library_its_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingLibrary, match="--dask needs distributed, of the extra `sweep`"):
        DaskCluster("tcp://127.0.0.1:8786")
