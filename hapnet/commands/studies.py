"""Runs the cases of a journal that have no result, for `hapnet sweep` and `hapnet compare`."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hapnet.commands import output
from hapnet.commands.progress import Progress
from hapnet.errors import HapnetError
from hapnet.study.backend import Backend
from hapnet.study.journal import Journal
from hapnet.study.runner import Sweep

if TYPE_CHECKING:
    from rich.console import Console

INTERRUPTED = 130


@dataclass(frozen=True)
class StudyOutcome:
    """The state of the cases after a run: their `total`, how many had a result `before`, and how many are `done` now.

    stopped : what ended the run before all were done; None: nothing did.
    """

    total: int
    before: int
    done: int
    failed: int
    lasted_s: float
    stopped: KeyboardInterrupt | HapnetError | None

    def stop(self, how_to_go_on: str) -> int:
        """The exit code of a stopped study; prints how to continue it. Raises HapnetError if an error stopped it."""
        line = f"{self.done} of {self.total} cases are done; {how_to_go_on}"
        if isinstance(self.stopped, HapnetError):
            raise HapnetError(f"{self.stopped}: {line}") from self.stopped
        output.complain(f"stopped: {line}")
        return INTERRUPTED


def run_missing(words: Console, journal: Journal, doing: str, backend: Callable[[int], Backend]) -> StudyOutcome:
    """Run the cases of `journal` that have no result, on ``backend(number of these cases)``.

    Raises
    ------
    HapnetError : the backend is not available; no case was run.
    """
    if journal.other_version is not None:
        text = f"hapnet {journal.other_version} ran the first of these cases: its results are kept, and may differ"
        output.show_warnings(words, (text,))
    total, before, _ = journal.count()
    began = time.monotonic()
    stopped: KeyboardInterrupt | HapnetError | None = None
    if before < total:
        workers: Backend | None = None
        try:
            workers = backend(total - before)
            with Progress(words, doing, total, "cases") as progress:
                Sweep(journal, workers, progress.update).run()
        except (KeyboardInterrupt, HapnetError) as ended:
            if workers is None and isinstance(ended, HapnetError):
                raise
            stopped = ended
        finally:
            if workers is not None:
                workers.close()
    lasted_s = time.monotonic() - began
    total, done, failed = journal.count()
    return StudyOutcome(total, before, done, failed, lasted_s, stopped)
