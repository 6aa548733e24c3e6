"""D of (9): (10) is a lower bound for a continuous damper and none for a held one; the measured harvest is exact."""

import numpy as np
import pytest

from hapnet.control.harvest import MeasuredHarvest, damping_conditions, dissipated_by_range


def test_range_is_a_lower_bound_of_what_a_continuous_damper_dissipates() -> None:
    """Against the integral of b v^2, on random smooth motions."""
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 0.005, 20001)
    for _ in range(200):
        v = sum(rng.normal() * np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) for f in (10.0, 200.0, 700.0))
        x = np.concatenate([[0.0], np.cumsum((v[1:] + v[:-1]) / 2.0 * np.diff(t))])
        exact = float(np.trapezoid(0.1 * v**2, t))
        assert dissipated_by_range((0.1,), (x.min(),), (x.max(),), 0.005) <= exact * (1.0 + 1e-6)


def test_range_by_hand() -> None:
    assert dissipated_by_range((0.5, 2.0), (0.0, -0.001), (0.002, 0.001), 0.01) == pytest.approx(
        (0.5 * 4e-6 + 2.0 * 4e-6) / 0.01
    )


def test_an_interval_of_zero_gives_nothing() -> None:
    assert dissipated_by_range((1.0,), (0.0,), (1.0,), 0.0) == 0.0


def test_a_count_of_chatter_is_no_motion() -> None:
    r = 5.5e-5
    assert dissipated_by_range((0.1,), (0.0,), (r,), 0.005, r) == 0.0
    assert dissipated_by_range((0.1,), (0.0,), (3 * r,), 0.005, r) == pytest.approx(0.1 * (2 * r) ** 2 / 0.005)


def test_a_held_damper_dissipates_less_than_the_range_claims() -> None:
    """From rest at constant acceleration a over 5 ticks T, velocity by differences: 29 b a^2 T^3, claimed 31.25."""
    T, b, a = 1e-3, 0.1, 3.0
    x = [0.5 * a * (j * T) ** 2 for j in range(6)]
    v = [0.0, *((x[j] - x[j - 1]) / T for j in range(1, 5))]
    harvest = MeasuredHarvest((0.0,))
    for j in range(5):
        harvest.hold((-b * v[j],), (x[j],), (x[j + 1],), T)
    unit = b * a * a * T**3
    assert harvest.take(0.0) == pytest.approx(29.0 * unit)
    assert dissipated_by_range((b,), (x[0],), (x[5],), 5 * T) == pytest.approx(31.25 * unit)


def test_measured_harvest_charges_the_leak_of_a_held_spring() -> None:
    """A spring held over a tick of motion dx gives K dx^2/2 more than its potential: that is charged."""
    K, dx = 100.0, 1e-3
    harvest = MeasuredHarvest((0.0,))
    x0 = 0.01
    harvest.hold((-K * x0,), (x0,), (x0 + dx,), 1e-3)
    change = 0.5 * K * ((x0 + dx) ** 2 - x0**2)
    assert harvest.take(change) == pytest.approx(-0.5 * K * dx**2)
    assert harvest.take(0.0) == 0.0


def test_trusted_damping_is_harvested_too() -> None:
    harvest = MeasuredHarvest((0.3, 0.3))
    work = harvest.hold((0.0, 0.0), (0.0, 0.0), (1e-4, 2e-4), 1e-3)
    assert work == pytest.approx(0.3 * 5e-8 / 1e-3)
    assert harvest.take(0.0) == work
    one = MeasuredHarvest((0.0, 0.3), resolution=5e-5)  # less one count of travel
    assert one.hold((0.0, 0.0), (0.0, 0.0), (1e-4, 2e-4), 1e-3) == pytest.approx(0.3 * 1.5e-4**2 / 1e-3)
    assert one.hold((0.0, 2.0), (0.0, 0.0), (0.0, 1e-4), 0.0) == pytest.approx(-2e-4)  # no time, nothing damped


def test_damping_conditions_by_hand() -> None:
    """K T/2 = 0.05; with 2 B = 0.2: 0.25."""
    for b, expected in ((0.04, (False, False)), (0.1, (True, False)), (0.3, (True, True))):
        assert damping_conditions((b,), (100.0,), (0.1,), 1e-3) == expected
