"""Child processes that each run one function: all begin together, and none outlives the program that started them.

`FrameWriter` sends messages from a child to its parent over a pipe, each after its length.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from struct import Struct
from typing import Any, BinaryIO

from hapnet.errors import HapnetError
from hapnet.processes.start import PIPE, Program, for_children, kill, started

WaitForStart = Callable[[], None]
"""The function that a child calls when it is ready; it returns when all children begin."""

READY_S = 60.0
"""The longest time for a child to become ready [s]."""

_COMPUTE = """
import os, sys, threading

def end():
    sys.stdin.read()  # returns when the benchmark has ended, for whatever reason
    os._exit(0)

threading.Thread(target=end, daemon=True).start()
while True:
    pass
"""


class Child:
    """A process of its own that runs ``function(wait_for_start, *args)``; use it as a context, which ends it.

    function : at the top level of a module. args, and the result, must be picklable.
    """

    def __init__(self, function: Callable[..., Any], *args: Any) -> None:
        context = multiprocessing.get_context("spawn")
        self._name = function.__name__
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_run, args=(theirs, function, args), daemon=True)
        resource_tracker.ensure_running()  # started together with the process, it would unblock SIGINT
        with for_children():
            self._process.start()
        theirs.close()

    def __enter__(self) -> Child:
        return self

    def __exit__(self, *exc: object) -> None:
        self._process.kill()
        self._process.join()
        self._pipe.close()

    def wait_ready(self) -> None:
        """Wait until the function calls `wait_for_start`."""
        self._receive(READY_S)

    def go(self) -> None:
        """Let the function go on."""
        self._pipe.send(None)

    def result(self, timeout_s: float) -> Any:
        """The function's result. Raises HapnetError: the function failed, or did not return in time."""
        return self._receive(timeout_s)

    def _receive(self, timeout_s: float) -> Any:
        try:
            if not self._pipe.poll(timeout_s):
                raise HapnetError(f"the process for {self._name} did not answer within {timeout_s:.0f} s")
            value, error = self._pipe.recv()
        except EOFError:
            raise HapnetError(f"the process for {self._name} ended") from None
        if error is not None:
            raise HapnetError(f"the process for {self._name} failed: {error}")
        return value


def together(children: list[Child], timeout_s: float) -> list[Any]:
    """Start all children together once all are ready; returns their results."""
    for child in children:
        child.wait_ready()
    for child in children:
        child.go()
    return [child.result(timeout_s) for child in children]


@contextlib.contextmanager
def busy(count: int) -> Iterator[None]:
    """`count` processes that only compute; they end with this context, or with this process."""
    programs: list[Program] = []
    try:
        programs.extend(started([sys.executable, "-c", _COMPUTE], stdin=PIPE) for _ in range(count))
        if count:
            time.sleep(0.2)  # until they run
        yield
    finally:
        for program in programs:
            kill(program)


def _run(pipe: Connection, function: Callable[..., Any], args: tuple[Any, ...]) -> None:
    def wait_for_start() -> None:
        pipe.send((None, None))
        pipe.recv()

    answer: tuple[Any, str | None]
    try:
        answer = function(wait_for_start, *args), None
    except Exception as error:
        answer = None, f"{type(error).__name__}: {error}"
    with contextlib.suppress(BrokenPipeError):
        pipe.send(answer)


_LENGTH = Struct(">L")

_MOST = 256
"""The most messages that wait for the parent; beyond that the oldest is dropped."""


class FrameWriter:
    """Writes to the pipe `file` from a thread of its own, so that `put` never waits for the reader."""

    def __init__(self, file: int) -> None:
        self._file = file
        self._frames: deque[bytes] = deque(maxlen=_MOST)
        self._some = threading.Event()
        threading.Thread(target=self._write, name="frames", daemon=True).start()

    def put(self, data: bytes) -> None:
        """Send a message, from any thread; returns at once."""
        self._frames.append(data)
        self._some.set()

    def _write(self) -> None:
        with os.fdopen(self._file, "wb") as pipe:
            while self._some.wait():
                self._some.clear()
                try:
                    while self._frames:
                        data = self._frames.popleft()
                        pipe.write(_LENGTH.pack(len(data)) + data)
                    pipe.flush()
                except OSError:  # the reader has ended
                    return


def frames(pipe: BinaryIO) -> Iterator[bytes]:
    """The messages that come over `pipe`, until it is closed."""
    while len(head := pipe.read(_LENGTH.size)) == _LENGTH.size:
        yield pipe.read(_LENGTH.unpack(head)[0])
