"""How far a hand comes behind a plane that stops it."""

import pytest
from hypothesis import given, strategies as st
from scipy.integrate import quad

from hapnet.control.predicted_device import PredictedDevice
from hapnet.control.prediction import MotionPredictor, depth_ahead
from hapnet.mechanics.plane import Plane

STOP_S = 0.015
speeds, depths, times = st.floats(-1.0, 1.0), st.floats(1e-6, 0.05), st.floats(1e-3, 0.3)


@given(depths, speeds, times)
def test_behind_the_plane_the_speed_dies_away(depth: float, speed: float, ahead: float) -> None:
    """Independent: v t/(1 + t/tau) is the integral of v/(1 + t/tau)^2, over the time that is spent behind the plane."""
    found = depth_ahead(depth, depth + speed * ahead, speed, ahead, STOP_S)
    if found < 0.0:
        return
    way, _ = quad(lambda t: speed / (1.0 + t / STOP_S) ** 2, 0.0, ahead)
    assert found == pytest.approx(depth + way, rel=1e-9, abs=1e-12)


@given(depths, st.floats(-1.0, -0.01), times)
def test_a_hand_that_comes_out_goes_on_with_its_own_speed(depth: float, speed: float, ahead: float) -> None:
    found = depth_ahead(depth, depth + speed * ahead, speed, ahead, STOP_S)
    assert found >= depth + speed * ahead - 1e-12  # never farther than without the plane
    if found < 0.0:
        since = found / speed  # it has been out for so long, and before that it came as far as the surface
        way, _ = quad(lambda t: speed / (1.0 + t / STOP_S) ** 2, 0.0, ahead - since)
        assert depth + way == pytest.approx(0.0, abs=1e-9)


@given(st.floats(-0.05, 0.0), st.floats(1e-6, 0.1), times)
def test_a_hand_that_goes_in_is_slowed_from_the_surface_on(depth: float, free: float, ahead: float) -> None:
    found = depth_ahead(depth, free, 0.0, ahead, STOP_S)
    assert 0.0 < found < free
    inside = ahead * free / (free - depth)
    assert found == pytest.approx(free / inside * inside / (1.0 + inside / STOP_S))


def device(stop_s: float, start: float, speed: float) -> PredictedDevice:
    made = PredictedDevice((start,), 0.028, MotionPredictor(), stop_s)
    for k in range(11):
        made.receive((start + speed * 0.004 * k,), 0.004 * k, 0.05)
    return made


def test_a_prediction_does_not_run_on_into_a_wall() -> None:
    """200 mm/s, and 20 mm before the wall at the newest stamp; 0.05 + 0.028 + 0.015 s ahead that is 1.4 mm in front."""
    for wall_m, stops in ((0.0, True), (0.5, False)):
        free, stopped = device(0.0, -0.018, 0.2), device(STOP_S, -0.018, 0.2)
        for one in (free, stopped):
            one.see((Plane((1.0,), wall_m, 3000.0, 10.0),))
        (without,), (with_it,) = free.step(0.03, (0.0,)), stopped.step(0.03, (0.0,))
        assert without == pytest.approx(-0.01 + 0.2 * 0.093)
        assert (0.0 < with_it < without / 2.0) if stops else with_it == without


def test_a_plane_that_moves_changes_nothing() -> None:
    free, stopped = device(0.0, -0.018, 0.2), device(STOP_S, -0.018, 0.2)
    stopped.see((Plane((1.0,), 0.0, 3000.0, 10.0, velocity_mps=0.01),))
    assert stopped.step(0.03, (0.0,)) == free.step(0.03, (0.0,))
