"""Reports the compiler's progress to a command that waits for it."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

Reported = Callable[[float], None]


def _ignore(share: float) -> None:
    """Do nothing: no command waits."""


reported: ContextVar[Reported] = ContextVar("reported", default=_ignore)
"""Takes the compiled share, 0 to 1, repeatedly; 1 comes last."""


@contextmanager
def reporting(functions: int) -> Iterator[None]:
    """Report the share of these functions that numba has compiled; nothing if numba only loads them."""
    event = importlib.import_module("numba.core.event")
    report, done = reported.get(), 0

    class Compiled(event.Listener):  # type: ignore[name-defined, misc]  # numba has no types
        def on_start(self, event: object) -> None:
            """Do nothing: only finished functions count."""

        def on_end(self, event: object) -> None:
            nonlocal done
            done += 1
            report(min(done / functions, 0.99))

    with event.install_listener("numba:compile", Compiled()):
        yield
    if done:
        report(1.0)
