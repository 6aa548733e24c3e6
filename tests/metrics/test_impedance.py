"""The transmitted impedance and the Z-width: estimators and experiment against theory."""

import cmath
import math
from collections.abc import Callable
from dataclasses import astuple

import numpy as np
import pytest

from hapnet.errors import InvalidParameter
from hapnet.ext.metrics.force import limit_cycles
from hapnet.ext.metrics.impedance import (
    THREE_DB,
    ImpedanceAtFrequency,
    harmonics_between,
    multisine,
    off_hz,
    transmitted,
)
from hapnet.ext.study.impedance import HARMONICS, PERIOD_S, Transmission, curve, transmission, true_impedance
from hapnet.ext.study.z_width import ZWidth, maximum, z_width
from hapnet.params import RELAXED_HAND, Params
from hapnet.plant.worlds.walls import Wall
from hapnet.recording.samples import DeviceSample, MemoryRecorder, Recording
from tests.support.paper import PAPER

STEP_S = 0.002
LINES = harmonics_between(0.5, 20.0, PERIOD_S, 12)


def answered(impedance: Callable[[float], complex], periods: int) -> tuple[np.ndarray, np.ndarray]:
    """A multisine, and the force of this impedance, computed line by line in the time domain."""
    t = np.arange(0.0, periods * PERIOD_S, STEP_S)
    x, force = np.full(len(t), 0.01), np.full(len(t), 1.3)
    for i, k in enumerate(LINES):
        f = k / PERIOD_S
        z, line = impedance(f), 1e-3 * np.exp(1j * (2.0 * math.pi * f * t + i))
        x += line.real
        force += (z * line).real
    return x, force


def test_a_spring_a_damper_and_a_delay_are_found_exactly() -> None:
    def delayed(f: float) -> complex:
        return 90.0 * cmath.exp(-2j * math.pi * f * 0.03) + 2j * math.pi * f * 1.5

    lines = transmitted(*answered(delayed, 2), STEP_S, PERIOD_S, LINES)
    assert [line.frequency_hz for line in lines] == [k / PERIOD_S for k in LINES]
    for line in lines:
        assert line.impedance == pytest.approx(delayed(line.frequency_hz), rel=1e-9)
        assert line.stiffness == pytest.approx(90.0 * math.cos(2.0 * math.pi * line.frequency_hz * 0.03), abs=1e-6)
        wanted = 1.5 - 90.0 * math.sin(2.0 * math.pi * line.frequency_hz * 0.03) / (2.0 * math.pi * line.frequency_hz)
        assert line.damping == pytest.approx(wanted, abs=1e-6)
        assert line.spread < 1e-8


def test_the_spread_is_that_of_the_noise() -> None:
    """White noise of s N in N samples has s sqrt(N) in each coefficient; a line of a m has a N/2."""
    x, force = answered(lambda f: 50.0, 40)
    noisy = force + 0.2 * np.random.default_rng(3).normal(size=len(force))
    lines = transmitted(x, noisy, STEP_S, PERIOD_S, LINES)
    per_period = 0.2 * math.sqrt(PERIOD_S / STEP_S) / (0.5e-3 * PERIOD_S / STEP_S)
    wanted = per_period / math.sqrt(40.0)
    assert np.mean([line.spread for line in lines]) == pytest.approx(wanted, rel=0.1)
    errors = [abs(line.impedance - 50.0) for line in lines]
    assert math.sqrt(np.mean(np.square(errors))) == pytest.approx(wanted, rel=0.4)
    (one, *_) = transmitted(x[:2000], noisy[:2000], STEP_S, PERIOD_S, LINES)
    assert one.spread == math.inf


def test_samples_must_make_a_period() -> None:
    with pytest.raises(ValueError, match="do not make a whole period"):
        transmitted(np.zeros(1999), np.zeros(1999), STEP_S, PERIOD_S, LINES)
    with pytest.raises(ValueError, match="do not make a whole period"):
        transmitted(np.zeros(9000), np.zeros(9000), 0.003, PERIOD_S, LINES)


