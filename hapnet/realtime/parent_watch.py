"""Check whether the process that started a servo can still end its force. Each word that could goes through that
process: Ctrl-C, the remote stop, the world.

A parent that a signal or a debugger has stopped shows in /proc, without doubt and at once. One that hangs shows by its
heartbeat: its event loop sends a frame twenty times a second, and none for a second is no busy machine any more. Looks
are counted, not time, as whoever looks may have been stopped too, and just been continued.
"""

from __future__ import annotations

import os
from contextlib import suppress

LOOK_NS = 10_000_000
"""The time between two looks [ns]; one takes 4 us, waits for nothing and allocates nothing that stays."""

HANGS_LOOKS = 100
"""A heart that does not beat for so many looks stands still. Beside four busy loops, on two cores with a load of 14, at
most 14 looks lay between two of 669 beats."""

STOPPED = "the process that holds the network was stopped by a signal"
HANGS = "the process that holds the network hangs"

_STOPPED = b"Tt"
"""States of proc_pid_stat(5): stopped by a signal, or by a debugger."""


class ParentWatch:
    """Watches the process with this number; `look` once a tick.

    states : its file in /proc; None: that of its first thread. Where there is no such file only the heartbeat counts.
    """

    def __init__(self, parent: int, states: str | None = None) -> None:
        self._file = -1
        self._buffer = bytearray(512)
        self._buffers = [self._buffer]
        self._due_ns = 0
        self._looks = -1  # before the first beat there is none to miss
        self._why = ""
        with suppress(OSError):
            self._file = os.open(states or f"/proc/{parent}/task/{parent}/stat", os.O_RDONLY)

    def beat(self) -> None:
        """Its event loop goes on."""
        self._looks = 0

    def look(self, now_ns: int) -> str:
        """Why nobody could end a force now; empty: somebody could. One that had stopped is back with its next beat."""
        if now_ns < self._due_ns:
            return self._why
        self._due_ns = now_ns + LOOK_NS
        if self._looks >= 0:
            self._looks += 1
        if self._stands_still():
            self._why, self._looks = STOPPED, HANGS_LOOKS
        elif self._looks < HANGS_LOOKS:
            self._why = ""
        elif not self._why:
            self._why = HANGS
        return self._why

    def close(self) -> None:
        """Look no more."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def _stands_still(self) -> bool:
        if self._file < 0 or not hasattr(os, "preadv"):
            return False
        try:
            count = os.preadv(self._file, self._buffers, 0)
        except OSError:  # it is gone, which the servo sees by itself
            return False
        state = self._buffer.rfind(b")", 0, count) + 2  # behind the program's name, which may have brackets of its own
        return self._buffer[state] in _STOPPED
