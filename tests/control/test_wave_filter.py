"""The filter of waves: a low pass that gives no energy, whatever its slots."""

from math import exp

import numpy as np
import pytest

from hapnet.control.coupling import WaveSample
from hapnet.ext.laws.parts.wave_filter import WaveFilter
from hapnet.ext.laws.wave import DelayLine
from tests.support.wave_ports import Counted, put_in, shake


class Given:
    """A line of which the test says what it gives."""

    def __init__(self, *wave: float) -> None:
        self.wave = wave

    def push(self, wave: WaveSample) -> None:
        self.wave = wave.value

    def take(self, dt: float) -> tuple[float, ...]:
        return self.wave

    def clear(self) -> None:
        self.wave = (0.0,) * len(self.wave)


def test_energy_out_never_exceeds_energy_in_less_what_it_holds() -> None:
    rng = np.random.default_rng(1)
    tau = 0.005
    line = Given(0.0)
    filtered = WaveFilter(line, 1, tau)
    before = spare = 0.0
    for _ in range(5000):
        dt = float(rng.choice([0.0002, 0.001, 0.02]))
        line.wave = (float(rng.normal()),)
        (z,) = filtered.take(dt)
        gain = (line.wave[0] ** 2 - z**2) / 2.0 * dt - tau / 2.0 * (z**2 - before**2)
        assert gain >= -1e-15
        spare += gain
        before = z
    assert spare > 0.0


def test_it_is_a_low_pass_of_the_given_time_with_a_gain_of_one() -> None:
    line = Given(1.0, -2.0)
    filtered = WaveFilter(line, 2, 0.02)
    passed = np.array([filtered.take(1e-5) for _ in range(2000)])  # one time constant
    assert passed[-1] == pytest.approx(np.array([1.0, -2.0]) * (1.0 - exp(-1.0)), rel=1e-3)
    behind = 0.02 * (1.0 - exp(-1.0))  # tau z of displacement
    assert 0.02 - passed[:, 0].sum() * 1e-5 == pytest.approx(behind, rel=1e-3)
    for _ in range(50):
        last = filtered.take(0.02)
    assert last == pytest.approx((1.0, -2.0), rel=1e-9)


def test_without_a_time_constant_it_does_nothing_and_cleared_it_is_silent() -> None:
    filtered = WaveFilter(Given(3.0), 1, 0.0)
    assert filtered.take(0.001) == (3.0,)
    filtered = WaveFilter(Given(3.0), 1, 0.01)
    filtered.take(0.001)
    filtered.clear()
    assert filtered.take(0.001) == (0.0,)


def test_lines_and_ports_stay_passive_with_it() -> None:
    for seed in range(3):
        line = Counted(WaveFilter(DelayLine(1, 0.3), 1, 0.005))
        shake(line, seed, seconds=10.0, loss=0.2, jitter=0.2)
        assert line.spare >= -1e-9
        device = WaveFilter(DelayLine(1, 0.3), 1, 0.005)
        assert put_in(device, DelayLine(1, 0.3), seed, jitter=35, loss=0.1, seconds=3.0).lowest >= -1e-9