def test_where_it_is_off_by_3_db() -> None:
    """In magnitude 3 dB too much; and a spring of the right magnitude that is late by 41 % of a radian or so."""
    assert 20.0 * math.log10(1.0 + THREE_DB) == pytest.approx(3.0)
    greater = [ImpedanceAtFrequency(f, 100.0 * (1.0 + 0.04 * f), 0.0) for f in (0.5, 5.0, 10.0, 10.4, 20.0)]
    assert off_hz(greater, lambda f: 100.0) == 10.4  # 41.25 % above 41.6 % of 10.4 Hz x 4 %
    late = [ImpedanceAtFrequency(f, 100.0 * cmath.exp(-0.1j * f), 0.0) for f in (1.0, 4.0, 4.2, 9.0)]
    assert off_hz(late, lambda f: 100.0) == 4.2  # 2 sin(0.21) = 0.417
    assert off_hz(late[:2], lambda f: 100.0) is None


def test_a_multisine_has_its_lines_and_its_peak() -> None:
    signal = multisine(LINES, PERIOD_S, 0.002)
    samples = np.array([signal(t) for t in np.arange(0.0, PERIOD_S, STEP_S).tolist()])
    spectrum = np.abs(np.fft.rfft(samples)) / len(samples)
    assert np.abs(samples).max() == pytest.approx(0.002, rel=0.02)
    assert np.ptp(spectrum[list(LINES)]) < 1e-12
    assert np.delete(spectrum, list(LINES)).max() < 1e-12
    crest = np.abs(samples).max() / np.sqrt(np.mean(samples**2))
    assert crest < 3.0  # in phase it would be sqrt(2 x 12) = 4.9
    assert (LINES[0], LINES[-1]) == (2, 80)
    assert (HARMONICS[0] / PERIOD_S, HARMONICS[-1] / PERIOD_S) == (0.5, 20.0)


def test_the_true_impedance_is_the_series_of_springs_and_the_walls_damper() -> None:
    wall = Wall((1.0,), 0.02, 3000.0, 10.0)
    params = PAPER.set({"device.stiffness": 100.0})
    omega = 2.0 * math.pi * 8.0
    for name, far in (("pspm", 500.0), ("wave", 100.0)):
        # The proxy without mass: K'(x - y) = (K_w + j w B_w) y, and K (x - y) is felt.
        y = far / (far + 3000.0 + 10.0j * omega)
        assert true_impedance(params.set({"coupling": name}), wall, 8.0) == pytest.approx(100.0 * (1.0 - y))
    with pytest.raises(InvalidParameter, match=r"world\.stiffness"):
        true_impedance(params.set({"world.stiffness": ((500.0,),)}), wall, 8.0)


