"""Compiles in a process of the lowest priority, while plain Python executes the runs."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from hapnet.ext.compiled import sources
from hapnet.ext.compiled.progress import reported
from hapnet.processes import start
from hapnet.records.machine_code import directory


class Background:
    """A process that compiles `names` (of the catalogue) one after the other; use it as a context, which ends it.

    It also ends when this process does. Later runs use all that it has compiled by then. It reports the progress to
    `progress.reported`.
    """

    def __init__(self, *names: str) -> None:
        self._names = names
        command = start.module("hapnet.ext.compiled", *names)
        self._process = start.started(
            command, stdin=start.PIPE, stdout=start.PIPE, stderr=start.NOTHING, own_group=sys.platform != "win32"
        )
        self._reader = threading.Thread(target=self._read, args=(reported.get(),), name="compiler", daemon=True)
        self._reader.start()

    def __enter__(self) -> Background:
        return self

    def __exit__(self, *exc: object) -> None:
        self._process.kill()
        self._process.wait()
        self._reader.join()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()

    @property
    def is_done(self) -> bool:
        """Whether all names are compiled."""
        return self._process.poll() is not None and all(map(sources.are_compiled, self._names))

    def _read(self, report: Callable[[float], None]) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with suppress(ValueError):
                report(float(line))


def serve() -> None:
    """Compile the names of the command line, and print the share done so far; end when the standard input ends."""
    names = sys.argv[1:]
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(OSError):
        if sys.platform == "linux":
            os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
        elif sys.platform != "win32":
            os.nice(19)
    from hapnet.ext.compiled.catalogue import makers  # here, since it loads numba

    known = makers()
    for number, name in enumerate(names):

        def report(share: float, number: int = number) -> None:
            sys.stdout.write(f"{(number + share) / len(names)}\n")
            sys.stdout.flush()

        reported.set(report)
        with alone(name) as here:
            if here and not sources.are_compiled(name):
                known[name]()


def _end_with_parent() -> None:
    sys.stdin.read()
    os._exit(1)


@contextmanager
def alone(name: str, *, wait: bool = False) -> Iterator[bool]:
    """Yield whether no other process compiles this; always True on Windows. `wait` : first wait until none does."""
    with (directory() / f"{name}.lock").open("w") as lock:
        if sys.platform != "win32":
            import fcntl

            try:
                fcntl.flock(lock, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            except BlockingIOError:
                yield False
                return
        yield True
