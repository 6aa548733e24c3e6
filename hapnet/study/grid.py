"""The results of a sweep along one or two varied parameters: the runs of each cell, and their statistics."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hapnet.errors import HapnetError, InvalidParameter
from hapnet.metrics import METRICS
from hapnet.study.case import was_passive
from hapnet.study.journal import Journal, Row
from hapnet.study.misses import quantile, value_of
from hapnet.study.spec import LINK, SEED, value_words

STATS: Mapping[str, Callable[[Any], Any]] = {
    "median": lambda values: quantile(values, 0.5),
    "mean": np.mean,
    "min": np.min,
    "max": np.max,
}

USUAL = "energy_out_J"
"""The default metric: how near a run came to the energy that d^2 allows."""

_MILLI = ("J", "N", "m", "s", "W")
_SMALL = 0.1  # largest figure below which thousandths read better


@dataclass
class Cell:
    """The runs at one point of the axes: their values, and how many failed, were not run yet, or were not passive."""

    values: list[float] = field(default_factory=list)
    failed: int = 0
    missing: int = 0
    not_passive: int = 0

    def add(self, row: Row, metric: str) -> None:
        value = value_of(row.measures, metric)
        self.not_passive += not was_passive(row.measures)
        if not row.done:
            self.missing += 1
        elif row.error is not None:
            self.failed += 1
        elif value is not None:
            self.values.append(float(value))


@dataclass(frozen=True)
class Axis:
    """One axis of the grid: a parameter that varies, and its values, ascending if they are numbers."""

    name: str
    unit: str
    values: tuple[Any, ...]

    @property
    def label(self) -> str:
        """Name and unit, and a note if the scale is logarithmic."""
        return f"{self.name}{f' [{self.unit}]' * bool(self.unit)}{', log scale' * self.log}"

    @property
    def numeric(self) -> bool:
        return all(isinstance(value, int | float) and not isinstance(value, bool) for value in self.values)

    @property
    def log(self) -> bool:
        """Are the values evenly spaced on a log scale, and not on a linear one?"""
        if not self.numeric or len(self.values) < 3 or min(self.values) <= 0:
            return False
        ratios, steps = np.diff(np.log(self.values)), np.diff(self.values)
        return bool(np.ptp(ratios) < 0.02 * ratios.max() and np.ptp(steps) > 0.02 * steps.max())

    @property
    def words(self) -> list[str]:
        return [_words(self.name, value) for value in self.values]


@dataclass(frozen=True)
class Grid:
    """Cells by the indices of their values on `x` and `y` (0 if there is no `y`)."""

    x: Axis
    y: Axis | None
    cells: Mapping[tuple[int, int], Cell]
    metric: str
    over: tuple[str, ...]
    """What the runs of a cell differ in, as text: ``10 seeds``."""


def grid(
    journal: Journal,
    x: str | None,
    y: str | None,
    metric: str | None,
    where: Mapping[str, str],
    units: Mapping[str, str],
) -> Grid:
    """The runs of `journal` that match `where`, sorted into cells.

    Without `x` and `y` the axes are the two names with the most values; with `x` alone there is only that axis.

    where : values by name. units : of the parameters by name.

    Raises
    ------
    InvalidParameter : the sweep has no such name or value. HapnetError : there is nothing to draw.
    """
    names = [*journal.varied, SEED]
    for flag, name in (("--x", x), ("--y", y), *(("--where", name) for name in where)):
        if name is not None and name not in names:
            raise InvalidParameter(flag, name, f"what varies in this sweep: {', '.join(names)}", names)
    rows = list(journal.rows())
    for name, words in where.items():
        kept = [row for row in rows if _is(name, _value(row, name), words)]
        if not kept:
            raise InvalidParameter(f"--where {name}", words, ", ".join(axis(name, rows, units).words))
        rows = kept
    metrics = list(dict.fromkeys(name for row in rows for name in row.measures))
    if not metrics:
        raise HapnetError("nothing to draw: no case has a result")
    if metric is not None and metric not in metrics:
        raise InvalidParameter("--value", metric, ", ".join(metrics), metrics)
    metric = metric or (USUAL if USUAL in metrics else metrics[0])
    axes = {name: axis(name, rows, units) for name in names}
    x, y = _chosen(axes, x, y)
    along = [axes[name] for name in (x, y) if name is not None]
    index = [{_key(value): i for i, value in enumerate(each.values)} for each in along]
    cells: dict[tuple[int, int], Cell] = {}
    for row in rows:
        where_is = [at[_key(_value(row, each.name))] for at, each in zip(index, along, strict=True)]
        place = (where_is[0], where_is[1] if len(where_is) > 1 else 0)
        cells.setdefault(place, Cell()).add(row, metric)
    over = [f"{len(axes[n].values)} {_plural(n)}" for n in names if n not in (x, y) and len(axes[n].values) > 1]
    return Grid(axes[x], None if y is None else axes[y], cells, metric, tuple(over))


def axis(name: str, rows: Iterable[Row], units: Mapping[str, str]) -> Axis:
    """The axis `name`, with the values in these rows."""
    found = {_key(value): value for value in (_value(row, name) for row in rows)}
    values = tuple(found.values())
    drawn = Axis(name, units.get(name, ""), values)
    return replace(drawn, values=tuple(sorted(values))) if drawn.numeric else drawn


def statistic(name: str) -> Callable[[Any], float]:
    """``median``, ``mean``, ``min``, ``max`` or a percentile such as ``p90``; raises InvalidParameter for another."""
    percent = re.fullmatch(r"p(\d{1,2}|100)", name)
    if percent is not None:
        return lambda values: quantile(values, int(percent[1]) / 100.0)
    if name not in STATS:
        raise InvalidParameter("--stat", name, f"{', '.join(STATS)}, or a percentile such as p90", STATS)
    return lambda values: float(STATS[name](values))


def usual_statistic(metric: str) -> str:
    """The worst run for metrics of passivity, since one failure is too many; the median for all others."""
    least = metric == "claim_kept" or ("margin" in metric and metric.endswith("_J"))
    return "max" if metric == USUAL else "min" if least else "median"


def metric_label(metric: str, figures: Collection[float]) -> tuple[str, float]:
    """A metric's label with its unit, and the factor for figures of this size: 1000 for small ones.

    A metric that this version does not know gets its bare name.
    """
    known = METRICS.get(metric)
    if known is None:
        return metric.replace("_", " "), 1.0
    if known.unit in _MILLI and 0.0 < max(map(abs, figures), default=0.0) < _SMALL:
        return replace(known, unit=f"m{known.unit}").heading, 1e3
    return known.heading, 1.0


def _chosen(axes: Mapping[str, Axis], x: str | None, y: str | None) -> tuple[str, str | None]:
    """The axes to draw: those asked for, otherwise those with the most values; the seed only if nothing else varies."""
    if x is not None:
        if x == y:
            raise InvalidParameter("--y", y, f"one other than --x: {', '.join(name for name in axes if name != x)}")
        return x, y
    free = sorted((n for n in axes if n not in (SEED, y)), key=lambda name: -len(axes[name].values))
    most = [name for name in free if len(axes[name].values) > 1] or [SEED]
    if y is not None:
        return most[0], y
    return most[0], most[1] if len(most) > 1 else None


def _value(row: Row, name: str) -> Any:
    return row.case.seed if name == SEED else row.case.values[name]


def _key(value: Any) -> str:
    return repr(value)


def _words(name: str, value: Any) -> str:
    """A value as an axis shows it: a number with four digits, a whole number without a point."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value_words(name, value)
    return f"{value:.0f}" if value == round(value) and abs(value) < 1e6 else f"{value:.4g}"


def _is(name: str, value: Any, text: str) -> bool:
    """Does this text, as in an axis or a table, mean this value?"""
    return text.strip() in (_words(name, value), value_words(name, value))


def _plural(name: str) -> str:
    return f"{name}s" if name in (SEED, LINK, "coupling", "operator", "scene") else f"values of {name}"
