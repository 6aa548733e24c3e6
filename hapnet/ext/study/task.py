"""A worker's task, a few cases one after the other; and estimates of the duration of a study."""

from __future__ import annotations

import itertools
import math
import os
import socket
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from hapnet.errors import HapnetError
from hapnet.ext.study.case import Measures, measure
from hapnet.ext.study.spec import Case, Values, params_of
from hapnet.loading import cause
from netem.errors import NetemError


@dataclass(frozen=True)
class Task:
    """Cases and their common fixed values. `attempt`: how often a worker has died with these cases."""

    fixed: Values
    cases: tuple[Case, ...]
    attempt: int = 0


@dataclass(frozen=True)
class CaseResult:
    """The result of a case: its measures, or a line with the error. `worker` is host:process."""

    number: int
    measures: Measures
    error: str | None = None
    wall_s: float | None = None
    worker: str | None = None


def run(task: Task) -> list[CaseResult]:
    """Run the cases of `task`. An error in a case becomes the result of that case."""
    worker = f"{socket.gethostname()}:{os.getpid()}"
    return [run_case(task.fixed, case, worker) for case in task.cases]


def run_case(fixed: Values, case: Case, worker: str = "") -> CaseResult:
    """Run a case. An error in the case becomes its result."""
    began = time.perf_counter()
    measures: Measures = {}
    error = None
    try:
        measured = measure(params_of(fixed, case.given), case.seed)
        measures = {name: _known(value) for name, value in measured.items()}
    except Exception as wrong:  # a user's own scene may raise anything
        error = reason(wrong)
    return CaseResult(case.number, measures, error, time.perf_counter() - began, worker)


def reason(wrong: Exception) -> str:
    """Return the failure of a case as one line."""
    return " ".join(str(wrong).split()) if isinstance(wrong, HapnetError | NetemError) else cause(wrong)


def _known(value: float | None) -> float | None:
    """A plain Python number; None if it is not finite."""
    if value is None or not math.isfinite(value):
        return None
    return value if type(value) is int else float(value)


Part = TypeVar("Part")
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


def spread(parts: Sequence[Part], most: int = 8) -> list[Part]:
    """Up to `most` of these parts, spread over the whole list.

    They are spread by the golden ratio: in a list of all combinations, parts at equal distances may all have the same
    coupling.
    """
    places: list[int] = []
    part = itertools.count(1)
    while len(places) < min(most, len(parts)):
        place = int(len(parts) * (next(part) * _GOLDEN % 1.0))
        if place not in places:
            places.append(place)
    return [parts[place] for place in places]


def mean_seconds(
    run: Callable[[Part], object],
    parts: Sequence[Part],
    limit_s: float = 5.0,
    clock: Callable[[], float] = time.perf_counter,
) -> tuple[float, int]:
    """The mean time of `run` for a part, in this process [s], and the number of parts in this mean.

    At most 8 parts are run, and at most half; after `limit_s` no further part is begun. The first part is run once
    before, as it also loads modules; that run counts only if no other is made.
    """

    def timed(part: Part) -> float:
        began = clock()
        run(part)
        return clock() - began

    some = spread(parts, min(8, max(1, len(parts) // 2)))
    first_s = timed(some[0])
    took_s: list[float] = []
    while len(took_s) < len(some) and first_s + sum(took_s) <= limit_s:
        took_s.append(timed(some[len(took_s)]))
    took_s = took_s or [first_s]
    return sum(took_s) / len(took_s), len(took_s)
