"""The driver of the Touch, with a stand-in of OpenHaptics' library that is compiled here and ticks by hand."""

import ctypes
import math
import random
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from hapnet.errors import DeviceSilent, HapnetError
from hapnet.ext.devices import open_haptics as oh
from hapnet.ext.devices.touch import TouchDriver
from tests.support.hd_stand_in import NOTHING, OFF_AT_END, OPEN, OUTPUT, RUNNING, TICK_S, Stub, Three, built

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no C compiler")


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> str:
    return built(tmp_path_factory.mktemp("hd"))


@pytest.fixture
def stub(library: str) -> Iterator[Stub]:
    stub = Stub(library)
    yield stub
    stub.c.stub_by_hand(0)


@pytest.fixture
def made(stub: Stub) -> Iterator[TouchDriver]:
    """A device as it is before the sides have met."""
    made = TouchDriver(3, library=stub.library, clock=stub.now)
    yield made
    made.close()


@pytest.fixture
def device(made: TouchDriver, stub: Stub) -> TouchDriver:
    """One whose motors are on, and have come to full power."""
    made.home()
    made.begin()
    stub.tick(500)
    made.read()
    return made


# The stand-in itself: what the reference says of failures


def test_a_force_outside_of_a_frame_and_frames_that_are_not_pairs_are_errors(made: TouchDriver, stub: Stub) -> None:
    stub.c.hdSetDoublev(oh.FORCE, Three(1.0, 0.0, 0.0))
    assert stub.c.hdGetError().code == 0x0402  # HD_FRAME_ERROR
    stub.c.hdEndFrame(0)
    stub.c.hdBeginFrame(0)
    stub.c.hdBeginFrame(0)
    stub.c.hdEndFrame(0)
    assert [stub.c.hdGetError().code for _ in range(3)] == [0x0400, 0x0401, 0]  # the newest first, then none
    stub.c.hdGetIntegerv(oh.POSITION, ctypes.byref(ctypes.c_int()))
    assert stub.c.hdGetError().code == 0x0103  # HD_INVALID_INPUT_TYPE


# Units, axes, limits


def test_positions_are_in_our_frame_and_in_metres(device: TouchDriver, stub: Stub) -> None:
    """Their x is to the right, y up, z to the user, in millimetres."""
    stub.put((0.01, 0.02, 0.03), (0.1, 0.2, 0.3))
    stub.tick(seconds=0.0)
    x, v = device.read()
    assert x == pytest.approx((0.01, -0.03, 0.02))
    assert v == pytest.approx((0.1, -0.3, 0.2))


def test_forces_are_in_our_frame(device: TouchDriver, stub: Stub) -> None:
    device.apply((0.1, 0.2, 0.3))
    stub.tick()
    assert stub.force == pytest.approx((0.1, 0.3, -0.2))


def test_the_library_tells_the_limits(made: TouchDriver) -> None:
    assert (made.force_limit, made.continuous_force, made.stiffness_range) == (3.3, 0.88, (0.0, 900.0))
    assert made.workspace == pytest.approx(
        (1.2 * 0.21, 1.2 * 0.13, 1.2 * 0.205)
    )  # its 210, 130 and 205 mm, and a fifth


def test_with_other_axes_reach_and_force_follow(stub: Stub) -> None:
    device = TouchDriver(2, axes="-zx", library=stub.library, clock=stub.now)
    assert device.workspace == pytest.approx((1.2 * 0.205, 1.2 * 0.21))
    device.begin()
    stub.tick(500)
    device.apply((0.5, 0.25))
    stub.tick()
    assert stub.force == pytest.approx((0.25, -0.5, 0.0))
    device.close()


def test_the_stylus_is_told_in_our_frame(device: TouchDriver, stub: Stub) -> None:
    """A quarter turn about their y is one about our z; about their z, one backwards about our y. Columns come first."""
    half = math.sqrt(0.5)
    Sixteen = ctypes.c_double * 16
    about_y = Sixteen(0, 0, -1, 0, 0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1)
    about_z = Sixteen(0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1)
    for columns, expected in ((about_y, (half, 0.0, 0.0, half)), (about_z, (half, 0.0, -half, 0.0))):
        stub.c.stub_transform(columns)
        stub.tick()
        device.read()
        assert device.orientation() == pytest.approx(expected)


def test_buttons(device: TouchDriver, stub: Stub) -> None:
    stub.c.stub_buttons(0b10)
    stub.tick()
    device.read()
    assert device.buttons() == (False, True)


# Which force acts, and since when


def test_there_is_no_force_before_control_begins(made: TouchDriver, stub: Stub) -> None:
    made.home()
    made.apply((1.0, 0.0, 0.0))
    stub.tick(3)
    assert (stub.state(OUTPUT), stub.force) == (0, NOTHING)
    made.begin()
    stub.tick()
    assert stub.state(OUTPUT) == 1


