"""This process and its system: signals to end it, its memory and garbage, the time that a thread ran."""

from __future__ import annotations

import asyncio
import ctypes
import gc
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType

HANGUP: signal.Signals | None = getattr(signal, "SIGHUP", None)
"""The signal of a closed terminal; Windows has none."""

ENDING: tuple[signal.Signals, ...] = tuple(filter(None, (signal.SIGINT, signal.SIGTERM, HANGUP)))
"""Signals that request a process to end."""


def handle_on_loop(number: signal.Signals, handler: Callable[..., object], *given: object) -> None:
    """Call ``handler(*given)`` on the running loop when this signal comes."""
    loop = asyncio.get_running_loop()
    try:
        loop.add_signal_handler(number, handler, *given)
    except NotImplementedError:  # on Windows
        signal.signal(number, lambda *_: loop.call_soon_threadsafe(handler, *given))


@contextmanager
def handled(handler: Callable[[int, FrameType | None], object]) -> Iterator[Callable[[int], None]]:
    """Pass signals to end this process to `handler` in this context, except signals ignored before (nohup).

    It yields a function that restores a signal's previous handler.
    """
    kept = [number for number in ENDING if signal.getsignal(number) is not signal.SIG_IGN]
    before = {int(number): signal.signal(number, handler) for number in kept}

    def as_before(number: int) -> None:
        if before[number] is not None:  # None: it was not set by Python, which cannot set it again
            signal.signal(number, before[number])

    try:
        yield as_before
    finally:
        for number in before:
            as_before(number)


EVERY_S = 60.0


async def give_back_freed() -> None:
    """Give freed memory back to the system once a minute, until cancelled.

    A page that is drawn for hours would otherwise take some megabytes more each hour. Not for a process with a servo,
    whose allocations would wait for some milliseconds.
    """
    while True:
        await asyncio.sleep(EVERY_S)
        if sys.platform == "linux":
            with suppress(AttributeError, OSError):  # another C library has no such function
                ctypes.CDLL(None).malloc_trim(0)


class ThreadTime:
    """Reads the time that the calling thread ran [ns], since it began; 0 if the system does not report it (Linux does:
    proc_pid_schedstat(5)). A call takes some microseconds and keeps no memory."""

    def __init__(self) -> None:
        self._file, self._thread = -1, 0
        self._buffer = bytearray(64)
        self._buffers = [self._buffer]

    def __call__(self) -> int:
        if (thread := threading.get_native_id()) != self._thread:
            self._open(thread)
        if self._file < 0 or not hasattr(os, "preadv"):
            return 0
        try:
            count = os.preadv(self._file, self._buffers, 0)
        except OSError:
            return 0
        ran, _, rest = self._buffer[:count].partition(b" ")
        return int(ran) + int(rest.partition(b" ")[0])

    def close(self) -> None:
        """Close the file in /proc."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def _open(self, thread: int) -> None:
        self.close()
        self._thread = thread
        if hasattr(os, "preadv"):
            with suppress(OSError):
                self._file = os.open(f"/proc/self/task/{thread}/schedstat", os.O_RDONLY)


@contextmanager
def collector_paused() -> Iterator[None]:
    """Pause the automatic collection of cycles. A simulation makes none, but its many samples trigger searches through
    all objects of the program; in a large program these took an eighth of the time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
