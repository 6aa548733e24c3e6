"""The world's prediction of the device: exact for what it assumes, bounded otherwise, and in step with the proxy."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from hapnet.control.predicted_device import PredictedDevice
from hapnet.control.prediction import MOST, TRUST_KEPT, TRUST_M, MotionPredictor
from hapnet.control.reporter import SampleReporter
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds.walls import Contacts, Wall

NUMBERS = st.floats(-2.0, 2.0)
WINDOW = {"window": 0.06, "maximum": 0.2, "max_curve": 0.1}


def fed(times: list[float], motion: np.poly1d, **limits: float) -> MotionPredictor:
    predictor = MotionPredictor(**WINDOW | limits)
    for t in times:
        predictor.receive((float(motion(t)), -float(motion(t))), t)
    return predictor


@given(NUMBERS, NUMBERS, NUMBERS, st.floats(0.0, 0.1), st.integers(0, 2**32 - 1))
@pytest.mark.long
def test_a_parabola_is_continued_exactly(a: float, b: float, c: float, ahead: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    times = [*np.sort(5.0 + rng.uniform(0.0, 0.06, 8)).tolist(), 5.0, 5.06]
    motion = np.poly1d([a, b, c])
    predicted, reached = fed(sorted(times), motion).at(ahead)
    wanted = motion(5.06 + ahead)
    assert reached == ahead
    assert predicted == pytest.approx((wanted, -wanted), abs=1e-6)


def test_beyond_a_tenth_of_a_second_the_velocity_stays_and_beyond_a_fifth_nothing_is_predicted() -> None:
    predictor = fed([0.005 * k for k in range(13)], np.poly1d([1.0, 0.0, 0.0]))  # x = t^2, newest at 0.06 s
    at_limit = 0.16**2 + 2 * 0.16 * 0.1  # the parabola to 0.16 s, then its tangent
    assert predictor.at(0.2) == (pytest.approx((at_limit, -at_limit)), WINDOW["maximum"])
    assert predictor.at(5.0) == predictor.at(0.2)


def test_noise_is_averaged_as_least_squares_averages_it() -> None:
    """An independent fit, numpy's, gives the same."""
    rng = np.random.default_rng(1)
    times = np.arange(13) * 0.005
    values = np.sin(7.0 * times) + 1e-3 * rng.standard_normal(13)
    predictor = MotionPredictor(**WINDOW)
    for t, x in zip(times.tolist(), values.tolist(), strict=True):
        predictor.receive((x,), t)
    predicted, _ = predictor.at(0.05)
    assert predicted[0] == pytest.approx(np.polyval(np.polyfit(times, values, 2), 0.06 + 0.05), abs=1e-9)


@given(st.permutations(range(12)))
@pytest.mark.long
def test_the_order_of_arrival_does_not_matter(order: list[int]) -> None:
    motion = np.poly1d([0.5, 1.0, 2.0])
    stamps = [0.005 * k for k in range(12)]
    mixed = fed([stamps[k] for k in order if k != 11] + [stamps[11]], motion)
    assert mixed.at(0.1)[0] == pytest.approx(fed(stamps, motion).at(0.1)[0], abs=1e-9)


def test_what_comes_twice_counts_once_and_too_few_positions_give_no_velocity() -> None:
    predictor = MotionPredictor()
    for _ in range(3):
        predictor.receive((1.0,), 1.0)
    predictor.receive((1.5,), 1.001)
    assert predictor.at(0.1)[0] == (1.5,)
    predictor.reset()
    assert predictor.newest_s is None


@pytest.mark.parametrize("step", [0.001, 0.005, 0.03, 0.05])
@pytest.mark.parametrize("age", [0.0, 0.02, 0.08])
def test_the_proxy_of_a_steady_motion_stands_where_the_device_is(step: float, age: float) -> None:
    """B'/K' + T/2 is what the integrator lags behind a ramp (its step is a discrete first-order lag, for M -> 0)."""
    speed, damping, stiffness = 0.1, 14.0, 500.0
    mass = PassiveIntegrator(1e-9, damping, stiffness, (0.0,))
    mass.set_contacts(Contacts((), 1))
    source = PredictedDevice((0.0,), damping / stiffness, MotionPredictor())
    clock = 77.0  # the device's clock is so much ahead
    now = 0.0
    for _ in range(round(1.0 / step)):
        for sent in np.arange(0.005 * np.ceil((now - age - 0.06) / 0.005), now - age + 1e-9, 0.005).tolist():
            source.receive((speed * sent,), sent + clock, now - sent)
        mass.step(step, source.step(step, mass.position), Contacts((), 1))
        now += step
    assert mass.position[0] == pytest.approx(speed * now, abs=1e-6)
    assert source.stands_for(step) - clock == pytest.approx(now, abs=1e-9)


