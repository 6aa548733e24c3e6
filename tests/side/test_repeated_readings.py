"""A device that is read more often than it measures."""

import math

import pytest

from hapnet.side.driver_times import WINDOW, RepeatedReadings


def seen(measures_each: int, *, ticks: int = 5 * WINDOW, rest: bool = False, filtered: bool = False) -> float | None:
    """What is found at 1,000 readings a second of a device that measures every so many of them."""
    repeats = RepeatedReadings()
    for tick in range(ticks):
        at_s = 1e-3 * (tick - tick % measures_each)
        x, v = 0.02 * math.sin(6.0 * at_s), 0.12 * math.cos(6.0 * at_s)
        velocity = 0.0 if rest else v * (1.0 + 1e-9 * tick) if filtered else v
        repeats.see((0.0 if rest else x,), (velocity,))
    return repeats.new_hz(1000.0)


@pytest.mark.parametrize("each", [4, 20])
def test_the_new_readings_are_counted(each: int) -> None:
    assert seen(each) == pytest.approx(1000.0 / each, rel=0.02)


def test_nothing_is_said_of_a_device_that_measures_each_time_or_rests_or_hardly_moved() -> None:
    assert seen(1) is None
    assert seen(4, rest=True) is None
    assert seen(4, ticks=WINDOW - 1) is None


def test_an_encoder_that_stays_at_a_step_does_not_repeat_where_its_velocity_goes_on() -> None:
    assert seen(20, filtered=True) is None