def test_a_force_begins_with_the_frame_after_its_reading_and_the_account_knows(device: TouchDriver, stub: Stub) -> None:
    device.apply((0.5, 0.0, 0.0))
    stub.tick()
    device.read()
    assert device.acted() == NOTHING  # until this frame
    assert device.interval() == pytest.approx(TICK_S)
    stub.tick()
    device.read()
    assert device.acted() == pytest.approx((0.5, 0.0, 0.0))


def accounts(device: TouchDriver, stub: Stub, seed: int, count: int, late: float) -> tuple[float, float]:
    """The work that the driver accounts for, and that the stand-in integrates itself [J], by random forces.

    late : the share of the servo's ticks that come one or two frames too late.
    """
    chance = random.Random(seed)
    stub.tick()
    last, _ = device.read()
    before, told_J = stub.work_J, 0.0
    for _ in range(count):
        device.apply(tuple(chance.uniform(-1.0, 1.0) for _ in range(3)))
        stub.tick(1 if chance.random() >= late else chance.randint(2, 3))
        x, _ = device.read()
        acted = device.acted()
        assert acted is not None
        told_J += sum(f * (b - a) for f, a, b in zip(acted, last, x, strict=True))
        last = x
    return told_J, stub.work_J - before


def test_late_servos_account_for_no_less_than_the_motors_gave(device: TouchDriver, stub: Stub) -> None:
    told_J, work_J = accounts(device, stub, 1, 2000, late=0.1)
    assert told_J >= work_J


def test_a_servo_on_time_accounts_to_the_microjoule(device: TouchDriver, stub: Stub) -> None:
    told_J, work_J = accounts(device, stub, 2, 1000, late=0.0)
    assert told_J == pytest.approx(work_J, abs=1e-9)
    assert abs(told_J) > 1e-5


def test_of_the_forces_of_several_frames_the_one_counts_that_put_out_most(device: TouchDriver, stub: Stub) -> None:
    stub.put(NOTHING)
    device.apply((1.0, 0.0, 0.0))
    stub.tick(seconds=0.0)
    device.read()
    device.apply((-1.0, 0.0, 0.0))
    stub.tick(seconds=0.0)
    stub.put((0.001, 0.0, 0.0))
    stub.tick(seconds=0.0)  # it moved to the right, while the first force acted or the second
    device.read()
    assert device.acted() == (1.0, 0.0, 0.0)


def test_a_servo_that_stops_leaves_no_force(device: TouchDriver, stub: Stub) -> None:
    device.apply((1.0, 0.0, 0.0))
    stub.tick(10)
    assert stub.force == pytest.approx((1.0, 0.0, 0.0))
    stub.tick()
    assert stub.force == NOTHING


# What goes wrong


def test_warm_motors_have_no_force_until_they_are_cool(device: TouchDriver, stub: Stub) -> None:
    stub.c.stub_hot(1.0)
    device.apply((1.0, 0.0, 0.0))
    stub.tick(100)
    device.read()
    assert device.braked() == "its motors are warm: HD_WARM_MOTORS (0x0200, internal -1)"
    for _ in range(120):
        device.apply((1.0, 0.0, 0.0))
        stub.tick(seconds=0.1)
    assert "warm" in device.braked()  # 12 s later they are as warm as ever
    assert stub.force == NOTHING
    stub.c.stub_hot(0.7)
    stub.tick(120, seconds=0.1)
    assert device.braked() == ""
    device.apply((1.0, 0.0, 0.0))
    stub.tick()
    assert stub.force == pytest.approx((1.0, 0.0, 0.0))


def test_one_that_does_not_tell_its_temperature_runs_as_well(device: TouchDriver, stub: Stub) -> None:
    stub.c.stub_hot(-1.0)
    device.apply((1.0, 0.0, 0.0))
    stub.tick(101)
    device.read()
    assert device.braked() == ""


@pytest.mark.parametrize(("code", "said"), [(0x0202, "its force jumped"), (0x0203, "it went faster than its limit")])
def test_after_an_error_of_the_amplifiers_there_is_no_force_for_a_second(
    device: TouchDriver, stub: Stub, code: int, said: str
) -> None:
    device.apply((1.0, 0.0, 0.0))
    stub.c.stub_error(code)
    stub.tick()
    stub.c.stub_error(0)
    assert said in device.braked()
    for _ in range(998):
        device.apply((1.0, 0.0, 0.0))
        stub.tick()
    assert device.braked()
    assert stub.force == NOTHING  # the amplifiers are back long since
    device.apply((1.0, 0.0, 0.0))
    stub.tick(3)
    assert device.braked() == ""


