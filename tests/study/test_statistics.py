"""The hand as the unit: means of its cases, and the median's interval over hands against its exact distribution."""

import math
import statistics

import numpy as np
import pytest

from hapnet.ext.metrics import Measures
from hapnet.ext.study.statistics import median_interval, spreads


def hands(*values: tuple[float | None, ...]) -> list[list[Measures]]:
    return [[{"drag_N": value} for value in some] for some in values]


def exact(ordered: list[float], share: float) -> float:
    """The quantile of the median of a resample of an odd number of values.

    It is at most the k-th of n if more than half of the n draws, each so with probability k/n, are.
    """
    n = len(ordered)
    for k in range(1, n + 1):
        p = k / n
        below = sum(math.comb(n, j) * p**j * (1.0 - p) ** (n - j) for j in range((n + 1) // 2, n + 1))
        if below >= share:
            return ordered[k - 1]
    raise AssertionError


@pytest.mark.parametrize("n", [5, 9, 21])
def test_the_interval_is_that_of_the_exact_distribution_of_the_median(n: int) -> None:
    values = [float(k) ** 2 for k in range(n)]
    low, high = median_interval(values[::-1], np.random.default_rng(1))
    assert (low, high) == (exact(values, 0.025), exact(values, 0.975))


def test_seeds_are_averaged_and_the_hand_counts_once() -> None:
    """One hand with many seeds weighs as much as another with one; the extremes are those of the cases."""
    found = dict(spreads(hands((1.0, 3.0), (5.0,), (10.0, 20.0, None), (None,))))["drag_N"]
    assert (found.median, found.least, found.most, found.count) == (5.0, 1.0, 20.0, 5)
    assert (found.q1, found.q3) == tuple(statistics.quantiles([2.0, 5.0, 15.0], n=4, method="inclusive"))[::2]
    assert (found.low, found.high) == (2.0, 15.0)


def test_no_interval_with_fewer_than_three_hands_and_of_one_hand_the_seeds_are_all_there_is() -> None:
    two = dict(spreads(hands((1.0,), (5.0,))))["drag_N"]
    assert (two.median, two.low, two.high) == (3.0, None, None)
    one = dict(spreads(hands((1.0, 2.0, 9.0, 9.0))))["drag_N"]
    assert (one.median, one.low, one.high) == (5.5, None, None)


def test_the_same_cases_have_the_same_interval_and_a_miss_is_infinite() -> None:
    values = hands(*[(float(k),) for k in range(20)])
    assert dict(spreads(values)) == dict(spreads(values))
    missed: list[list[Measures]] = [[{"first_contact_ms": None, "first_contact_missed": 1.0}]] * 3
    found = dict(spreads(missed))["first_contact_ms"]
    assert (found.count, found.missed, found.median, found.low, found.high) == (0, 3, math.inf, math.inf, math.inf)
