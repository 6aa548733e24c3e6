"""A worker's task, wherever it runs: a few cases, one after the other."""

from __future__ import annotations

import math
import os
import socket
import time
from dataclasses import dataclass

from hapnet.errors import HapnetError
from hapnet.ext.study.case import Measures, measure
from hapnet.ext.study.spec import Case, Values, params_of
from hapnet.loading import cause
from netem.errors import NetemError


@dataclass(frozen=True)
class Task:
    """Cases, and what is fixed in all of them. `attempt`: how often a worker died with them before."""

    fixed: Values
    cases: tuple[Case, ...]
    attempt: int = 0


@dataclass(frozen=True)
class CaseResult:
    """The result of a case: its measures, or an error in one line. `worker` is host:process."""

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
    """Run one case. An error in it becomes its result."""
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
    """Describe the failure of a case in one line."""
    return " ".join(str(wrong).split()) if isinstance(wrong, HapnetError | NetemError) else cause(wrong)


def _known(value: float | None) -> float | None:
    """A plain Python number; None if it is not finite."""
    if value is None or not math.isfinite(value):
        return None
    return value if type(value) is int else float(value)