FAST: dict[str, object] = {
    "world.step_min_s": 0.002, "world.step_max_s": 0.002, "device.pspm_period_s": 0.001, "device.step_limit_N": 0.0,
    "world.step_limit_N": 0.0,
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("delay_ms", [20, 0])
def test_a_held_spring_over_a_delay_transmits_what_theory_says(delay_ms: int) -> None:
    """K (1 - H exp(-j w t)) + j w B, with the proxy's H = K'/(K' + K_w + j w (B' + B_w) - M w^2) and t the delay.

    Beside the link's two delays t has half a step of the world twice, as it holds what came and is then held: 2 ms, and
    up to half a tick more or less by the order of the events in a tick.
    """
    link = f"delay {delay_ms}ms" if delay_ms else ""
    params = PAPER.set({**FAST, "coupling": "zoh", "link.up": link, "link.down": link, "world.damping": 3.0})
    found = transmission(params, 1, periods=1)
    for line in found.lines:
        s = 2j * math.pi * line.frequency_hz
        H = 500.0 / (500.0 + 3000.0 + s * (3.0 + 10.0) + 0.02 * s * s)
        theory = 100.0 * (1.0 - H * cmath.exp(-s * (2e-3 * delay_ms + 0.002))) + 0.1 * s
        assert line.impedance == pytest.approx(theory, rel=0.015)
    assert found.off_3dB_hz is None
    assert found.truth[0].real == pytest.approx(100.0 * 3000.0 / 3500.0, rel=1e-3)


@pytest.mark.parametrize("stiffness", [200.0, 600.0, 2000.0])
def test_a_stiff_spring_is_measured_below_the_largest_force_of_the_motors(stiffness: float) -> None:
    """10 mm deep a spring of 600 N/m would saturate, and the force would not change at all."""
    found = transmission(Params().set({"link.up": "lan", "link.down": "lan", "device.stiffness": stiffness}), 0, 1)
    series = 1.0 / (1.0 / stiffness + 500.0 / (stiffness * 3000.0))
    assert found.truth[0].real == pytest.approx(series, rel=1e-3)
    for line in found.lines[:3]:
        assert line.stiffness == pytest.approx(series, rel=0.06)


def test_what_cannot_be_measured_is_refused() -> None:
    with pytest.raises(InvalidParameter, match="one with a wall at rest"):
        transmission(PAPER.set({"scene": "free"}), 1)


def test_medians_and_quartiles_over_runs() -> None:
    """A run that is nowhere off counts as infinite."""
    runs = [
        Transmission((ImpedanceAtFrequency(1.0, complex(k, 2.0 * math.pi * k), 0.0),), (100.0 + 0j,), off)
        for k, off in ((10.0, None), (20.0, 3.0), (30.0, 2.0))
    ]
    found = curve(runs)
    assert found.frequency_hz == (1.0,)
    for figures, scale in ((found.stiffness, 1.0), (found.damping, 1.0), (found.magnitude, math.hypot(1.0, math.tau))):
        assert astuple(figures[0]) == pytest.approx((20.0 * scale, 15.0 * scale, 25.0 * scale))
    assert astuple(found.off_3dB_hz) == (3.0, 2.5, math.inf)


# -- Z-width ---------------------------------------------------------------------------------------------------------


def held(force: Callable[[float], float], stop_s: float = 0.5, seconds: float = 4.0) -> Recording:
    recorder = MemoryRecorder({"origin_ns": 0, "device_origin_ns": 0})
    for k in range(round(seconds / STEP_S)):
        t = k * STEP_S
        unknown = (math.nan,) * 7
        recorder.write(
            DeviceSample(round(t * 1e9), (0.0,), (0.0,), (0.0,), (force(t),), None, *unknown, (min(t, stop_s),))
        )
    return recorder.recording()


def test_a_limit_cycle_is_a_swing_that_goes_on() -> None:
    """Not one that has halved within a second, not one below 0.02 N; a drift of the mean is none of its own."""

    def swing(amplitude: float, half_life_s: float) -> Callable[[float], float]:
        return lambda t: 1.0 + amplitude * 0.5 ** (t / half_life_s) * math.sin(2.0 * math.pi * 6.0 * t)

    assert limit_cycles(held(swing(0.5, 1e9))) is True
    assert limit_cycles(held(swing(5.0, 0.8))) is False
    assert limit_cycles(held(swing(0.5, 1.5))) is True
    assert limit_cycles(held(swing(0.027, 1e9))) is False  # 0.019 N
    assert limit_cycles(held(swing(0.030, 1e9))) is True
    assert limit_cycles(held(swing(0.5, 1e9), seconds=3.4)) is None


def test_bisection_ends_where_the_cycles_begin() -> None:
    tried: list[float] = []

    def free(stiffness: float) -> bool:
        tried.append(stiffness)
        return stiffness <= 1234.0

    low, high = maximum(free, 10.0, 1e5, 1.02)
    assert low <= 1234.0 < high <= 1.02 * low
    assert len(tried) == 2 + math.ceil(math.log2(math.log(1e4) / math.log(1.02)))
    assert maximum(lambda k: True, 10.0, 1e5, 1.02) == ZWidth(1e5, None)
    assert maximum(lambda k: False, 10.0, 1e5, 1.02) == ZWidth(None, 10.0)
    for wrong in ((0.0, 1.0, 1.1), (2.0, 1.0, 1.1), (1.0, 2.0, 1.0)):
        with pytest.raises(InvalidParameter):
            maximum(free, *wrong)


@pytest.mark.slow
def test_a_held_spring_swings_from_a_stiffness_on_that_falls_with_the_delay() -> None:
    """A delayed spring is a damper of less than nothing, about K t: the longer the delay, the softer it must be."""
    widths = []
    for delay in ("5ms", "20ms"):
        link = {"link.up": f"delay {delay}", "link.down": f"delay {delay}"}
        found = z_width(PAPER.set({**RELAXED_HAND, **link, "coupling": "zoh"}), (1,), ratio=1.2)
        assert found.free < found.cycles <= 1.2 * found.free * 1.0001
        widths.append(found.free)
    assert widths[0] > 1.5 * widths[1]
