"""A benchmark's result: distributions per round, their figures, and those of a bare reference.

`cost` measures one call: subject and reference take turns, so that a disturbance affects both.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from statistics import median
from typing import Any

import numpy as np

from hapnet.checks import Array


@dataclass(frozen=True)
class Options:
    """The length and number of measurements.

    seconds : length of a round [s]. rounds : their number; figures are medians over them.
    realtime : SCHED_FIFO for the servo and for the bare loop. beside : number of busy processes during servo_traffic.
    """

    seconds: float
    rounds: int
    realtime: bool = False
    beside: int = 0


@dataclass(frozen=True)
class Distribution:
    """Measured values, ascending, and how often each occurred."""

    values: Array
    counts: Array

    @classmethod
    def of(cls, samples: Iterable[float], scale: float = 1.0) -> Distribution:
        """A distribution of single measurements, each multiplied by `scale`."""
        values = np.sort(np.fromiter(samples, dtype=float)) * scale
        return cls(values, np.ones(len(values)))

    @classmethod
    def of_bins(cls, bins: Iterable[Sequence[float]], scale: float = 1.0) -> Distribution:
        """A distribution of (value, count) pairs, ascending; each value is multiplied by `scale`."""
        table = np.array(list(bins), dtype=float).reshape(-1, 2)
        return cls(table[:, 0] * scale, table[:, 1])

    @classmethod
    def together(cls, parts: Sequence[Distribution]) -> Distribution:
        """All parts in one distribution."""
        values = np.concatenate([part.values for part in parts])
        order = np.argsort(values)
        return cls(values[order], np.concatenate([part.counts for part in parts])[order])

    def quantile(self, q: float) -> float:
        """The smallest value that at least a share `q` of the measurements does not exceed."""
        reached = np.cumsum(self.counts)
        return float(self.values[np.searchsorted(reached, q * reached[-1])])


@dataclass(frozen=True)
class RoundFigures:
    """Figures over the rounds: the minimum, the median of the medians, and the median of the 99th percentiles."""

    minimum: float
    median: float
    p99: float

    @classmethod
    def of(cls, rounds: Sequence[Distribution], *, higher_is_better: bool = False) -> RoundFigures:
        """The figures of these rounds. `p99` is the worst of the best 99 %: for rates the first percentile."""
        tail = 0.01 if higher_is_better else 0.99
        return cls(
            min(float(part.values[0]) for part in rounds),
            median(part.quantile(0.5) for part in rounds),
            median(part.quantile(tail) for part in rounds),
        )


@dataclass(frozen=True)
class Limit:
    """A limit that the project sets for a row: a figure (`Row.figure`) and its bound."""

    figure: str
    bound: float
    at_least: bool = False

    def met(self, value: float) -> bool:
        return value >= self.bound if self.at_least else value <= self.bound

    def __str__(self) -> str:
        return f"{self.figure} {'≥' if self.at_least else '≤'} {self.bound:g}"


@dataclass(frozen=True)
class Row:
    """A line of the table.

    name, unit : of the figures. what, against : descriptions of the subject and of the bare reference.
    rounds, bare_rounds : the measurements of each round; empty: not measured, and `note` has the reason.
    more : further figures by name. limits : that the project sets. panel : whether the row has a histogram.
    """

    name: str
    unit: str
    what: str
    rounds: Sequence[Distribution] = field(default=(), repr=False)
    against: str = ""
    bare_rounds: Sequence[Distribution] = field(default=(), repr=False)
    more: Mapping[str, float] = field(default_factory=dict)
    limits: tuple[Limit, ...] = ()
    note: str = ""
    higher_is_better: bool = False
    panel: bool = True

    @cached_property
    def figures(self) -> RoundFigures | None:
        """The figures of the subject."""
        return RoundFigures.of(self.rounds, higher_is_better=self.higher_is_better) if self.rounds else None

    @cached_property
    def reference(self) -> RoundFigures | None:
        """The figures of the bare reference."""
        return RoundFigures.of(self.bare_rounds, higher_is_better=self.higher_is_better) if self.bare_rounds else None

    @property
    def ratio(self) -> float | None:
        """The median divided by the reference's; both are medians over the rounds (`RoundFigures`)."""
        return self._over(lambda figures: figures.median)

    @property
    def ratio_p99(self) -> float | None:
        """The 99th percentile divided by the reference's; both are medians over the rounds."""
        return self._over(lambda figures: figures.p99)

    def figure(self, name: str) -> float | None:
        """A figure by name: median, p99, ratio, ratio_p99, or one of `more`."""
        if name in ("median", "p99"):
            return None if self.figures is None else float(getattr(self.figures, name))
        return getattr(self, name) if name in ("ratio", "ratio_p99") else self.more.get(name)

    def verdicts(self) -> list[tuple[Limit, bool]]:
        """Every limit whose figure was measured, and whether it was met."""
        found = [(limit, self.figure(limit.figure)) for limit in self.limits]
        return [(limit, limit.met(value)) for limit, value in found if value is not None]

    def as_dict(self) -> dict[str, Any]:
        """The row as in `--json`."""
        figures, reference = self.figures, self.reference
        return {
            "name": self.name,
            "unit": self.unit,
            "min": None if figures is None else figures.minimum,
            "median": None if figures is None else figures.median,
            "p99": None if figures is None else figures.p99,
            "reference": None
            if reference is None
            else {"min": reference.minimum, "median": reference.median, "p99": reference.p99, "what": self.against},
            "ratio": self.ratio,
            "ratio_p99": self.ratio_p99,
            "better": "higher" if self.higher_is_better else "lower",
            "what": self.what,
            "allowed": [{"limit": str(limit), "met": met} for limit, met in self.verdicts()],
            **({"more": dict(self.more)} if self.more else {}),
            **({"note": self.note} if self.note else {}),
        }

    def _over(self, figure: Callable[[RoundFigures], float]) -> float | None:
        if self.figures is None or self.reference is None or figure(self.reference) == 0.0:
            return None
        return figure(self.figures) / figure(self.reference)


_TURN = 50  # calls in one turn
_SHARE = 0.1  # of a round's length, as costs vary less than lateness


class Call:
    """A call to time; `prepare` runs before each call, untimed."""

    def __init__(self, call: Callable[[], object], prepare: Callable[[], object] | None = None) -> None:
        self.call: Callable[[], object] = call
        self.prepare: Callable[[], object] | None = prepare

    def turn(self, into: list[int]) -> None:
        call, prepare, clock = self.call, self.prepare, time.perf_counter_ns
        for _ in range(_TURN):
            if prepare is not None:
                prepare()
            began = clock()
            call()
            into.append(clock() - began)


def cost(subject: Call, reference: Call, options: Options) -> tuple[list[Distribution], list[Distribution]]:
    """The time per call [us], a distribution for each round."""
    rounds: tuple[list[Distribution], list[Distribution]] = ([], [])
    automatic = gc.isenabled()
    try:
        for _ in range(options.rounds):
            gc.collect()
            gc.disable()
            for call in (subject, reference):
                call.turn([])  # warm
            times: tuple[list[int], list[int]] = ([], [])
            end = time.perf_counter() + _SHARE * options.seconds
            while time.perf_counter() < end or not times[0]:
                subject.turn(times[0])
                reference.turn(times[1])
            for kept, measured in zip(rounds, times, strict=True):
                kept.append(Distribution.of(measured, 1e-3))
    finally:
        if automatic:
            gc.enable()
    return rounds
