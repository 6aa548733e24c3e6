"""Reports how far the compiler is, to a command that waits for it."""

from __future__ import annotations

from collections.abc import Callable
from contextvars import ContextVar

Reported = Callable[[float], None]


def _nobody(share: float) -> None:
    """Nobody waits."""


reported: ContextVar[Reported] = ContextVar("told", default=_nobody)
"""Takes the share that is compiled, 0 to 1, again and again; 1 comes last."""
