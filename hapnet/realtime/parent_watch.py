"""Check whether the process that started a servo can still end its force. All commands to end it pass through that
process: Ctrl-C, the remote stop, the world.

A parent that a signal or a debugger has stopped is detected at once in /proc. A parent that hangs is detected by its
heartbeat: its event loop sends a frame twenty times a second, and even a busy machine delays none by a second. Looks
are counted, not time, as the servo itself may have been stopped too, and just been continued.
"""

from __future__ import annotations

import os
from contextlib import suppress

LOOK_NS = 10_000_000
"""The time between two looks [ns]; a look takes 4 us, does not block and keeps no memory."""

HANGS_LOOKS = 100
"""A parent without a heartbeat for this many looks hangs. Beside four busy loops, on two cores with a load of 14, at
most 14 looks lay between two of 669 beats."""

STOPPED = "the network process was stopped by a signal"
HANGS = "the network process hangs"

_STOPPED = b"Tt"
"""States of proc_pid_stat(5): stopped by a signal, or by a debugger."""


class ParentWatch:
    """Monitors the process with the id `parent`; call `look` once a tick.

    states : its file in /proc; None: that of its first thread. Without such a file only the heartbeat counts.
    """

    def __init__(self, parent: int, states: str | None = None) -> None:
        self._file = -1
        self._buffer = bytearray(512)
        self._buffers = [self._buffer]
        self._due_ns = 0
        self._looks = -1  # no beat is missed before the first
        self._why = ""
        with suppress(OSError):
            self._file = os.open(states or f"/proc/{parent}/task/{parent}/stat", os.O_RDONLY)

    def beat(self) -> None:
        """Enter a heartbeat of the parent's event loop."""
        self._looks = 0

    def look(self, now_ns: int) -> str:
        """Return why the parent cannot end a force now; empty: it can. After a stop it can again from its next beat."""
        if now_ns < self._due_ns:
            return self._why
        self._due_ns = now_ns + LOOK_NS
        if self._looks >= 0:
            self._looks += 1
        if self._is_stopped():
            self._why, self._looks = STOPPED, HANGS_LOOKS
        elif self._looks < HANGS_LOOKS:
            self._why = ""
        elif not self._why:
            self._why = HANGS
        return self._why

    def close(self) -> None:
        """Close the file in /proc."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def _is_stopped(self) -> bool:
        if self._file < 0 or not hasattr(os, "preadv"):
            return False
        try:
            count = os.preadv(self._file, self._buffers, 0)
        except OSError:  # the process has ended, which the servo detects by itself
            return False
        state = self._buffer.rfind(b")", 0, count) + 2  # after the program's name, which may contain brackets
        return self._buffer[state] in _STOPPED
