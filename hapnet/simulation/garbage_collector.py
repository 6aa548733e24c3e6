"""Garbage collection, kept out of what makes no garbage of the kind that it looks for."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def collector_paused() -> Iterator[None]:
    """No automatic collection of cycles in here. A simulation makes none, and its samples set off one search after the
    other through all that the program holds: in a large program that took an eighth of the time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
