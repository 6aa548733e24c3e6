"""Signals that ask a process to end, as far as this system has them, and their handlers on an event loop."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable

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
