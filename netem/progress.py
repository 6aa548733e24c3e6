"""The progress of a long command in one line: redrawn on a terminal, elsewhere a new line from time to time."""

from __future__ import annotations

import threading
import time
from typing import TextIO

SHOW_AFTER_S = 1.0
LINE_EVERY_S = 5.0
_REDRAW_S = 1.0  # rarely, so as not to disturb a measurement


class Progress:
    """Shows a command's progress during the ``with`` block; nothing if it takes less than a second.

    out : where to write.
    doing : what the command does, in words.
    expected_s : expected duration, if known [s].
    """

    def __init__(self, out: TextIO, doing: str, expected_s: float | None = None) -> None:
        self._out, self._doing, self._expected_s = out, doing, expected_s
        self._share = 0.0
        self._began = time.monotonic()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._show, name="progress", daemon=True)

    def __enter__(self) -> Progress:
        self._thread.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self._over.set()
        self._thread.join()

    def at(self, share: float) -> None:
        """Set the share that is done, 0 to 1, if it is known."""
        self._share = share

    def line(self, lasted_s: float) -> str:
        """The line to show after `lasted_s` seconds."""
        share = min(lasted_s / self._expected_s, 1.0) if self._expected_s else self._share
        if not share:
            return f"{self._doing}: {lasted_s:.0f} s so far"
        left_s = self._expected_s - lasted_s if self._expected_s else lasted_s * (1.0 / share - 1.0)
        return f"{self._doing}: {100.0 * share:.0f} %, {max(left_s, 0.0):.0f} s left"

    def _show(self) -> None:
        terminal = self._out.isatty()
        wait_s = SHOW_AFTER_S if terminal else LINE_EVERY_S
        try:
            while not self._over.wait(wait_s):
                line = self.line(time.monotonic() - self._began)
                self._out.write(f"\r{line}\x1b[K" if terminal else f"{line}\n")
                self._out.flush()
                wait_s = _REDRAW_S if terminal else LINE_EVERY_S
            if terminal and time.monotonic() - self._began > SHOW_AFTER_S:
                self._out.write("\r\x1b[K")
                self._out.flush()
        except OSError:
            return  # the reader has closed the output
