"""The goal of a tuning: an objective, the lower the better, and constraints that no chosen values may break.

::

    objective = "free_rms_mm"                                              # one metric, by its median, or
    objective = { free_rms_mm = 1.0, buzz_N2 = { weight = 10, quantile = 0.9 } }       # a weighted sum of several
    constraints = ["passive", "peak_force_N <= 2", "stiffness_percent >= 90 in 75 %"]  # in every case, or in a share

A metric enters the objective by its cost: its value if lower is better, its negative if higher is better, its distance
from 0 or 100 if nearer is better. So a quantile above 0.5 selects the bad cases, whether lower or higher is better.

A miss (`hapnet.ext.metrics.measured`) is the worst value. So is a case without a value if the same case has one with
other parameters, even in a single trial; otherwise the case is left out for this metric.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, get_args

from hapnet.errors import InvalidParameter
from hapnet.ext.metrics import METRICS
from hapnet.ext.metrics.measured import Better, quantile, value_of
from hapnet.ext.study.case import Measures, was_passive
from hapnet.ext.study.spec import known, number

PASSIVE = "passive"
"""The constraint that a case is passive and its coupling keeps its claim (`was_passive`)."""

Measured = Collection[tuple[str, int]]
"""(metric, place of the case) for which some trial has a value."""

_RELATIONS = MappingProxyType({"<=": operator.le, ">=": operator.ge, "<": operator.lt, ">": operator.gt})
_DIRECTIONS = get_args(Better)
_FORM = f"'{PASSIVE}', or a metric, {' '.join(_RELATIONS)}, a number and perhaps a share: 'free_rms_mm <= 3 in 90 %'"


@dataclass(frozen=True)
class Term:
    """A part of the objective: `weight` times a quantile of a metric's cost over the cases."""

    metric: str
    weight: float = 1.0
    quantile: float = 0.5
    better: Better = "lower"

    def value(self, cases: Sequence[Measures], measured: Measured) -> float:
        """This part without its weight; infinite if too many cases have no value; 0 if the metric applies to none."""
        values = [value_of(measures, self.metric) for measures in _about(self.metric, cases, measured)]
        costs = [math.inf if value is None or math.isinf(value) else self._cost(value) for value in values]
        return quantile(costs, self.quantile) if costs else 0.0

    def _cost(self, value: float) -> float:
        if self.better == "higher":
            return -value
        if self.better == "lower":
            return value
        return abs(value - float(self.better.removeprefix("nearer ")))

    def __str__(self) -> str:
        of = "median" if self.quantile == 0.5 else f"{self.quantile:g} quantile"
        direction = "" if self.better == METRICS[self.metric].better else f", {self.better} is better"
        return f"{self.weight:g} x {of} of {self.metric}{direction}"


@dataclass(frozen=True)
class Constraint:
    """A condition on each case, in all cases or in a `share` of them. `metric` is `PASSIVE`, or a metric's name."""

    metric: str
    relation: str = ">="
    bound: float = 0.0
    share: float = 1.0

    def holds(self, measures: Measures) -> bool:
        """Whether the constraint holds in a case; False without a value."""
        if self.metric == PASSIVE:
            return was_passive(measures)
        value = value_of(measures, self.metric)
        return value is not None and math.isfinite(value) and bool(_RELATIONS[self.relation](value, self.bound))

    def judge(self, cases: Sequence[Measures], measured: Measured) -> Held:
        """Judge the constraint over the cases to which its metric applies."""
        about = cases if self.metric == PASSIVE else _about(self.metric, cases, measured)
        excesses = sorted(0.0 if self.holds(measures) else self._excess(measures) for measures in about)
        kept = excesses.count(0.0)
        needed = math.ceil(self.share * len(about) - 1e-9)
        return Held(kept, len(about), kept >= needed, excesses[needed - 1] if needed else 0.0)

    def _excess(self, measures: Measures) -> float:
        """The amount by which a case breaks it, for the search: above 0, as a share of the bound."""
        if self.metric == PASSIVE:
            return 1.0 + max(0.0, -(measures.get("margin_J") or 0.0))
        value = measures.get(self.metric)
        if value is None:
            return _WORST
        return min(_WORST, max(1e-9, abs(value - self.bound) / (abs(self.bound) or 1.0)))

    def __str__(self) -> str:
        share = "" if self.share == 1.0 else f" in {100.0 * self.share:g} %"
        return (
            f"{self.metric}{share}"
            if self.metric == PASSIVE
            else f"{self.metric} {self.relation} {self.bound:g}{share}"
        )


