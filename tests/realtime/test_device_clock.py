"""A device that knows when it took its readings: the account goes by its clock."""

import pytest

from hapnet.errors import HapnetError
from tests.side.test_real_device import Arm, Rig


class Timed(Arm):
    """It takes a reading each 2 ms of its own clock, whenever that comes."""

    reported_s = 0.002

    def interval(self) -> float:
        return self.reported_s


class InMilliseconds(Timed):
    reported_s = 2.0


@pytest.mark.parametrize(("device", "fastest"), [(Timed, 0.4), (Arm, 4.0)])
def test_readings_that_come_together_are_no_fast_motion_where_the_device_has_a_clock(
    device: type[Arm], fastest: float
) -> None:
    """0.8 mm in each of its 2 ms; the machine was busy for 3.8 ms, and then two readings came 0.2 ms apart."""
    rig = Rig(device)
    for k in range(1, 20):
        rig.now_ns += (3_600_000 if k % 2 else 0) - 1_800_000
        rig.tick(8e-4 * k)
    assert rig.side.held_forces()["speed_max_mps"] == pytest.approx(fastest)


class Slow(Timed):
    reported_s = 0.0014


def test_an_interval_in_another_unit_is_named_before_it_does_anything() -> None:
    rig = Rig(InMilliseconds)
    with pytest.raises(HapnetError, match=r"the sum of its interval\(\) is 2 s in 0.002 s \(is the unit s\?\)"):
        rig.tick(0.0)


def test_a_clock_that_runs_slow_is_named() -> None:
    """It reports 1.4 ms for each 2 ms: what a trusted damper takes would count too much."""
    rig = Rig(Slow)

    def a_second() -> None:
        rig.tick(0.0, times=500)

    with pytest.raises(HapnetError, match=r"the sum of its interval\(\) is 0.\d+ s in 0.\d+ s"):
        a_second()


class Busy(Timed):
    """Its reading comes each 2.2 ms, and 0.2 ms of them the tick then takes."""

    reported_s = 0.0022

    def buttons(self) -> tuple[bool, ...]:
        self.take()
        return super().buttons()

    def take(self) -> None: ...


def test_what_a_tick_takes_is_counted_once() -> None:
    rig = Rig(Busy)

    def take() -> None:
        rig.now_ns += 200_000

    rig.arm.take = take  # type: ignore[attr-defined]  # of this class
    rig.tick(0.0, times=1000)
    assert rig.side.last_ns == pytest.approx(2.2e9, rel=0.01)


@pytest.mark.long
def test_a_servo_that_was_away_is_no_fault_of_the_devices_clock() -> None:
    """For 3 s; some readings waited meanwhile and come at once afterwards, the others are lost."""
    rig = Rig(Timed)
    rig.tick(0.0, times=600)
    rig.tick(0.0, ms=3000)
    for _ in range(500):
        rig.now_ns += 100_000
        rig.tick(0.0, ms=0)
    rig.tick(0.0, times=600)
    assert rig.side.overruns == 1
