"""The delay histogram: percentiles within a bin's width, memory that does not grow."""

import dataclasses
import statistics

import numpy as np
import pytest
from hypothesis import given, strategies as st

from netem.stats import Counters, DelayHistogram


def histogram_of(delays_ns: list[int]) -> DelayHistogram:
    histogram = DelayHistogram()
    for delay in delays_ns:
        histogram.pending.append(delay)
        if len(histogram.pending) >= DelayHistogram.PENDING:
            histogram.fold()
    return histogram


@given(st.lists(st.integers(2000, 10**12), min_size=1, max_size=600), st.sampled_from([0.0, 0.5, 0.99, 1.0]))
@pytest.mark.long
def test_quantiles_are_those_of_the_sample_within_a_bin(delays_ns: list[int], fraction: float) -> None:
    exact = float(np.quantile(delays_ns, fraction, method="inverted_cdf")) * 1e-6
    assert histogram_of(delays_ns).quantile_ms(fraction) == pytest.approx(exact, rel=0.011)


@given(st.lists(st.integers(0, 10**12), min_size=1, max_size=600))
@pytest.mark.long
def test_mean_and_deviation_are_exact(delays_ns: list[int]) -> None:
    histogram = histogram_of(delays_ns)
    assert histogram.mean_ms() == pytest.approx(np.mean(delays_ns) * 1e-6, rel=1e-12)
    assert histogram.std_ms() == pytest.approx(statistics.pstdev(delays_ns) * 1e-6, rel=1e-12, abs=1e-300)


def test_a_deviation_far_below_the_mean_does_not_cancel() -> None:
    assert histogram_of([10**14, 10**14 + 2] * 1000).std_ms() == pytest.approx(1e-6, rel=1e-12)


def test_a_constant_delay_is_exact() -> None:
    histogram = histogram_of([40_000_000] * 1000)
    assert (
        histogram.quantile_ms(0.5)
        == histogram.quantile_ms(0.99)
        == histogram.mean_ms()
        == pytest.approx(40.0, rel=1e-12)
    )


@given(st.lists(st.integers(2000, 10**12), min_size=1, max_size=600), st.integers(8, 60))
def test_bins_hold_every_delay_between_their_edges(delays_ns: list[int], most: int) -> None:
    bins = histogram_of(delays_ns).bins_ms(most)
    edges, counts = zip(*bins, strict=True)
    assert list(edges) == sorted(set(edges))
    assert counts[0] == 0
    assert sum(count > 0 for count in counts) <= most
    delays_ms = np.array(delays_ns) * 1e-6
    for edge, seen in zip(edges, np.cumsum(counts), strict=True):  # rounding may put one that is on the edge beside it
        assert np.sum(delays_ms < edge * (1 - 1e-9)) <= seen <= np.sum(delays_ms < edge * (1 + 1e-9))


def test_a_gap_between_bins_is_told() -> None:
    bins = histogram_of([10_000_000] * 3 + [80_000_000] * 2).bins_ms()
    assert [count for _, count in bins] == [0, 3, 0, 2]
    (a, b, c, d) = (edge for edge, _ in bins)
    assert a <= 10.0 < b
    assert c <= 80.0 < d
    assert b / a == pytest.approx(2 ** (1 / 64), rel=1e-12)
    assert d / c == pytest.approx(2 ** (1 / 64), rel=1e-12)


def test_few_delays_make_few_bins() -> None:
    """A hundred values spread over an octave: at most ten bins, the square root."""
    bins = histogram_of([int(1e7 * 2 ** (i / 100)) for i in range(100)]).bins_ms()
    assert sum(count > 0 for _, count in bins) <= 10
    assert sum(count for _, count in bins) == 100


def test_what_passes_at_once_is_in_a_bin_that_begins_at_0() -> None:
    ((low, _), (high, count)) = histogram_of([0] * 7).bins_ms()
    assert (low, count) == (0.0, 7)
    assert 0.0 < high <= 1.02e-3


def test_nothing_counted_is_none() -> None:
    assert DelayHistogram().bins_ms() == ()
    assert DelayHistogram().quantile_ms(0.5) is None
    assert DelayHistogram().mean_ms() is None
    assert DelayHistogram().std_ms() is None


def test_extremes_stay_in_range() -> None:
    histogram = histogram_of([0, 0, 10**17])
    assert histogram.quantile_ms(0.5) == pytest.approx(0.0, abs=1.01e-3)
    assert histogram.quantile_ms(1.0) is not None


def test_a_links_figures_have_the_names_of_its_fields() -> None:
    stats = Counters().snapshot("delay 1ms", 0)
    assert stats.as_dict() == dataclasses.asdict(stats) | {"delay_histogram_ms": []}
