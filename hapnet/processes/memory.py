"""Memory that a process has freed, and that glibc keeps in parts between what is still used."""

from __future__ import annotations

import asyncio
import ctypes
import sys
from contextlib import suppress

EVERY_S = 60.0


async def give_back_freed() -> None:
    """Give freed memory back to the system once a minute, until cancelled.

    A page that is drawn for hours would otherwise take some megabytes an hour more. Not for a process with a servo,
    whose allocations would wait for some milliseconds.
    """
    while True:
        await asyncio.sleep(EVERY_S)
        if sys.platform == "linux":
            with suppress(AttributeError, OSError):  # another C library has no such function
                ctypes.CDLL(None).malloc_trim(0)
