"""The effective delay and error, of signals whose delay and error are known, and of a run over a constant delay."""

import math

import numpy as np
import pytest

from hapnet.ext.metrics.effective import effective_offset
from hapnet.ext.study.case import measure
from hapnet.params import Params
from tests.conftest import mostly_slow

TIMES = np.arange(0.0, 20.0, 1e-3)


def moved(times: np.ndarray) -> np.ndarray:
    return np.column_stack([0.03 * np.sin(2.0 * np.pi * 0.7 * times), 0.02 * np.cos(2.0 * np.pi * 1.1 * times)])


@pytest.mark.parametrize("delay_s", mostly_slow([-0.1, 0.0, 0.05, 0.316, 1.1], 3))
def test_a_pure_delay_is_found_and_is_no_error(delay_s: float) -> None:
    found = effective_offset(TIMES, moved(TIMES), np.ones(len(TIMES), bool), TIMES, moved(TIMES - delay_s))
    assert found is not None
    assert found[0] == pytest.approx(delay_s, abs=5e-4)
    assert found[1] < 5e-5


def test_an_error_is_no_delay() -> None:
    """A gain of 0.9 leaves a tenth of the signal: its root mean square is known from its amplitudes."""
    found = effective_offset(TIMES, moved(TIMES), np.ones(len(TIMES), bool), TIMES, 0.9 * moved(TIMES - 0.08))
    assert found is not None
    assert found[0] == pytest.approx(0.08, abs=5e-4)
    assert found[1] == pytest.approx(0.1 * math.sqrt((0.03**2 + 0.02**2) / 2.0), rel=0.01)


def test_only_samples_that_count() -> None:
    """Where it does not count the signal is far off; with none that counts there is no figure."""
    received = moved(TIMES - 0.05)
    received[(TIMES > 5.0) & (TIMES < 15.0)] += 1.0
    counts = (TIMES < 3.0) | (TIMES > 17.0)
    found = effective_offset(TIMES, moved(TIMES), counts, TIMES, received)
    assert found is not None
    assert found[0] == pytest.approx(0.05, abs=5e-4)
    assert effective_offset(TIMES, moved(TIMES), np.zeros(len(TIMES), bool), TIMES, received) is None


def test_a_constant_delay_of_the_link_adds_itself() -> None:
    """Without a prediction: 50 ms and 100 ms more than over an ideal link."""
    plain = Params().set(
        {
            "coupling": "zoh", "rendering": "paper", "operator": "sine", "scene": "free", "device.servo": "sampled",
            "device.pspm_period_s": 0.001, "world.step_min_s": 0.001, "world.step_max_s": 0.001, "duration_s": 8.0,
            "link.up": "", "link.down": "",
        }
    )  # fmt: skip
    delays = [
        measure(plain.set({"link.up": words, "link.down": words}), 0)["effective_delay_ms"]
        for words in ("", "delay 50ms", "delay 100ms")
    ]
    assert delays[0] is not None
    assert [delay - delays[0] for delay in delays[1:] if delay is not None] == pytest.approx([50.0, 100.0], abs=3.0)
