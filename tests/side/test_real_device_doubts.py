"""The force that a real device's side assumes while the device is silent for a short time, or reports only sometimes.

Each test is one that a fault put into `hapnet/side/real_device.py` did not survive, where no other test saw it.
"""

import pytest

from hapnet.checks import Vector
from hapnet.errors import HapnetError
from hapnet.summary.run import device_summary
from tests.side.test_real_device import MS, Arm, Braking, Rig


def silent_for_10_ms(rig: Rig) -> None:
    """Longer than the device's own watchdog (5 ms), shorter than the servo's (20 ms): nobody calls it an overrun."""
    rig.arm.silent = True
    rig.tick(0.0, times=4)
    rig.arm.silent = False


def test_a_short_silence_leaves_the_force_before_it_in_doubt() -> None:
    """2 N towards +x. Going back would have taken energy in, had the force still acted: that does not count."""
    rig = Rig()
    rig.tick(0.0, times=3)
    assert rig.arm.reported[-1][0] == pytest.approx(2.0)
    before = rig.work
    silent_for_10_ms(rig)
    rig.tick(-0.001)
    assert rig.events[-1].endswith("the force grows")
    assert rig.work - before == pytest.approx(0.0, abs=1e-12)


def test_after_a_short_silence_the_force_grows_from_zero() -> None:
    rig = Rig(device__force_ramp_s=0.02)
    rig.tick(0.0, times=20)
    assert rig.arm.reported[-1][0] == pytest.approx(2.0)
    silent_for_10_ms(rig)
    rig.tick(0.0)
    assert 0.0 < rig.arm.reported[-1][0] <= 2.0 * 12.0 / 20.0
    grown: list[Vector] = list(rig.arm.reported)
    rig.tick(0.0)
    assert rig.arm.reported[-1][0] > grown[-1][0]


def test_a_force_that_was_told_leaves_no_older_one_in_doubt() -> None:
    """2 N are held when a command is lost; then the device reports what acted, and gets 0.1 N. When it does not report
    any more, those 0.1 N are what may have acted."""
    rig = Rig(Braking)
    rig.arm.told_force = (2.0,)
    rig.tick(0.0, times=3)
    rig.arm.deaf = True
    rig.tick(0.0)
    rig.arm.deaf = False
    rig.arm.told_force = (0.5,)
    rig.side.coupling.receive((0.001,), 0.0, 0.0)
    rig.tick(0.0)
    small = rig.arm.reported[-1][0]
    assert small == pytest.approx(0.1)
    before = rig.work
    rig.arm.told_force = None
    rig.tick(0.0005)
    assert rig.work - before == pytest.approx(-small * 0.0005, rel=1e-6)


def test_a_doubt_is_over_with_the_next_command() -> None:
    """A command is lost while 2 N are held. Two ticks later the force is known again, and what it takes in counts."""
    rig = Rig()
    rig.tick(0.0, times=3)
    rig.arm.deaf = True
    rig.tick(0.001)
    rig.arm.deaf = False
    rig.tick(0.001)
    (force,), before = rig.arm.reported[-1], rig.work
    assert force > 1.0
    rig.tick(0.0005)
    assert rig.work - before == pytest.approx(force * 0.0005, rel=1e-9)


def test_a_device_that_is_silent_at_the_end_is_not_taken_for_passive() -> None:
    rig = Rig()
    rig.tick(0.0, times=3)
    rig.arm.silent = rig.arm.deaf = True
    rig.tick(0.0, times=20)
    rig.side.stop()
    stopped = device_summary(rig.side, "pspm")["stopped"]
    assert "silent at the end" in stopped["why"]
    assert rig.events[-1].endswith("the cable is out; up to 2 N may remain until its own watchdog acts")


@pytest.mark.parametrize("held", [True, False])
def test_nor_is_one_whose_cable_goes_with_its_last_command(held: bool) -> None:
    """Too short before the end for a silence. Where no force was held there is none that may remain."""
    rig = Rig(device__force_ramp_s=0.0 if held else 1e9)
    rig.tick(0.0, times=3)
    if not held:
        rig.side.withhold(rig.now_ns, "nobody is there")
        rig.tick(0.0)
    rig.arm.deaf = True
    rig.side.stop()
    stopped = device_summary(rig.side, "pspm")["stopped"]
    assert (stopped is not None and stopped["why"] is not None) is held
    assert ("may remain" in " ".join(rig.events)) is held


def test_a_force_that_does_not_agree_with_the_motion_ends_in_the_same_tick(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig()
    rig.tick(0.0, times=3)
    assert rig.arm.reported[-1][0] == pytest.approx(2.0)
    monkeypatch.setattr(rig.side._checks.agreement, "wrong", lambda *reading: "is the motor reversed?")
    rig.tick(0.0)
    assert rig.arm.reported[-1] == (0.0,)


class Counted(Arm):
    begun = ended = 0

    def begin(self) -> None:
        self.begun += 1

    def close(self) -> None:
        self.ended += 1


def test_control_begins_once_and_the_device_is_closed_once() -> None:
    rig = Rig(Counted)
    rig.tick(0.0, times=3)
    rig.side._begin()  # as the last push at the start does, before control
    for _ in range(2):
        rig.side.stop()
    assert (rig.arm.begun, rig.arm.ended) == (1, 1)


class Failing(Braking):
    fails = False

    def apply(self, force: Vector) -> None:  # type: ignore[override]
        if self.fails:
            raise SystemExit("the bus is gone")
        super().apply(force)


def test_an_apply_that_raises_while_a_force_is_held_is_said_with_the_force_that_may_remain() -> None:
    rig = Rig(Failing)
    rig.tick(0.0, times=3)
    rig.arm.fails = True
    with pytest.raises(HapnetError, match=r"apply\(\) raised SystemExit"):
        rig.tick(0.0)
    with pytest.raises(HapnetError):
        rig.side.stop()
    assert rig.arm.closed
    assert "up to 2 N may remain until its own watchdog acts" in rig.events[-1]


class Turned(Arm):
    def orientation(self) -> Vector:
        return (1.0, 0.0, 0.0, 0.0)


def test_how_the_handle_is_turned_is_reported_a_hundred_times_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    rig, reported = Rig(Turned), []
    monkeypatch.setattr(rig.side.endpoint, "report", lambda name, _: reported.append((name, rig.now_ns)))
    rig.tick(0.0, times=10)
    assert reported == [("orientation", 10 * MS), ("orientation", 20 * MS)]
