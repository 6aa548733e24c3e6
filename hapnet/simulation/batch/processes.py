"""The same work in several processes, one for each share of it."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any, TypeVar

Case = TypeVar("Case")
Run = TypeVar("Run")
Progress = Callable[[float], None]

_POLL_S = 0.2
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def usable_cores() -> int:
    """How many cores this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_processes(
    work: Callable[[Sequence[Case], Progress], list[Run]],
    shares: Sequence[Sequence[Case]],
    progress: Progress | None = None,
) -> list[list[Run]]:
    """``work(share, progress)`` for every share, each in a process of its own; the results in the order of the shares.

    `work` is a function of a module. `progress` is told the mean of what each `work` tells of its own.
    """
    context = multiprocessing.get_context("spawn")
    done = context.Array("d", len(shares))
    with for_children():
        processes = context.Pool(len(shares), _begin, (done,))
    with processes as pool:
        result = pool.starmap_async(_work, [(work, k, share) for k, share in enumerate(shares)], chunksize=1)
        while not result.ready():
            result.wait(_POLL_S)
            if progress is not None:
                progress(sum(done[:]) / len(shares))
        parts = result.get()
    if progress is not None:
        progress(1.0)
    return parts


_done: Any = None


def _begin(done: Any) -> None:
    global _done  # a pool hands shared memory to its processes in no other way
    _done = done


def _work(work: Callable[[Sequence[Case], Progress], list[Run]], k: int, share: Sequence[Case]) -> list[Run]:
    return work(share, lambda part: _done.__setitem__(k, part))


@contextmanager
def for_children() -> Iterator[None]:
    """Processes started in here leave Ctrl-C to their parent, and use one thread each."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    masked = None
    if hasattr(signal, "pthread_sigmask"):
        resource_tracker.ensure_running()  # started with the first process, it would let Ctrl-C through to that one
        masked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
        if masked is not None:  # last: a Ctrl-C that came meanwhile is raised here
            signal.pthread_sigmask(signal.SIG_SETMASK, masked)