def test_a_force_that_the_library_refuses_counts_only_where_it_put_out(device: TouchDriver, stub: Stub) -> None:
    """It may have ended at any moment: of 4 N and none, none took less in."""
    stub.put(NOTHING)
    device.apply((4.0, 0.0, 0.0))
    stub.tick(seconds=0.0)
    device.read()
    assert "too large" in device.braked()
    stub.put((-0.001, 0.0, 0.0))
    stub.tick(seconds=0.0)
    device.read()
    assert device.acted() == NOTHING


def test_a_lost_connection_is_a_silence_and_afterwards_the_force_begins_at_zero(
    device: TouchDriver, stub: Stub
) -> None:
    device.apply((1.0, 0.0, 0.0))
    stub.tick()
    device.read()
    stub.c.stub_error(0x0302)
    stub.tick(5)
    with pytest.raises(DeviceSilent, match=r"no frame for 5 ms: HD_COMM_ERROR: is it connected\? \(0x0302"):
        device.read()
    stub.c.stub_error(0)
    stub.tick()
    assert stub.force == NOTHING
    device.read()
    assert (device.acted(), device.interval()) == (None, None)  # nobody knows
    stub.tick()
    device.read()
    assert device.acted() == NOTHING


def test_a_scheduler_that_stands_still_is_a_silence(device: TouchDriver, stub: Stub) -> None:
    stub.c.stub_stall(1)
    stub.tick(5)
    with pytest.raises(DeviceSilent, match="the library's scheduler made none"):
        device.read()


def test_what_only_a_defect_here_can_cause_ends_the_run(device: TouchDriver, stub: Stub) -> None:
    stub.c.stub_error(0x0402)
    stub.tick(2)
    with pytest.raises(HapnetError, match="HD_FRAME_ERROR"):
        device.read()


# Calibration


def test_one_in_its_inkwell_is_calibrated(made: TouchDriver, stub: Stub) -> None:
    """Before that its positions are wrong by 60 mm."""
    stub.c.stub_calibration(oh.NEEDS_UPDATE)
    stub.tick(seconds=0.0)
    assert made.read()[0][0] == pytest.approx(0.06)
    made.home()
    stub.tick(seconds=0.0)
    assert made.read()[0][0] == pytest.approx(0.0)


def test_one_that_is_not_says_what_to_do(made: TouchDriver, stub: Stub) -> None:
    stub.c.stub_calibration(oh.NEEDS_INPUT)
    with pytest.raises(HapnetError, match="Omni stand-in is not calibrated: put its stylus into the inkwell"):
        made.home()


# What is not there


def test_without_the_library_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(oh, "find", lambda: "")
    assert TouchDriver.missing().startswith("OpenHaptics (libHD) and the device's driver")
    with pytest.raises(HapnetError, match=r"^the device needs OpenHaptics \(libHD\) .*, both from 3D Systems"):
        TouchDriver(1)


@pytest.mark.parametrize("other", ["/dev/null", "libc.so.6"])
def test_another_library_is_refused(other: str) -> None:
    with pytest.raises(HapnetError, match=f"^{other} cannot be loaded as OpenHaptics' libHD: "):
        TouchDriver(1, library=other)


def test_a_wrong_name_and_one_that_is_in_use_are_named(made: TouchDriver, stub: Stub) -> None:
    with pytest.raises(HapnetError, match=r"^no device named 'Left': HD_DEVICE_FAULT: no such device"):
        TouchDriver(1, name="Left", library=stub.library)
    with pytest.raises(HapnetError, match=r"^no device of 3D Systems: HD_DEVICE_ALREADY_INITIATED: another program"):
        TouchDriver(1, library=stub.library)


def test_the_names_of_the_makers_setup_are_listed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("GTDD_HOME", raising=False)
    assert TouchDriver.found() == ()
    (tmp_path / "config").mkdir()
    for name in ("Left Device", "Default Device"):
        (tmp_path / "config" / f"{name}.config").touch()
    monkeypatch.setenv("GTDD_HOME", str(tmp_path))
    assert TouchDriver.found() == ("Default Device", "Left Device")


def test_at_the_end_the_force_is_taken_away_and_the_device_closed(device: TouchDriver, stub: Stub) -> None:
    """A frame must come that sets no force: here it does while the driver waits for it."""
    device.apply((1.0, 0.0, 0.0))
    stub.tick()
    ticking = threading.Timer(0.01, stub.tick)
    ticking.start()
    device.close()
    ticking.join()
    device.close()
    assert stub.commanded == NOTHING
    assert [stub.state(what) for what in (OPEN, RUNNING, OFF_AT_END)] == [0, 0, 1]


def test_a_dead_scheduler_does_not_hold_the_end_up(device: TouchDriver, stub: Stub) -> None:
    stub.c.stub_stall(1)
    device.close()
    assert [stub.state(what) for what in (OPEN, RUNNING)] == [0, 0]
