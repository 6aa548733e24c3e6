"""Signals that ask a process to end, as far as this system has them, and their handlers on an event loop."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

HANGUP: signal.Signals | None = getattr(signal, "SIGHUP", None)
"""The terminal was closed; Windows has none."""

ENDING: tuple[signal.Signals, ...] = tuple(filter(None, (signal.SIGINT, signal.SIGTERM, HANGUP)))
"""Signals that ask a process to end."""


def handle_on_loop(number: signal.Signals, handler: Callable[..., object], *given: object) -> None:
    """Call ``handler(*given)`` on the running loop when this signal comes."""
    loop = asyncio.get_running_loop()
    try:
        loop.add_signal_handler(number, handler, *given)
    except NotImplementedError:  # on Windows
        signal.signal(number, lambda *_: loop.call_soon_threadsafe(handler, *given))


@contextmanager
def handled(handler: Callable[[int, FrameType | None], object]) -> Iterator[Callable[[int], None]]:
    """Pass signals that ask this process to end to `handler` meanwhile, but for those that were ignored before (nohup).

    It gives a function that lets a signal do what it did before.
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
