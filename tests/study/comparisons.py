"""A small comparison, and made-up measures of its cases."""

from collections.abc import Callable
from pathlib import Path

from hapnet.ext.metrics import METRICS
from hapnet.ext.study import plans
from hapnet.ext.study.backend import Backend
from hapnet.ext.study.case import Measures
from hapnet.ext.study.compare import ComparedRun, Plan, RunMeasures
from hapnet.ext.study.journal import Journal
from hapnet.ext.study.runner import Sweep
from hapnet.params import Params

QUICK_PARAMS = plans.BASE.set({"duration_s": 0.2})
LINKS = {"near": ("delay 1ms", "delay 1ms"), "far": ("delay 20ms 5ms loss 5%", "delay 30ms")}


def plan(params: Params = QUICK_PARAMS, couplings: tuple[str, ...] = ("pspm", "zoh"), seeds: int = 2) -> Plan:
    return Plan(params, couplings, LINKS, ("press", "sine@light"), tuple(range(seeds)))


def known(**values: float | None) -> Measures:
    return {**dict.fromkeys(METRICS, None), "margin_J": 0.1, "hand_margin_J": 0.05, **values}


def outcomes(asked: Plan, measures: Callable[[ComparedRun], Measures | None]) -> list[RunMeasures]:
    found = [(one, measures(one)) for one in asked.cases()]
    return [RunMeasures(one, values, None if values else "it broke") for one, values in found]


def compared(asked: Plan, directory: Path, backend: Backend) -> list[RunMeasures]:
    """As the command does."""
    spec = asked.spec
    journal = Journal.create_or_resume(directory, spec, spec.cases())
    Sweep(journal, backend, lambda done: None).run()
    backend.close()
    found = asked.outcomes(journal.rows())
    journal.close()
    return found