_WORST = 1e6  # an excess


@dataclass(frozen=True)
class Held:
    """A constraint over several cases: it holds in `kept` of the `cases` to which its metric applies.

    excess : the distance from being met; 0: it is met.
    """

    kept: int
    cases: int
    met: bool
    excess: float


@dataclass(frozen=True)
class Worth:
    """The worth of a set of values. `objective`: infinite if cases failed. `terms`: without their weights."""

    objective: float
    terms: tuple[float, ...]
    held: tuple[Held, ...]
    failed: int

    @property
    def allowed(self) -> bool:
        """Whether these values may be chosen."""
        return math.isfinite(self.objective) and all(one.met for one in self.held)

    @property
    def excess(self) -> float:
        """The distance of the values from being allowed; 0: they are allowed."""
        return self.failed * _WORST + sum(one.excess for one in self.held if not one.met)


@dataclass(frozen=True)
class Goal:
    """The objective, a sum of its `terms`, and the `constraints`."""

    terms: tuple[Term, ...]
    constraints: tuple[Constraint, ...]

    def judge(self, cases: Sequence[Measures], measured: Measured, failed: int = 0) -> Worth:
        """Return the worth of values with these measures; `failed` : the number of cases without measures."""
        terms = tuple(term.value(cases, measured) for term in self.terms)
        total = math.inf if failed else sum(term.weight * x for term, x in zip(self.terms, terms, strict=True))
        return Worth(total, terms, tuple(one.judge(cases, measured) for one in self.constraints), failed)

    @property
    def metrics(self) -> list[str]:
        """The metrics in the objective and the constraints, in order."""
        named = [one.metric for one in self.terms] + [one.metric for one in self.constraints]
        return [name for name in dict.fromkeys(named) if name != PASSIVE]


def goal_of(objective: object, constraints: object) -> Goal:
    """The goal from the entries of a spec. Raises InvalidParameter."""
    if isinstance(objective, str):
        objective = {objective: 1.0}
    if not isinstance(objective, Mapping) or not objective:
        raise InvalidParameter("objective", objective, "a metric, or a table of metrics and their weights")
    if not isinstance(constraints, list) or not all(isinstance(words, str) for words in constraints):
        raise InvalidParameter("constraints", constraints, f"a list of {_FORM}")
    return Goal(tuple(_term(*item) for item in objective.items()), tuple(map(_constraint, constraints)))


def _about(metric: str, cases: Sequence[Measures], measured: Measured) -> list[Measures]:
    """The cases in which the metric has a value, here or in another trial."""
    return [m for i, m in enumerate(cases) if value_of(m, metric) is not None or (metric, i) in measured]


def _term(metric: str, given: Any) -> Term:
    _metric("objective", metric)
    table = given if isinstance(given, Mapping) else {"weight": given}
    for word in table:
        known(f"objective.{metric}", word, ("weight", "quantile", "better"), "weight, quantile and better")
    weight, share = table.get("weight", 1.0), table.get("quantile", 0.5)
    better = table.get("better", METRICS[metric].better)
    if not number(weight) or weight <= 0.0:
        raise InvalidParameter(f"weight of {metric}", weight, "a number above 0; `better` is lower or higher")
    if not number(share) or not 0.0 <= share <= 1.0:
        raise InvalidParameter(f"quantile of {metric}", share, "0 to 1; 0.5 is the median")
    if better not in _DIRECTIONS:
        raise InvalidParameter(f"better of {metric}", better, "one of " + ", ".join(_DIRECTIONS), _DIRECTIONS)
    return Term(metric, float(weight), float(share), better)


def _constraint(text: str) -> Constraint:
    found = re.fullmatch(r"\s*(\w+)\s*(?:(<=|>=|<|>)\s*(\S+?))?\s*(?:\bin\s+(\S+?)\s*%)?\s*", text)
    metric, relation, bound, share = found.groups() if found is not None else ("", None, None, None)
    limit, part = _float(bound, 0.0), _float(share, 100.0) / 100.0
    if not metric or (relation is None) != (metric == PASSIVE) or not math.isfinite(limit) or not 0.0 < part <= 1.0:
        raise InvalidParameter("constraints", text, _FORM)
    if metric != PASSIVE:
        _metric("constraints", metric)
    return Constraint(metric, relation or ">=", limit, part)


def _float(text: str | None, absent: float) -> float:
    try:
        return absent if text is None else float(text)
    except ValueError:
        return math.nan


def _metric(what: str, name: str) -> None:
    known(what, name, METRICS, "a metric of `hapnet compare --metrics`")
