"""How long the calling thread ran or waited for a processor: all else of its time it slept, or was blocked."""

from __future__ import annotations

import os
import threading
from contextlib import suppress


class ThreadTime:
    """Reads that of the thread that calls it [ns], since the thread began; 0 where the system does not say (Linux does:
    proc_pid_schedstat(5)). A look takes some microseconds and allocates nothing that stays."""

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
        """Look no more."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def _open(self, thread: int) -> None:
        self.close()
        self._thread = thread
        if hasattr(os, "preadv"):
            with suppress(OSError):
                self._file = os.open(f"/proc/self/task/{thread}/schedstat", os.O_RDONLY)
