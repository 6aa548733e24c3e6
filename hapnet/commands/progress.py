"""The progress of a command: on a terminal a bar with the remaining time, otherwise a line at intervals."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from io import UnsupportedOperation
from typing import TYPE_CHECKING

from hapnet.loading import extension

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress as Bar

BAR_AFTER_S = 1.0
"""A command that ends before this time shows no bar [s]."""
LINE_EVERY_S = 5.0
_REDRAW_S = 0.1

_CLEAR = b"\r\x1b[2K"
_ERASE = _CLEAR + b"\x1b[?25h"  # clears the line, and shows the cursor

_drawn: set[Progress] = set()


class Progress:
    """Shows the progress of a command during the ``with`` block; a bar is erased at the end.

    console : of standard error.
    doing : the activity, such as "simulating".
    total : the final value of `update`; None: unknown.
    unit : of `total`; "": `doing` contains the numbers.
    background : draw from a separate thread, so that the time advances between calls of `update`. Without it each
        `update` is shown at once and nothing runs in between, for measurements.
    clock : [s].
    """

    def __init__(
        self,
        console: Console,
        doing: str,
        total: float | None = None,
        unit: str = "s",
        *,
        background: bool = True,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._console, self._clock = console, clock
        self._began = clock()
        self._background = background
        self._bar_after_s, self._line_every_s = (BAR_AFTER_S, LINE_EVERY_S) if background else (0.0, 0.0)
        self._next_line_s = self._line_every_s
        self._bar: Bar | None = None
        self._compiled = 1.0  # the share of what is compiled now
        self._over = threading.Event()
        self._lock = threading.RLock()
        self._thread = threading.Thread(target=self._redraw, name="progress", daemon=True)
        self.stage(doing, total, unit)

    def __enter__(self) -> Progress:
        self._before = extension("compiling").reported.set(self._compiling)
        if self._background:
            self._thread.start()
        return self

    def __exit__(self, *exc: object) -> None:
        extension("compiling").reported.reset(self._before)
        self._over.set()
        with self._lock:
            if self._bar is not None:
                self._bar.stop()
                _drawn.discard(self)
        if self._background:
            self._thread.join()

    def stage(self, doing: str, total: float | None = None, unit: str = "s") -> None:
        """Begin another stage, at zero."""
        with self._lock:
            self._doing, self._total, self._unit = doing, total, unit
            self._done = 0.0
            self._first: tuple[float, float] | None = None  # the first update: its time and how much was done

    def update(self, done: float, doing: str | None = None) -> None:
        """Set how much of the total is done."""
        self._done = done
        self._doing = doing or self._doing
        if self._first is None:
            self._first = self._clock(), done
        if not self._background:
            self.tick()

    def tick(self) -> None:
        """Show the progress if it is due; the thread calls it, or `update` if there is no thread."""
        with self._lock:
            lasted_s = self._clock() - self._began
            if self._over.is_set():
                return
            if self._console.is_terminal:
                if lasted_s >= self._bar_after_s:
                    self._draw()
            elif lasted_s >= self._next_line_s:
                self._next_line_s = lasted_s + self._line_every_s
                known = [words for words in (self._count(), self._left()) if words]
                if not known and self._background:
                    known = [f"{lasted_s:.0f} s so far"]
                self._console.print(": ".join(filter(None, (self._doing, ", ".join(known)))), markup=False)

    def _compiling(self, share: float) -> None:
        """Show the compiler's progress on a terminal, beside the command's own."""
        self._compiled = share
        if not self._background:
            self.tick()

    @contextmanager
    def cleared(self) -> Iterator[None]:
        """A context in which the bar's line is clear."""
        with self._lock:
            with suppress(OSError, UnsupportedOperation):
                os.write(self._console.file.fileno(), _CLEAR)
            yield

    def erase(self) -> None:
        """Clear the line and restore the cursor at once, before the process ends."""
        self._over.set()
        free = self._lock.acquire(timeout=_REDRAW_S)  # fails only if the terminal blocks the thread that draws
        with suppress(OSError):
            os.write(self._console.file.fileno(), _ERASE)
        if free:
            self._lock.release()

    def _redraw(self) -> None:
        while not self._over.wait(_REDRAW_S):
            self.tick()

    def _draw(self) -> None:
        if self._bar is None:
            from rich.progress import BarColumn, Progress, TextColumn
            from rich.table import Column

            def text(name: str) -> TextColumn:
                return TextColumn(f"{{task.{name}}}", markup=False, table_column=Column(no_wrap=True))

            columns = (text("description"), BarColumn(bar_width=30), text("fields[count]"), text("fields[left]"))
            self._bar = Progress(
                *columns,
                console=self._console,
                auto_refresh=False,
                transient=True,
                redirect_stdout=False,  # output for programs must not go to the bar's stream
                redirect_stderr=False,
            )
            self._bar.add_task(self._doing, count="", left="")
            _drawn.add(self)
            self._bar.start()
        self._bar.update(
            self._bar.task_ids[0],
            description=self._doing if self._compiled == 1.0 else f"{self._doing} (compiling: {self._compiled:.0%})",
            total=self._total,
            completed=self._done,
            count=self._count(),
            left=self._left(),
            refresh=True,
        )

    def _count(self) -> str:
        if self._total is None or not self._unit:
            return f"{self._done:.0f} {self._unit}" if self._done and self._unit else ""
        digits = 0 if self._total >= 10.0 else 1
        if isinstance(self._total, int):
            digits = 0
        return f"{self._done:.{digits}f} of {self._total:g} {self._unit}"

    def _left(self) -> str:
        """The time left, at the speed since the first update."""
        if self._total is None or self._first is None:
            return ""
        at, before = self._first
        if not before < self._done <= self._total:
            return ""
        return f"{duration((self._clock() - at) * (self._total - self._done) / (self._done - before))} left"


@contextmanager
def room() -> Iterator[None]:
    """A context in which no bar is drawn, so that other output can be written there."""
    with ExitStack() as held:
        for progress in tuple(_drawn):
            held.enter_context(progress.cleared())
        yield


def erase() -> None:
    """Erase all bars; for a process that ends without leaving their ``with`` blocks."""
    for progress in tuple(_drawn):
        progress.erase()


def duration(seconds: float) -> str:
    """A duration in seconds, in minutes, or in hours and minutes."""
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"
