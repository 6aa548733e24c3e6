"""Couplings against each other: the same links, hands and seeds for each, and what they showed over all of these."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from hapnet.metrics import METRICS
from hapnet.params import RELAXED_HAND, Params
from hapnet.simulation.processes import Progress, in_processes, usable_cores
from hapnet.study.case import Measures, measure
from hapnet.summary.verdict import ROUNDING_J

LIGHT = "@light"
"""After an operator's name: with a relaxed hand. A firm one damps what a bad coupling does."""


class Variant(NamedTuple):
    """What is compared: a coupling, with the Weber fraction below which a change of position is not sent."""

    coupling: str
    deadband: float = 0.0

    def __str__(self) -> str:
        return f"{self.coupling}, deadband {100.0 * self.deadband:g} %" if self.deadband else self.coupling


@dataclass(frozen=True)
class Case:
    """One run: a variant over a link, under an operator and a seed."""

    variant: Variant
    link: str
    operator: str
    seed: int
    params: Params

    def __str__(self) -> str:
        return f"{self.variant} over {self.link}, {self.operator}, seed {self.seed}"


@dataclass(frozen=True)
class Outcome:
    """What a case showed, or in one line why it failed."""

    case: Case
    measures: Measures | None
    error: str | None = None


@dataclass(frozen=True)
class Plan:
    """What to compare.

    Parameters
    ----------
    params : of all cases, but for what follows.
    links : names, each with the words of the uplink and of the downlink.
    operators : as `Params.operator`, followed by `LIGHT` for a relaxed hand.
    deadbands : each coupling is tried with each. extra : variants of these couplings beside those.
    """

    params: Params
    couplings: tuple[str, ...]
    links: Mapping[str, tuple[str, str]]
    operators: tuple[str, ...]
    seeds: tuple[int, ...]
    deadbands: tuple[float, ...] = (0.0,)
    extra: tuple[Variant, ...] = ()

    @property
    def variants(self) -> list[Variant]:
        """In the order of the couplings; what is extra beside its own."""
        every = [Variant(coupling, deadband) for coupling in self.couplings for deadband in self.deadbands]
        return sorted({*every, *self.extra}, key=lambda one: (self.couplings.index(one.coupling), one.deadband))

    def cases(self) -> list[Case]:
        """Every case; those that differ in their link only stand together, as they share a run over an ideal link."""
        alike = [[one for one in self.variants if one.coupling == coupling] for coupling in self.couplings]
        return [
            self.case(variant, link, operator, seed)
            for variants, operator, seed in product(alike, self.operators, self.seeds)
            for variant, link in product(variants, self.links)
        ]

    def case(self, variant: Variant, link: str, operator: str, seed: int) -> Case:
        """One of them. Raises InvalidParameter if its parameters do not go together."""
        name = operator.removesuffix(LIGHT)
        up, down = self.links[link]
        changes: dict[str, object] = {} if name == operator else dict(RELAXED_HAND)
        changes |= {"coupling": variant.coupling, "operator": name, "link.up": up, "link.down": down}
        changes["wire.deadband"] = variant.deadband
        return Case(variant, link, operator, seed, self.params.set(changes))


def run(cases: Sequence[Case], workers: int = 0, progress: Progress | None = None) -> list[Outcome]:
    """What the cases show, in their order: the same whatever the number of `workers` (0: one a core).

    `progress` is told the share that is done, 0 to 1. With more than one worker the caller's main module must be
    importable.
    """
    workers = min(workers or usable_cores(), len(cases))
    if workers <= 1:
        return _measured(cases, progress or (lambda share: None))
    shares = _shares(cases, workers)
    parts = in_processes(_measured, [[cases[k] for k in share] for share in shares], progress)
    found = {k: one for share, part in zip(shares, parts, strict=True) for k, one in zip(share, part, strict=True)}
    return [found[k] for k in range(len(cases))]


def _shares(cases: Sequence[Case], workers: int) -> list[list[int]]:
    """Which cases each worker gets: what differs only in its link stays together."""
    together: dict[tuple[str, str, int], list[int]] = {}
    for k, case in enumerate(cases):
        together.setdefault((case.variant.coupling, case.operator, case.seed), []).append(k)
    groups = list(together.values())
    workers = min(workers, len(groups))
    return [[k for group in groups[worker::workers] for k in group] for worker in range(workers)]


def _measured(cases: Sequence[Case], progress: Progress) -> list[Outcome]:
    done = []
    for case in cases:
        done.append(outcome(case))
        progress(len(done) / len(cases))
    return done


def outcome(case: Case) -> Outcome:
    """Measure; whatever goes wrong in one case is told in its place."""
    try:
        return Outcome(case, measure(case.params, case.seed))
    except Exception as error:
        return Outcome(case, None, " ".join(f"{error}".split()) or type(error).__name__)


@dataclass(frozen=True)
class Spread:
    """A metric over several cases: how many knew it, and the median, quartiles (linear) and extremes of these."""

    count: int
    median: float
    q1: float
    q3: float
    least: float
    most: float


@dataclass(frozen=True)
class Group:
    """The cases of a variant over a link, of one operator or of all (None).

    `spreads` has the metrics that at least one case knew. `passive` and `hand_passive`: in how many cases the two-port
    margin and the hand's were not negative.
    """

    variant: Variant
    link: str
    operator: str | None
    cases: int
    failed: int
    passive: int
    hand_passive: int
    spreads: Mapping[str, Spread]

    @property
    def measured(self) -> int:
        return self.cases - self.failed

    def median(self, metric: str) -> float | None:
        spread = self.spreads.get(metric)
        return None if spread is None else spread.median


def groups(plan: Plan, outcomes: Sequence[Outcome]) -> list[Group]:
    """By link and variant: over all operators first and then, if there are several, for each."""
    each: tuple[str | None, ...] = plan.operators if len(plan.operators) > 1 else ()
    return [
        _group(variant, link, operator, outcomes)
        for link, variant, operator in product(plan.links, plan.variants, (None, *each))
    ]


def _group(variant: Variant, link: str, operator: str | None, outcomes: Sequence[Outcome]) -> Group:
    ours = [
        one for one in outcomes
        if (one.case.variant, one.case.link) == (variant, link) and operator in (None, one.case.operator)
    ]  # fmt: skip
    known = [one.measures for one in ours if one.measures is not None]
    return Group(
        variant,
        link,
        operator,
        len(ours),
        len(ours) - len(known),
        _positive(known, "margin_J"),
        _positive(known, "hand_margin_J"),
        dict(_spreads(known)),
    )


def _positive(known: Sequence[Measures], margin: str) -> int:
    """How many are not negative, but for rounding."""
    return sum((value := measures[margin]) is not None and value >= -ROUNDING_J for measures in known)


def _spreads(known: Sequence[Measures]) -> Iterator[tuple[str, Spread]]:
    for metric in METRICS:
        values = [value for measures in known if (value := measures[metric]) is not None]
        if values:
            q1, median, q3 = np.percentile(values, (25.0, 50.0, 75.0)).tolist()
            yield metric, Spread(len(values), median, q1, q3, min(values), max(values))
