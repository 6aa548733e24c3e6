"""The figure of a sweep: the runs of each cell along one or two parameters, and their statistics."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hapnet.errors import InvalidParameter
from hapnet.ext.metrics import METRICS
from hapnet.ext.metrics.measured import quantile

STATS: Mapping[str, Callable[[Any], Any]] = {
    "median": lambda values: quantile(values, 0.5),
    "mean": np.mean,
    "min": np.min,
    "max": np.max,
}

USUAL = "energy_out_J"
"""The default metric: the energy that came out, of which d^2 is allowed."""

_MILLI = ("J", "N", "m", "s", "W")
_SMALL = 0.1  # if the largest figure is smaller, the unit gets the prefix milli


@dataclass
class Cell:
    """The runs at a point of the axes: their values, and how many failed, were not run yet, or were not passive."""

    values: list[float] = field(default_factory=list)
    failed: int = 0
    missing: int = 0
    not_passive: int = 0


@dataclass(frozen=True)
class GridAxis:
    """An axis of the grid: a varied parameter, and its values, ascending if they are numbers, also as text."""

    name: str
    unit: str
    values: tuple[Any, ...]
    words: tuple[str, ...]

    @property
    def label(self) -> str:
        """Name and unit, and a note if the scale is logarithmic."""
        return f"{self.name}{f' [{self.unit}]' * bool(self.unit)}{', log scale' * self.log}"

    @property
    def numeric(self) -> bool:
        return numeric(self.values)

    @property
    def log(self) -> bool:
        """Whether the values are evenly spaced on a log scale, and not on a linear one."""
        if not self.numeric or len(self.values) < 3 or min(self.values) <= 0:
            return False
        ratios, steps = np.diff(np.log(self.values)), np.diff(self.values)
        return bool(np.ptp(ratios) < 0.02 * ratios.max() and np.ptp(steps) > 0.02 * steps.max())


@dataclass(frozen=True)
class Grid:
    """Cells by the indices of their values on `x` and `y` (0 if there is no `y`)."""

    x: GridAxis
    y: GridAxis | None
    cells: Mapping[tuple[int, int], Cell]
    metric: str
    over: tuple[str, ...]
    """The other varied parameters, over which the runs of a cell are taken, as text: ``10 seeds``."""


def numeric(values: Iterable[Any]) -> bool:
    """Whether these are numbers."""
    return all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)


def statistic(name: str) -> Callable[[Any], float]:
    """``median``, ``mean``, ``min``, ``max`` or a percentile such as ``p90``; raises InvalidParameter for another."""
    percent = re.fullmatch(r"p(\d{1,2}|100)", name)
    if percent is not None:
        return lambda values: quantile(values, int(percent[1]) / 100.0)
    if name not in STATS:
        raise InvalidParameter("--stat", name, f"{', '.join(STATS)}, or a percentile such as p90", STATS)
    return lambda values: float(STATS[name](values))


def usual_statistic(metric: str) -> str:
    """The worst run for metrics of passivity, as a single failure is too many; the median for all others."""
    least = metric == "claim_kept" or ("margin" in metric and metric.endswith("_J"))
    return "max" if metric == USUAL else "min" if least else "median"


def metric_label(metric: str, figures: Collection[float]) -> tuple[str, float]:
    """A metric's label with its unit, and the factor for figures of this size: 1000 for small ones.

    A metric that this version of hapnet does not have gets its bare name.
    """
    known = METRICS.get(metric)
    if known is None:
        return metric.replace("_", " "), 1.0
    if known.unit in _MILLI and 0.0 < max(map(abs, figures), default=0.0) < _SMALL:
        return replace(known, unit=f"m{known.unit}").heading, 1e3
    return known.heading, 1.0
