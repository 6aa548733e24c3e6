"""The workers of a running Dask cluster, as a `Backend`."""

from __future__ import annotations

import logging
import queue
import re
import time
from contextlib import suppress
from importlib import metadata
from typing import Any

from hapnet.errors import HapnetError, InvalidParameter, MissingLibrary
from hapnet.ext.study.backend import TaskOutcome
from hapnet.ext.study.task import Task, run
from hapnet.installing import versions
from hapnet.loading import cause
from hapnet.processes.pool import EndedTask, WorkerDied
from netem.versions import DISTRIBUTION

REACH_S = 5.0
"""The time limit for a scheduler to answer, and to have a worker [s]."""
_LOOK_S = 5.0
_AHEAD = 2  # tasks per thread: one runs, one waits at the worker


class DaskCluster:
    """The workers of the scheduler at `address`, such as ``tcp://127.0.0.1:8786``.

    Raises InvalidParameter: `address` is not an address. MissingLibrary: dask.distributed is not installed.
    HapnetError: no scheduler answers, it has no worker, or a worker has another version of hapnet; from `wait` and
    `submit`: the connection to the scheduler is lost.
    """

    def __init__(self, address: str) -> None:
        if re.fullmatch(r"(tcp|tls|ws|wss|ucx)://[^/\s]+:\d+", address) is None:
            raise InvalidParameter("--dask", address, "a scheduler's address, such as tcp://127.0.0.1:8786")
        try:
            import distributed
        except ImportError:
            raise MissingLibrary("--dask", "distributed", "sweep") from None
        for name in ("distributed", "distributed.client", "distributed.comm", "distributed.core"):
            logging.getLogger(name).setLevel(logging.CRITICAL)  # this class reports the errors itself
        self._address = address
        self._ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._tasks: dict[str, tuple[Any, Task]] = {}
        self._threads: dict[str, int] = {}
        try:
            connect: Any = distributed.Client  # it has no type hints
            self._client = connect(address, timeout=REACH_S, set_as_default=False)
        except (OSError, TimeoutError, RuntimeError):
            raise HapnetError(f"no Dask scheduler answers at {address} within {REACH_S:g} s") from None
        try:
            self._client.wait_for_workers(1, timeout=REACH_S)
            self._check()
        except TimeoutError:
            self.close()
            raise HapnetError(f"the Dask scheduler at {address} has no worker") from None
        except BaseException:
            self.close()
            raise

    @property
    def workers(self) -> int:
        if time.monotonic() - self._looked_s > _LOOK_S:
            self._check()
        return sum(self._threads.values())

    @property
    def room(self) -> int:
        return max(0, _AHEAD * self.workers - len(self._tasks))

    @property
    def threaded(self) -> bool:
        """Whether a worker has several threads, of which Python runs only one at a time."""
        return any(threads > 1 for threads in self._threads.values())

    def submit(self, task: Task) -> None:
        self._alive()
        future = self._ask(self._client.submit, run, task, pure=False, retries=0)
        self._tasks[future.key] = future, task
        future.add_done_callback(self._ended.put)

    def wait(self, limit_s: float) -> list[TaskOutcome]:
        outcomes = []
        try:
            outcomes.append(self._outcome(self._ended.get(timeout=limit_s)))
            while True:
                outcomes.append(self._outcome(self._ended.get_nowait()))
        except queue.Empty:
            pass
        self._alive()
        return [outcome for outcome in outcomes if outcome is not None]

    def close(self) -> None:
        with suppress(Exception):  # errors do not matter, as the cluster is not needed any more
            self._client.cancel([future for future, _ in self._tasks.values()], force=True)
        with suppress(Exception):
            self._client.close(timeout=REACH_S)

    def _outcome(self, future: Any) -> TaskOutcome | None:
        """The outcome of a task; None if a worker died before its result was fetched, so that the task is repeated."""
        task = self._tasks[future.key][1]
        outcome = None
        if future.status == "finished":
            with suppress(Exception):  # the result may have been lost meanwhile
                outcome = EndedTask(task, future.result(timeout=REACH_S))
        elif future.status == "error":
            outcome = EndedTask(task, None, WorkerDied(_lost(future.exception(timeout=REACH_S))))
        elif future.status == "cancelled":
            outcome = EndedTask(task, None, WorkerDied("its Dask task was cancelled"))
        self._alive()
        if outcome is None:
            future.add_done_callback(self._ended.put)
        else:
            del self._tasks[future.key]
        return outcome

    def _check(self) -> None:
        """Update the list of workers, and check that new workers have this version of hapnet."""
        before, self._threads = set(self._threads), dict(self._ask(self._client.nthreads))
        self._looked_s = time.monotonic()
        if not (new := sorted(set(self._threads) - before)):
            return
        # a library function, as a worker may have no hapnet
        found = self._ask(self._client.run, metadata.version, DISTRIBUTION, workers=new, on_error="return")
        ours = versions()[DISTRIBUTION]
        for worker, theirs in found.items():
            if isinstance(theirs, metadata.PackageNotFoundError):
                raise HapnetError(f"the Dask worker at {worker} has no hapnet: {DISTRIBUTION} {ours} runs here")
            if isinstance(theirs, str) and theirs != ours:  # otherwise the worker has ended meanwhile
                raise HapnetError(f"the Dask worker at {worker} has hapnet {theirs}: {DISTRIBUTION} {ours} runs here")

    def _alive(self) -> None:
        if self._client.status != "running":
            raise HapnetError(f"the connection to the Dask scheduler at {self._address} is lost")

    def _ask(self, call: Any, *args: Any, **named: Any) -> Any:
        try:
            return call(*args, **named)
        except (OSError, TimeoutError, RuntimeError) as error:
            self._alive()
            raise HapnetError(f"the Dask scheduler at {self._address} does not answer: {cause(error)}") from error


def _lost(error: BaseException) -> str:
    if type(error).__name__ == "KilledWorker":
        return "its Dask worker died"
    return f"its Dask worker could not run it: {cause(error)}"
