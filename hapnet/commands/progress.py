"""The progress of a command: on a terminal rich's bar with the remaining time, otherwise a line at intervals."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING

from hapnet.loading import extension

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress as Bar, Task

BAR_AFTER_S = 1.0
"""A command that ends before this time shows no bar [s]."""
LINE_EVERY_S = 5.0

_ERASE = b"\r\x1b[2K\x1b[?25h"  # clears the line, and shows the cursor

_drawn: list[Console] = []
"""The terminals on which a bar is drawn."""


class Progress:
    """Shows the progress of a command during the ``with`` block; a bar is erased at the end.

    console : the command's; its text appears above the bar.
    doing : the activity, such as "simulating".
    total : the final value of `update`; None: unknown.
    unit : of `total`; "": `doing` contains the numbers.
    background : draw from separate threads, so that the time advances between calls of `update`. Without it each
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
        self._console, self._background = console, background
        self._bar = _bar(console, background, clock)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._show_later, name="progress", daemon=True)
        self.stage(doing, total, unit)

    def __enter__(self) -> Progress:
        self._before = extension("compiling").reported.set(self._compiling)
        if self._background:
            self._thread.start()
        return self

    def __exit__(self, *exc: object) -> None:
        extension("compiling").reported.reset(self._before)
        self._over.set()
        if self._background:
            self._thread.join()
        if self._bar.live.is_started:
            self._bar.stop()
            _drawn.remove(self._console)

    def stage(self, doing: str, total: float | None = None, unit: str = "s") -> None:
        """Begin another stage, at zero."""
        for task in self._bar.task_ids:
            self._bar.remove_task(task)
        self._task, self._done = self._bar.add_task(doing, total=total, unit=unit, compiling=""), 0.0

    def update(self, done: float, doing: str | None = None) -> None:
        """Set how much of the total is done."""
        self._bar.update(self._task, description=doing)
        self._bar.advance(self._task, done - self._done)  # counts for the time left even if it is zero
        self._done = done
        if not self._background:
            self.show()

    def show(self) -> None:
        """Draw the bar, or write a line; the thread calls it, or `update` if there is no thread."""
        if self._console.is_terminal:
            if not self._bar.live.is_started:
                _drawn.append(self._console)
                self._bar.start()
            self._bar.refresh()
            return
        for task in self._bar.tasks:
            known = [words for words in (_count(task), _left(task)) if words]
            if not known and self._background:
                known = [f"{task.elapsed or 0.0:.0f} s so far"]
            self._console.print(": ".join(filter(None, (task.description, ", ".join(known)))), markup=False)

    def _compiling(self, share: float) -> None:
        """Show the compiler's progress on a terminal, beside the command's own."""
        self._bar.update(self._task, compiling="" if share == 1.0 else f" (compiling: {share:.0%})")
        if self._console.is_terminal and not self._background:
            self.show()

    def _show_later(self) -> None:
        if self._console.is_terminal:
            if not self._over.wait(BAR_AFTER_S):
                self.show()
        else:
            while not self._over.wait(LINE_EVERY_S):
                self.show()


def _bar(console: Console, background: bool, clock: Callable[[], float]) -> Bar:
    from rich.progress import BarColumn, Progress, ProgressColumn
    from rich.table import Column
    from rich.text import Text

    class Words(ProgressColumn):
        def __init__(self, of: Callable[[Task], str]) -> None:
            super().__init__(Column(no_wrap=True))
            self._of = of

        def render(self, task: Task) -> Text:
            return Text(self._of(task))

    return Progress(
        Words(lambda task: task.description + task.fields["compiling"]),
        BarColumn(bar_width=30),
        Words(_count),
        Words(_left),
        console=console,
        auto_refresh=background,
        refresh_per_second=10,
        speed_estimate_period=3600.0,  # a single step may last minutes
        transient=True,
        get_time=clock,
        redirect_stdout=sys.stdout.isatty(),  # output for programs must not go to the bar's stream
    )


def _count(task: Task) -> str:
    unit = task.fields["unit"]
    if task.total is None or not unit:
        return f"{task.completed:.0f} {unit}" if task.completed and unit else ""
    digits = 0 if task.total >= 10.0 or isinstance(task.total, int) else 1
    return f"{task.completed:.{digits}f} of {task.total:g} {unit}"


def _left(task: Task) -> str:
    left_s = task.time_remaining
    return "" if left_s is None else f"{duration(left_s)} left"


def erase() -> None:
    """Erase all bars and restore the cursor at once, before the process ends."""
    for console in _drawn:
        console.quiet = True  # the thread that draws may be about to
        with suppress(OSError):
            os.write(console.file.fileno(), _ERASE)


def duration(seconds: float) -> str:
    """A duration in seconds, in minutes, or in hours and minutes."""
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"
