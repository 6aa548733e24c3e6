from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from hapnet.recording.durations import durations_s, evenly, is_even, mean, quantile, rms
from hapnet.recording.samples import Columns


def columns(times: list[float]) -> Columns:
    return {"time_s": np.array(times), "time_ns": np.round(1e9 * np.array(times)).astype(np.int64)}


def test_a_sample_stands_until_the_next_and_the_last_for_the_median() -> None:
    assert durations_s(columns([0.0, 0.001, 0.002, 22.0, 22.001])) == pytest.approx(
        [0.001, 0.001, 21.998, 0.001, 0.001]
    )
    assert durations_s(columns([3.0])) == pytest.approx([1.0])
    assert len(durations_s(columns([]))) == 0


def test_a_pause_is_no_time() -> None:
    found = durations_s(columns([0.0, 0.1, 60.1, 60.2]), [(100_000_000, 60_000_000_000)])
    assert found == pytest.approx([0.1, 0.1, 0.1, 0.1])


def test_means_are_over_time() -> None:
    """1 for 3 s, 5 for 1 s."""
    values, lasting = np.array([1.0, 5.0]), np.array([3.0, 1.0])
    assert mean(values, lasting) == pytest.approx(2.0)
    assert rms(values, lasting) == pytest.approx(np.sqrt(28.0 / 4.0))
    assert mean(values, np.zeros(2)) is None
    assert rms(values, np.zeros(2)) is None
    assert quantile(values, np.zeros(2), 0.5) is None


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=50), st.floats(0.0, 1.0))
def test_a_quantile_of_even_samples_is_numpys(values: list[float], share: float) -> None:
    found = quantile(np.array(values), np.full(len(values), 0.001), share)
    assert found == pytest.approx(float(np.quantile(values, share)), abs=1e-6)


@given(st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(1, 9)), min_size=1, max_size=20), st.floats(0.0, 1.0))
@pytest.mark.long
def test_a_sample_that_stands_for_three_steps_weighs_as_three(rows: list[tuple[float, int]], share: float) -> None:
    values, counts = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
    lasting = counts / 1000.0
    assert mean(values, lasting) == pytest.approx(float(np.mean(np.repeat(values, counts))))
    found, repeated = quantile(values, lasting, share), np.sort(np.repeat(values, counts))
    assert repeated[0] - 1e-12 <= found <= repeated[-1] + 1e-12


def test_an_even_recording_stays_as_it_is_and_another_is_read_on_a_grid() -> None:
    even = columns([0.0, 0.1, 0.2])
    assert evenly(even, ("position_m",)) is even
    assert is_even(np.array([0.0, 0.1, 0.2 + 1e-9]))
    uneven = columns([0.0, 0.1, 0.2, 0.5]) | {
        "position_m": np.array([[0.0], [1.0], [2.0], [5.0]]), "force_N": np.array([[0.0], [1.0], [2.0], [5.0]])
    }  # fmt: skip
    found = evenly(uneven, ("position_m", "force_N"))
    assert found["time_s"] == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.5], abs=1e-12)
    assert found["position_m"][:, 0] == pytest.approx([0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
    assert found["force_N"][:5, 0] == pytest.approx([0.0, 1.0, 2.0, 2.0, 2.0])