@pytest.mark.parametrize(("speed_mps", "reach_m"), [(1.0, 0.47), (3.0, 1.0)])
def test_planes_are_sent_that_a_device_reaches_in_a_round_trip_and_none_beyond_a_metre(
    speed_mps: float, reach_m: float
) -> None:
    """Positions are 0.2 s old, steps take 0.02 s: 0.42 s until the device has an answer; and 50 mm in any case."""
    source = PredictedDevice((0.0,), 0.03, MotionPredictor())
    source.age, source.mean_step = 0.2, 0.02
    reporter, mass = SampleReporter((0.0,), source, 0.05, speed_mps), PassiveIntegrator(0.02, 14.0, 500.0, (0.0,))
    wall = Wall((1.0,), 0.999 * reach_m, 1000.0), Wall((-1.0,), 1.001 * reach_m, 1000.0)
    reporter.moved(mass.step(0.02, (0.0,), contacts := Contacts(wall)), contacts)
    reporter.look(0.02, (0.0,))
    proxy = reporter.proxy((0.0,), None)
    assert proxy.reach_m == pytest.approx(reach_m)
    assert [plane.offset_m for plane in proxy.planes or ()] == [wall[0].offset]
    assert source.around.offset[: source.around.count] == [wall[0].offset]


def test_the_next_step_is_taken_for_the_mean_of_the_last_ten_or_so() -> None:
    """A first-order mean with gain 1/10; the device has its answer a step and two ages later."""
    source = PredictedDevice((0.0,), 0.03, MotionPredictor())
    for dt in (0.02, *[0.04] * 7):
        source.step(dt, (0.0,))
    assert source.turn_s == pytest.approx(2.0 * (0.02 + 7 * 0.04) + 0.04 - 0.02 * 0.9**7)


def test_nothing_known_yet() -> None:
    source = PredictedDevice((0.5,), 0.03, MotionPredictor())
    assert source.step(0.01, (0.0,)) == (0.5,)
    assert source.stands_for(0.01) == 0.0


@pytest.mark.long
def test_of_more_positions_than_there_is_room_for_the_newest_count() -> None:
    """The last `MOST` of them, against numpy's fit; the window alone would hold three times as many."""
    rng = np.random.default_rng(5)
    times, places = np.arange(3 * MOST) * 1e-3, rng.normal(size=3 * MOST)
    predictor = MotionPredictor(window=10.0, maximum=0.5, max_curve=0.5)
    for time, place in zip(times.tolist(), places.tolist(), strict=True):
        predictor.receive((place,), time)
    predictor.receive((1e6,), times[-1] - 2.0)  # older than all of these
    fitted = np.polyfit(times[-MOST:] - times[-1], places[-MOST:], 2)
    (found,), _ = predictor.at(0.1)
    assert found == pytest.approx(np.polyval(fitted, 0.1), rel=1e-6)


def compared(motion: Any, ahead: float, seconds: float) -> tuple[MotionPredictor, list[float], list[float]]:
    """A predictor that was fed every 5 ms, and asked each time; and the predicted and the real travels by numpy's fit,
    for those predictions that were compared: one after another."""
    predictor = MotionPredictor(**WINDOW)
    told, real = [], []
    due = -1.0
    for k in range(round(seconds / 0.005)):
        t = 0.005 * k
        predictor.receive((float(motion(t)),), t)
        if k >= 12 and t >= due - 1e-9:
            times = t - 0.005 * np.arange(13)
            curve = np.polyfit(times - t, [motion(one) for one in times], 2)
            tangent = min(ahead, 0.1)
            told.append(float(curve[1] * ahead + curve[0] * tangent * (2.0 * ahead - tangent)))
            real.append(float(motion(t + ahead) - curve[2]))
            due = t + ahead
        if k >= 12:
            predictor.at(ahead)
    return predictor, told[:-1], real[:-1]


@pytest.mark.parametrize(("hz", "least", "most"), [(0.3, 0.9, 1.0), (1.0, 0.6, 1.0), (4.0, 0.0, 0.2)])
def test_a_prediction_is_trusted_as_far_as_it_has_proved_right(hz: float, least: float, most: float) -> None:
    """A slow hand is predicted, and one that writes is not: the share with the least squared error, with old
    predictions forgotten."""
    predictor, told, real = compared(lambda t: 0.03 * np.sin(2.0 * np.pi * hz * t), 0.15, 12.0)
    right = whole = TRUST_M**2
    for d, r in zip(told, real, strict=True):
        right, whole = TRUST_KEPT * right + d * r, TRUST_KEPT * whole + d * d
    assert predictor.trust == pytest.approx(min(1.0, max(0.0, right / whole)), abs=0.02)
    assert least <= predictor.trust <= most


def test_a_new_device_is_trusted_again() -> None:
    predictor, _, _ = compared(lambda t: 0.03 * np.sin(2.0 * np.pi * 4.0 * t), 0.15, 6.0)
    assert predictor.trust < 0.2
    predictor.reset()
    assert predictor.trust == 1.0
