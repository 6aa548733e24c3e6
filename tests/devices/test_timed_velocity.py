"""The velocity from timed positions: exact motions, encoders and sensors simulated here, bounds from theory."""

import itertools
import math
import random
from collections.abc import Callable

import pytest
from hypothesis import given, strategies as st

from hapnet.ext.devices.timed_velocity import TimedVelocity

COUNT = 15e-6
PERIOD = 1e-3


def counted(motion: Callable[[float], float], seconds: float, fine_s: float = 1e-5) -> list[tuple[float, float]]:
    """Velocities of an encoder at each period: where two positions of `COUNT` meet the time is kept, within 10 us."""
    velocity = TimedVelocity(COUNT, COUNT / 4)
    found = []
    before, at, edge = math.floor(motion(0.0) / COUNT), None, 0.0
    for k in range(1, round(seconds / fine_s)):
        t = k * fine_s
        now = math.floor(motion(t) / COUNT)
        if now != before:
            at, edge = t, (now if now > before else before) * COUNT
            before = now
        if k % round(PERIOD / fine_s) == 0:
            found.append((t, velocity.update(t, at, edge)))
    return found


def sampled(
    motion: Callable[[float], float], seconds: float, count: float, noise: float, chance: random.Random
) -> list[tuple[float, float]]:
    """Velocities of a sensor that is read each period, rounded to its count, with uniform noise."""
    velocity = TimedVelocity(count, count + 2.0 * noise)
    found = []
    for k in range(round(seconds / PERIOD)):
        t = k * PERIOD
        x = round((motion(t) + chance.uniform(-noise, noise)) / count) * count
        found.append((t, velocity.update(t, t, x)))
    return found


@pytest.mark.parametrize("speed", [2e-4, -5e-4, 2e-3, 0.02, -0.3, 1.0])
def test_a_steady_motion_of_an_encoder_is_exact_once_two_counts_are_known(speed: float) -> None:
    """Down to 0.2 mm/s: a count each 75 ms."""
    two_counts_s = max(2.1 * COUNT / abs(speed), 2.5 * PERIOD)
    fine_s = 1e-5 if abs(speed) < 0.1 else 1e-6
    motion = counted(lambda t: speed * t + 1e-7, two_counts_s + 0.1, fine_s)
    found = [v for t, v in motion if t > two_counts_s]
    assert found == pytest.approx([speed] * len(found), rel=0.02)


def test_it_ends_when_the_handle_stands_still() -> None:
    """The last count is ever longer ago: after a time t it is no faster than a count in t."""
    stop_s = 0.1
    for t, v in counted(lambda t: 0.05 * min(t, stop_s), 1.0):
        if t > stop_s + 0.002:
            assert 0.0 <= v <= COUNT / (t - stop_s) * 1.01


def test_an_encoder_that_trembles_on_one_count_does_not_move() -> None:
    """Up and down over the same place by a tenth of a count: the place is the same, whichever way it was crossed."""
    found = counted(lambda t: 0.1 * COUNT * math.sin(2 * math.pi * 97.0 * t), 0.5)
    assert max(abs(v) for _, v in found) == 0.0


@pytest.mark.parametrize(("amplitude", "hertz"), [(0.01, 1.0), (0.01, 5.0), (0.001, 10.0)])
def test_a_swinging_handle(amplitude: float, hertz: float) -> None:
    """A line over a time T misses a curve of acceleration a by a T^2 / 8: T <= sqrt(8 noise / a), and it is T/2 late.

    The newest count may be as old as a period, or as a count takes: for both the velocity changes by a times that.
    """
    omega = 2 * math.pi * hertz
    found = counted(lambda t: amplitude * math.sin(omega * t), 2.0 / hertz)
    greatest = amplitude * omega**2
    window_s = max(math.sqrt(8.0 * COUNT / 4 / greatest), PERIOD)
    allowed = greatest * (window_s / 2 + PERIOD) + math.sqrt(2.0 * greatest * COUNT)  # near rest a count takes long
    wrong = [abs(v - amplitude * omega * math.cos(omega * t)) for t, v in found if t > 0.02]
    assert max(wrong) < allowed
    assert allowed < 0.35 * amplitude * omega  # the bound says something


@pytest.mark.parametrize("speed", [-0.3, 0.02, 1.0])
def test_a_sample_may_be_old_when_it_is_read(speed: float) -> None:
    """A sensor of 1 um that was sampled up to 0.9 ms ago: the handle has moved by many counts since."""
    velocity, chance, count = TimedVelocity(1e-6, 1e-6), random.Random(3), 1e-6
    found = []
    for k in range(200):
        now = k * PERIOD
        at = now - chance.uniform(0.0, 0.9) * PERIOD
        found.append(velocity.update(now, at, round(speed * at / count) * count, counted=False))
    assert found[20:] == pytest.approx([speed] * 180, rel=0.01, abs=2e-3)  # two counts over a period


@pytest.mark.parametrize("speed", [0.0, 0.001, 0.05])
def test_a_noisy_sensor_is_smoothed_over_16_samples(speed: float) -> None:
    """12 um a reading, and as much noise either way. At the worst both ends of 15 periods are wrong by all of it."""
    count = 12e-6
    found = sampled(lambda t: speed * t, 1.0, count, count, random.Random(1))[20:]
    worst = (count + 2.0 * count) / (15 * PERIOD)
    assert max(abs(v - speed) for _, v in found) <= worst
    assert sum(v for _, v in found) / len(found) == pytest.approx(speed, abs=worst / 10)
    assert worst < 0.1 * (count + 2.0 * count) / PERIOD  # as wrong as the difference of two samples may be


@given(st.lists(st.tuples(st.floats(1e-5, 0.1), st.floats(-1.0, 1.0)), min_size=2, max_size=40))
@pytest.mark.long
def test_it_is_finite_and_within_the_slopes(steps: list[tuple[float, float]]) -> None:
    """The slope of a line through two positions lies between the least and the greatest of the slopes between."""
    velocity = TimedVelocity(1e-3, 1e-3)
    times = list(itertools.accumulate(step for step, _ in steps))
    places = [x for _, x in steps]
    slopes = [0.0]
    for k, (t, x) in enumerate(zip(times, places, strict=True)):
        if k:
            slopes.append((x - places[k - 1]) / (t - times[k - 1]))
        found = velocity.update(t, t, x)
        assert min(slopes) - 1e-9 <= found <= max(slopes) + 1e-9 or abs(found) < max(map(abs, slopes)) * (1 + 1e-6)


def test_what_is_too_old_to_have_a_time_is_no_position() -> None:
    velocity = TimedVelocity(COUNT, COUNT)
    assert velocity.update(0.0, None, 1.0) == 0.0
    assert velocity.update(1.0, 1.0, 0.0) == 0.0  # the first with a time
    assert velocity.update(2.0, 2.0, 0.5) == 0.5
    velocity.restart()
    assert velocity.update(3.0, 3.0, 9.0) == 0.0
