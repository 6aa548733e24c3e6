"""Stages before PSPM: what a low-pass and a predictor must do."""

import math

import pytest

from hapnet.control.smoothing import FilteredVelocity, Pipeline, SmoothingFilter, VelocityPredictor
from hapnet.errors import InvalidParameter


def test_filter_settles_without_overshoot_for_any_step() -> None:
    for dt in (1e-4, 5e-3, 1.0):
        stage = SmoothingFilter(0.015)
        stage.reset((0.0,))
        last = 0.0
        for _ in range(2000):
            (value,) = stage.step(dt, (1.0,), None)
            assert last <= value <= 1.0
            last = value
        assert last == pytest.approx(1.0, abs=1e-5)


def test_filter_has_its_time_constant() -> None:
    """After tau of small steps a step response has reached 1 - 1/e."""
    stage = SmoothingFilter(0.015)
    stage.reset((0.0,))
    for _ in range(1500):
        (value,) = stage.step(1e-5, (1.0,), None)
    assert value == pytest.approx(1.0 - math.exp(-1.0), rel=1e-3)


def test_a_velocity_begins_at_rest_wherever_the_position_is() -> None:
    """Then, in a motion at 2 m/s, it is short of that by tau/(tau + dt) to the power of the steps."""
    found, dt = FilteredVelocity(0.015, 1), 0.005
    for place in (0.3, -0.1):
        assert found.step(dt, (place,)) == (0.0,)
        for k in range(1, 9):
            assert found.step(dt, (place + 2.0 * dt * k,)) == pytest.approx((2.0 * (1.0 - 0.75**k),))
        found.reset()


def test_predictor_is_exact_on_a_straight_line_whatever_the_jitter() -> None:
    """Sent at s with y = 2 s, arriving 40 ms +- jitter later: predicted by the horizon and the age."""
    stage = VelocityPredictor(0.04)
    stage.reset((0.0,))
    stage.step(0.005, (2.0 * 0.1,), 0.1)
    assert stage.step(0.013, (2.0 * 0.13,), 0.13) == pytest.approx((2.0 * (0.13 + 0.04),))
    assert stage.step(0.01, (2.0 * 0.13,), None) == pytest.approx((2.0 * (0.13 + 0.05),))


def test_predictor_stops_at_its_limit_and_ignores_stale_data() -> None:
    stage = VelocityPredictor(0.0, maximum=0.1)
    stage.step(0.01, (0.0,), 0.0)
    stage.step(0.01, (0.01,), 0.01)
    assert stage.step(5.0, (0.01,), None) == pytest.approx((0.01 + 0.1 * 1.0,))
    stage.step(0.01, (5.0,), 0.005)
    assert stage.step(0.0, (0.01,), None) == pytest.approx((0.01 + 0.1 * 1.0,))


def test_predictor_begins_anew_when_the_senders_clock_does() -> None:
    """A peer that restarted on a host just booted counts from zero, and so does one whose stamp once leapt."""
    stage = VelocityPredictor(0.0, maximum=0.1)
    stage.step(0.01, (0.0,), 1e6)
    stage.step(0.01, (0.01,), 1e6 + 0.01)
    assert stage.step(0.01, (5.0,), 3.0) == (5.0,)
    assert stage.step(0.01, (5.02,), 3.01) == pytest.approx((5.02,))
    assert stage.step(0.01, (5.02,), None) == pytest.approx((5.02 + 0.01 * 2.0,))


def test_an_empty_pipeline_is_the_identity_and_a_full_one_is_in_order() -> None:
    assert Pipeline().step(0.01, (1.0, 2.0), 0.0) == (1.0, 2.0)
    both = Pipeline([VelocityPredictor(1.0, 10.0), SmoothingFilter(0.01)])
    both.reset((0.0,))
    both.step(0.01, (0.0,), 0.0)
    assert both.step(0.01, (0.01,), 0.01) == pytest.approx((0.5 * (0.01 + 1.0),))  # predicted 1.01, half way


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_bad_time_constant(value: float) -> None:
    with pytest.raises(InvalidParameter, match="smoothing"):
        SmoothingFilter(value)
