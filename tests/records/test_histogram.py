"""A histogram of fixed size: its quantiles are those of the values to one part in 32."""

import math

import pytest
from hypothesis import given, strategies as st

from hapnet.records.histogram import Histogram


@given(values=st.lists(st.integers(0, 2**41), min_size=1), q=st.floats(0.0, 1.0))
@pytest.mark.long
def test_quantile_is_the_nearest_rank_to_one_part_in_32(values: list[int], q: float) -> None:
    histogram = Histogram()
    for value in values:
        histogram.add(value)
    rank = max(1, math.ceil(q * len(values)))
    exact = sorted(values)[rank - 1]
    found = histogram.quantile(q)
    assert exact <= found <= exact + exact / 32
    assert found <= histogram.max == max(values)
    assert histogram.total == len(values)


@given(minimum=st.integers(0, 10**9), width=st.integers(0, 10**9), q=st.floats(0.0, 1.0))
def test_interpolated_a_quantile_of_values_spread_evenly_is_theirs(minimum: int, width: int, q: float) -> None:
    """A hundredth of a bin at most is left, where a whole one is with the edges; a constant is exact."""
    histogram = Histogram()
    for k in range(1001):
        histogram.add(minimum + width * k // 1000)
    exact = minimum + width * q
    found = histogram.interpolated(q, minimum)
    assert abs(found - exact) <= 2 + width / 500 + exact / 3200
    assert Histogram().interpolated(q, minimum) is None


def test_bins_hold_every_value_no_lower_than_it_was_and_a_32nd_higher_at_most() -> None:
    values = sorted([0, 3, 3, 63, 64, 1000, 999_999, 1_000_000, 2**41 + 12345, 2**45])
    histogram = Histogram()
    for value in values:
        histogram.add(value)
    edges = [edge for edge, count in histogram.bins() for _ in range(count)]
    assert len(edges) == len(values)
    assert all(value <= edge <= value * 33 / 32 for value, edge in zip(values, edges, strict=True))
    assert Histogram().bins() == ()


def test_histogram_does_not_grow_and_takes_any_integer() -> None:
    histogram = Histogram()
    assert histogram.quantile(0.5) is None
    size = len(histogram.counts)
    for value in (-5, 0, 2**42 - 1, 2**42, 2**80):
        histogram.add(value)
    assert len(histogram.counts) == size
    assert histogram.total == 5
    assert histogram.quantile(0.2) == 0
    assert histogram.quantile(1.0) == histogram.max == 2**80


@given(st.integers(0, 2**43), st.integers(1, 10**9), st.integers(1, 300))
def test_values_in_equal_steps_count_as_one_by_one(lowest: int, step: int, count: int) -> None:
    one_by_one, together = Histogram(), Histogram()
    for k in range(count):
        one_by_one.add(lowest + k * step)
    together.add_steps(lowest + (count - 1) * step, step, count)
    assert (together.counts, together.max) == (one_by_one.counts, one_by_one.max)
