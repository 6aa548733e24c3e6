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


def jumping(measures_each: int, *, hz: float = 3.0, resolution_m: float = 0.0, ticks: int = 3000) -> float | None:
    """Of a device whose velocity is the difference of its last two positions, at 1,000 readings a second."""
    repeats, before = RepeatedReadings(), 0.0
    for tick in range(ticks):
        x = 0.02 * math.sin(2.0 * math.pi * hz * 1e-3 * (tick - tick % measures_each))
        x = round(x / resolution_m) * resolution_m if resolution_m else x
        repeats.see((x,), (1e3 * (x - before),))
        before = x
    return repeats.new_hz(1000.0)


@pytest.mark.parametrize("each", [2, 8, 30])
def test_positions_that_rest_and_jump_are_repeated_though_the_velocity_between_is_zero(each: int) -> None:
    assert jumping(each) == pytest.approx(1000.0 / each, rel=0.05)


@pytest.mark.parametrize("resolution_m", [1e-5, 1e-4])
def test_the_steps_of_an_encoder_are_no_jumps(resolution_m: float) -> None:
    """At 0.05 Hz and 0.1 mm it changes every 16 readings, by one step."""
    for hz in (0.05, 0.5, 3.0):
        assert jumping(1, hz=hz, resolution_m=resolution_m) is None


def test_nothing_is_said_of_a_device_that_measures_each_time_or_rests_or_hardly_moved() -> None:
    assert seen(1) is None
    assert seen(4, rest=True) is None
    assert seen(4, ticks=WINDOW - 1) is None


def test_an_encoder_that_stays_at_a_step_does_not_repeat_where_its_velocity_goes_on() -> None:
    assert seen(20, filtered=True) is None
