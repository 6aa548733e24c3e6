"""The spread of a metric over cases. The hand is the unit, as hands differ, while seeds of the same hand hardly do."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import inf, isfinite
from statistics import fmean

import numpy as np

from hapnet.ext.metrics import METRICS, Measures
from hapnet.ext.metrics.measured import quantile, value_of

SEED = 2009
"""The seed of the generator that resamples hands, so that the same cases have the same intervals."""

_SHARE, _DRAWS = 0.95, 1000
_MIN_HANDS = 3


@dataclass(frozen=True)
class Spread:
    """A metric over several cases.

    count : number of cases with a value. missed : number of cases that missed it, such as a contact that was not felt.
    least, most : of the values. median, q1, q3 : of the hands, each with the mean of its cases; of the cases if there
    is only one hand. A miss is infinite. low, high : 95 % confidence interval of the median, by resampling hands
    (Efron's percentile bootstrap); None with fewer than three hands.
    """

    count: int
    median: float
    q1: float
    q3: float
    least: float
    most: float
    missed: int = 0
    low: float | None = None
    high: float | None = None


def spreads(hands: Sequence[Sequence[Measures]], seed: int = SEED) -> Iterator[tuple[str, Spread]]:
    """Each metric for which at least one case has a value, and its spread.

    hands : the cases of each hand. seed : of the generator that resamples the hands, in the same way for each metric.
    """
    for metric in METRICS:
        each = [[value for one in cases if (value := value_of(one, metric)) is not None] for cases in hands]
        known = [values for values in each if values]
        values = [value for some in known for value in some]
        if not values:
            continue
        units = [fmean(some) for some in known] if len(hands) > 1 else values
        q1, median, q3 = (quantile(units, share) for share in (0.25, 0.5, 0.75))
        finite = [value for value in values if isfinite(value)] or [inf]
        missed = sum(not isfinite(value) for value in values)
        low, high = None, None
        if len(hands) > 1 and len(units) >= _MIN_HANDS:
            low, high = median_interval(units, np.random.default_rng(seed))
        yield (metric, Spread(len(values) - missed, median, q1, q3, min(finite), max(finite), missed, low, high))


def median_interval(values: Sequence[float], rng: np.random.Generator) -> tuple[float, float]:
    """The 95 % confidence interval of the median: percentiles of the medians of 1000 resamples of `values`."""
    ordered = np.array(values)
    medians = np.sort(np.median(ordered[rng.integers(len(ordered), size=(_DRAWS, len(ordered)))], axis=1))
    tail = round(0.5 * (1.0 - _SHARE) * _DRAWS)
    return float(medians[tail]), float(medians[-1 - tail])
