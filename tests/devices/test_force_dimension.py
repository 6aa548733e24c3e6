"""The driver of Force Dimension's devices, with a stand-in of the maker's library that is compiled here."""

import ctypes
import json
import math
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from hapnet.errors import DeviceSilent, HapnetError, InvalidParameter
from hapnet.ext.devices import force_dimension
from hapnet.ext.devices.force_dimension import ForceDimension
from hapnet.ext.tools.posed import Posed
from hapnet.mechanics.pose import ARM_M, along_coordinates, coordinates
from tests.conftest import ROOT, mostly_slow
from tests.support.processes import assert_passive, started

OPEN, WATCHDOG, GRAVITY, ENABLED, STOPPED, BRAKES, ENABLES, REGULATING, INITS = range(9)
BUTTON, VELOCITY, EXPIRED, SOFTWARE = range(1, 5)
NOTHING = (0.0, 0.0, 0.0)

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no C compiler")


def built(folder: Path, *flags: str) -> str:
    library = folder / ("libdrd.so" if flags else "libdhd.so")
    always = ["-std=gnu11", "-O1", "-Wall", "-Wextra", "-shared", "-fPIC"]
    subprocess.run(["gcc", *always, *flags, ROOT / "tests" / "sketch" / "dhd.c", "-o", library, "-lm"], check=True)
    return str(library)


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> str:
    return built(tmp_path_factory.mktemp("drd"), "-DROBOTIC")


@pytest.fixture(scope="module")
def without_robotics(tmp_path_factory: pytest.TempPathFactory) -> str:
    return built(tmp_path_factory.mktemp("dhd"))


def stand_in(library: str) -> ctypes.CDLL:
    stub = ctypes.CDLL(library)
    stub.stub_pass.argtypes = [ctypes.c_double]
    stub.stub_set(0, 0, 0, 0)
    stub.stub_more(1, 0, 1)
    stub.stub_wrist(0)
    stub.stub_grip(0, 0)
    stub.stub_ints(17)
    stub.stub_frame((ctypes.c_double * 9)(1, 0, 0, 0, 1, 0, 0, 0, 1))
    return stub


@pytest.fixture
def stub(library: str) -> ctypes.CDLL:
    return stand_in(library)


@pytest.fixture
def made(library: str, stub: ctypes.CDLL) -> Iterator[ForceDimension]:
    """A device as it is before the sides have met."""
    made = ForceDimension(3, library=library)
    yield made
    made.close()


@pytest.fixture
def device(made: ForceDimension) -> ForceDimension:
    made.home()
    made.begin()
    return made


def test_its_forces_are_enabled_when_control_begins_and_not_before(made: ForceDimension, stub: ctypes.CDLL) -> None:
    """The firmware counts from the last command: a watchdog set long before the first force would disable it."""
    assert (made.watchdog_s, made.force_limit) == (0.02, 12.0)
    assert made.apply((1.0, 0.0, 0.0)) == NOTHING
    assert made.braked() == ""  # nobody has wanted a force yet
    assert [stub.stub_state(what) for what in (OPEN, WATCHDOG, ENABLED)] == [1, 0, 0]
    stub.stub_pass(0.254)
    made.begin()
    stub.stub_pass(0.001)
    assert made.apply((1.0, 0.0, 0.0)) == pytest.approx((1.0, 0.0, 0.0))
    assert [stub.stub_state(what) for what in (WATCHDOG, GRAVITY, ENABLED, BRAKES, ENABLES)] == [160, 1, 1, 0, 1]


def test_after_its_watchdog_the_forces_are_enabled_again(device: ForceDimension, stub: ctypes.CDLL) -> None:
    assert device.apply((1.0, 0.0, 0.0)) == pytest.approx((1.0, 0.0, 0.0))
    stub.stub_pass(0.019)
    device.apply((1.0, 0.0, 0.0))
    assert device.braked() == ""
    stub.stub_pass(0.021)
    assert device.apply((1.0, 0.0, 0.0)) == NOTHING
    assert device.braked() == "its watchdog disabled forces: they are enabled again"
    assert device.apply(NOTHING) == NOTHING
    assert device.braked() == ""
    assert device.apply((1.0, 0.0, 0.0)) == pytest.approx((1.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("cause", "said"),
    [
        (VELOCITY, "faster than its own limit"),
        (SOFTWARE, "a program disabled"),
        (5, "USB"),
        (6, "dead-man"),
        (9, "off"),
    ],
)
def test_forces_that_went_off_for_another_reason_stay_off(
    device: ForceDimension, stub: ctypes.CDLL, cause: int, said: str
) -> None:
    """Who switched them off, switches them on: a button, or a person who looks after it."""
    stub.stub_off(cause)
    for _ in range(3):
        assert device.apply((1.0, 0.0, 0.0)) == NOTHING
        assert said in device.braked()
    assert stub.stub_state(ENABLES) == 1


@pytest.mark.parametrize("count", [12, 14, 15, 16, 17, 32, 64])
def test_any_number_of_status_numbers_is_taken(device: ForceDimension, stub: ctypes.CDLL, count: int) -> None:
    stub.stub_ints(count)
    assert device.apply((1.0, 0.0, 0.0)) == pytest.approx((1.0, 0.0, 0.0))
    stub.stub_off(EXPIRED)
    assert device.apply((1.0, 0.0, 0.0)) == NOTHING
    knows_why = count > 14
    assert device.braked() == (
        "its watchdog disabled forces: they are enabled again" if knows_why else "its forces are off"
    )
    assert stub.stub_state(ENABLED) == knows_why


@pytest.mark.parametrize(("count", "survives"), [(17, True), (64, True), (80, False)])
def test_no_memory_is_touched_beyond(library: str, count: int, survives: bool) -> None:
    """Python's own canaries behind each block say so; that they do is seen with more numbers than there is room for."""
    words = f"""
from hapnet.ext.devices.force_dimension import ForceDimension
device = ForceDimension(1, library={library!r})
device.home()
device.begin()
for _ in range(20):
    device.apply((0.0,))
"""
    environment = os.environ | {"PYTHONMALLOC": "debug", "STUB_INTS": str(count)}
    done = subprocess.run([sys.executable, "-c", words], env=environment, capture_output=True, text=True, cwd=ROOT)
    assert (done.returncode == 0) == survives, done.stderr
    assert ("bad trailing pad byte" in done.stderr) != survives


def test_axes_and_forces_are_in_our_frame(device: ForceDimension, stub: ctypes.CDLL) -> None:
    """Their x is to the user, y to the right: a force to our right and away is (-y, x) of theirs, and comes back so."""
    device.read()
    assert device.apply((1.0, 2.0, 3.0)) == pytest.approx((1.0, 2.0, 3.0))
    theirs = (ctypes.c_double(), ctypes.c_double(), ctypes.c_double())
    stub.dhdGetForce(*map(ctypes.byref, theirs), ctypes.c_byte(0))
    assert [part.value for part in theirs] == pytest.approx([-2.0, 1.0, 3.0])


def test_a_saturated_motors_force_is_told(device: ForceDimension) -> None:
    assert device.apply((0.0, 0.0, 30.0)) == pytest.approx((0.0, 0.0, 12.0))


def test_with_the_force_button_pressed_no_force_is_told_and_then_it_grows(
    device: ForceDimension, stub: ctypes.CDLL
) -> None:
    stub.stub_set(0, 1, 0, 0)
    assert device.apply((1.0, 0.0, 0.0)) == NOTHING
    assert device.braked() == "the force button was pressed: press it again"
    stub.stub_set(0, 0, 0, 0)
    device.apply(NOTHING)
    assert device.braked() == ""


def test_without_power_it_says_so(device: ForceDimension, made: ForceDimension, stub: ctypes.CDLL) -> None:
    stub.stub_more(0, 0, 1)
    assert device.apply((1.0, 0.0, 0.0)) == NOTHING
    assert device.braked() == "it has no power"
    with pytest.raises(HapnetError, match="has no power"):
        made.home()


def test_one_that_fails_is_silent(device: ForceDimension, stub: ctypes.CDLL) -> None:
    stub.stub_set(1, 0, 0, 0)
    with pytest.raises(DeviceSilent, match="gives no reading: no such device"):
        device.read()
    with pytest.raises(DeviceSilent, match="accepts no force"):
        device.apply((0.0, 0.0, 0.0))


def test_one_that_is_not_calibrated_calibrates_itself(made: ForceDimension, stub: ctypes.CDLL) -> None:
    made.home()
    assert stub.stub_state(INITS) == 0
    stub.stub_set(0, 0, 1, 0)
    made.home()
    assert [stub.stub_state(what) for what in (INITS, REGULATING, ENABLED, BRAKES)] == [1, 0, 0, 1]


@pytest.mark.parametrize("unable", ["unsupported", "unwanted"])
def test_or_it_is_calibrated_by_hand(library: str, stub: ctypes.CDLL, unable: str) -> None:
    device = ForceDimension(3, library=library, calibrate=unable != "unwanted")
    stub.stub_more(1, 0, unable != "unsupported")
    stub.stub_set(0, 0, 1, 0)
    with pytest.raises(HapnetError, match="not calibrated: move its handle"):
        device.home()
    assert stub.stub_state(INITS) == 0
    device.close()


def test_without_libdrd_it_is_calibrated_by_hand(without_robotics: str) -> None:
    stub = stand_in(without_robotics)
    device = ForceDimension(3, library=without_robotics)
    stub.stub_set(0, 0, 1, 0)
    with pytest.raises(HapnetError, match="not calibrated: move its handle"):
        device.home()
    stub.stub_set(0, 0, 0, 0)
    device.home()
    device.begin()
    assert device.apply((1.0, 0.0, 0.0)) == pytest.approx((1.0, 0.0, 0.0))
    device.close()


def test_one_that_refuses_its_forces_or_is_locked_says_so(made: ForceDimension, stub: ctypes.CDLL) -> None:
    stub.stub_more(1, 1, 1)
    with pytest.raises(HapnetError, match=r"locks of omega\.6 stand-in are closed"):
        made.home()
    stub.stub_set(0, 0, 1, 0)
    with pytest.raises(HapnetError, match="cannot be set up: no such device"):
        made.begin()


def test_buttons(device: ForceDimension, stub: ctypes.CDLL) -> None:
    stub.stub_set(0, 0, 0, 0b101)
    device.read()
    assert device.buttons() == (True, False, True)


def test_the_wrist_is_told_in_our_frame(device: ForceDimension, stub: ctypes.CDLL) -> None:
    """Turned about their z by 90 degrees is turned about our z by as much; about their y, about our x."""
    half = math.sqrt(0.5)
    stub.stub_frame((ctypes.c_double * 9)(0, -1, 0, 1, 0, 0, 0, 0, 1))
    assert device.orientation() == pytest.approx((half, 0.0, 0.0, half))
    stub.stub_frame((ctypes.c_double * 9)(0, 0, 1, 0, 1, 0, -1, 0, 0))
    assert device.orientation() == pytest.approx((half, half, 0.0, 0.0))


def test_a_wrist_with_motors_renders_torque(library: str, stub: ctypes.CDLL) -> None:
    """A torque about our x is one about their y. Above the motors' limit the library tells what they make."""
    stub.stub_wrist(1)
    device = ForceDimension(3, library=library)
    assert device.apply_wrench is not None
    assert device.apply_wrench((1.0, 0.0, 0.0), (0.1, 0.0, 0.0)) == (NOTHING, NOTHING)  # not begun
    device.home()
    device.begin()
    force, torque = device.apply_wrench((1.0, 2.0, 3.0), (0.1, 0.2, -0.3))
    assert force == pytest.approx((1.0, 2.0, 3.0))
    assert torque == pytest.approx((0.1, 0.2, -0.3))
    theirs = [ctypes.c_double() for _ in range(6)]
    stub.dhdGetForceAndTorque(*map(ctypes.byref, theirs), ctypes.c_byte(0))
    assert [part.value for part in theirs] == pytest.approx([-2.0, 1.0, 3.0, -0.2, 0.1, -0.3])
    assert device.apply_wrench(NOTHING, (0.0, 0.0, 1.0))[1] == pytest.approx((0.0, 0.0, 0.4))
    stub.stub_off(EXPIRED)
    assert device.apply_wrench((1.0, 0.0, 0.0), (0.1, 0.0, 0.0)) == (NOTHING, NOTHING)
    assert device.braked() == "its watchdog disabled forces: they are enabled again"
    stub.stub_set(1, 0, 0, 0)
    with pytest.raises(DeviceSilent, match="accepts no force"):
        device.apply_wrench(NOTHING, NOTHING)
    stub.stub_set(0, 0, 0, 0)
    device.close()


def test_a_tools_pose_moves_and_feels_it(library: str, stub: ctypes.CDLL) -> None:
    """The force along a pose's coordinates does the work of its wrench on a small motion; a wrist without motors gets
    the force alone."""
    device = ForceDimension(3, library=library)
    posed = Posed(device, "dhd")
    assert not posed.gives_torque
    device.close()
    stub.stub_wrist(1)
    device = ForceDimension(3, library=library)
    device.home()
    device.begin()
    posed = Posed(device, "dhd")
    assert posed.gives_torque
    posed.read()
    wanted = along_coordinates(coordinates(NOTHING, (1.0, 0.0, 0.0, 0.0)), (0.5, 0.0, 1.0), (0.02, -0.03, 0.04), ARM_M)
    applied = posed.apply(wanted)
    assert applied == pytest.approx(wanted, abs=1e-9)
    device.close()


@pytest.mark.parametrize("left", [0, 1])
def test_its_grip_is_the_last_axis(left: int, library: str, stub: ctypes.CDLL) -> None:
    """Opening counts positive for both hands; the library's force and velocity are negative for a left one."""
    stub.stub_grip(1, left)
    device = ForceDimension(3, library=library, axes="xz", jaw=True)
    assert (device.jaw, device.force_limit, device.workspace) == (True, 8.0, (0.12, 0.12, 0.03))
    assert device.apply((0.0, 0.0, 1.0)) == NOTHING  # not begun
    device.home()
    device.begin()
    assert device.read()[0][2] == pytest.approx(0.025, abs=1e-3)
    assert device.apply((1.0, 3.0, 2.0)) == pytest.approx((1.0, 3.0, 2.0))
    theirs = [ctypes.c_double() for _ in range(7)]
    stub.dhdGetForceAndTorqueAndGripperForce(*map(ctypes.byref, theirs), ctypes.c_byte(0))
    assert [theirs[k].value for k in (0, 1, 2, 6)] == pytest.approx([0.0, 1.0, 3.0, -2.0 if left else 2.0])
    stub.stub_pass(0.015)
    x, v = device.read()
    assert x[2] > 0.0251, "the force opens it"
    assert v[2] > 0.01
    assert device.apply((0.0, 0.0, -20.0)) == pytest.approx((0.0, 0.0, -8.0)), "its motor is saturated"
    stub.stub_off(EXPIRED)
    assert device.apply((0.0, 0.0, 1.0)) == NOTHING
    device.close()


def test_a_device_without_a_grip_says_so(library: str, stub: ctypes.CDLL) -> None:
    with pytest.raises(HapnetError, match=r"omega\.6 stand-in has no grip with motors: leave out jaw=yes"):
        ForceDimension(4, library=library, jaw=True)
    assert stub.stub_state(OPEN) == 0
    stub.stub_grip(1, 0)
    with pytest.raises(InvalidParameter, match="without jaw=, for a scene with a tool"):
        Posed(ForceDimension(3, library=library, jaw=True), "dhd")
    assert stub.stub_state(OPEN) == 0


def test_an_older_library_without_grips_says_so(library: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(force_dimension._OPTIONAL, "dhdHasActiveGripper")
    plain = force_dimension._load

    class Older:
        def __init__(self, library: str) -> None:
            self.found = plain(library)

        def __getattr__(self, name: str) -> object:
            if "Gripper" in name:
                raise AttributeError(name)
            return getattr(self.found, name)

    monkeypatch.setattr(force_dimension, "_load", Older)
    with pytest.raises(HapnetError, match="no grip with motors"):
        ForceDimension(4, library=library, jaw=True)


def test_at_the_end_it_is_stopped_and_closed(device: ForceDimension, stub: ctypes.CDLL) -> None:
    device.close()
    device.close()
    assert (stub.stub_state(STOPPED), stub.stub_state(OPEN)) == (1, 0)


def test_what_is_not_there_is_named(library: str) -> None:
    with pytest.raises(HapnetError, match=r"no device 3 of Force Dimension: .* \(1 connected\)"):
        ForceDimension(1, number=3, library=library)
    with pytest.raises(InvalidParameter, match="0 to 15"):
        ForceDimension(1, number=99, library=library)
    with pytest.raises(HapnetError, match="is no libdhd"):
        ForceDimension(1, library="/dev/null")


@pytest.mark.slow
@pytest.mark.parametrize("library_says", [{}, {"STUB_INTS": "64", "STUB_OFF": f"4:{EXPIRED}"}])
def test_a_run_with_the_stand_in(library: str, library_says: dict[str, str], tmp_path: Path) -> None:
    device = f"dhd:library={library}"
    argv = ("run", "--device", device, "--duration", 6, "--json", "-", "--out", tmp_path / "run")
    with started(*argv, env=library_says) as program:
        code, stdout, stderr = program.end()
    assert code == 0, stderr
    if library_says:
        assert "its watchdog disabled forces" in stderr
        assert "renders force again" in stderr
    summary = json.loads(stdout)
    assert_passive(summary)
    assert summary["device"]["force"] == "applied"
    assert summary["motion"]["contacts"] >= 1
    assert summary["motion"]["peak_force_N"] > 0.3


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["grip:soft?size=15mm&gap=10mm", "free + grip:hard?size=15mm&gap=10mm"])
def test_a_run_in_which_its_grip_closes_on_an_object(scene: str, library: str, tmp_path: Path) -> None:
    argv = ("run", "--device", f"dhd:library={library},jaw=yes", "--scene", scene, "--duration", 6, "--json", "-")
    with started(*argv, "--link", "4g", "--out", tmp_path / "run", env={"STUB_GRIP": "1"}) as program:
        code, stdout, stderr = program.end()
    assert code == 0, stderr
    summary = json.loads(stdout)
    assert_passive(summary)
    assert summary["motion"]["contacts"] >= 1
    assert summary["motion"]["peak_force_N"] > 0.3


@pytest.mark.parametrize("wrist", mostly_slow([0, 1], 0, 1))
def test_a_run_with_a_tool_says_whether_there_is_torque(wrist: int, library: str, tmp_path: Path) -> None:
    argv = ("run", "--device", f"dhd:library={library}", "--scene", "tool:box", "--duration", 4, "--json", "-")
    with started(*argv, "--out", tmp_path / "run", env={"STUB_WRIST": str(wrist)}) as program:
        code, stdout, stderr = program.end()
    assert code == 0, stderr
    assert_passive(json.loads(stdout))
    assert ("has no torque: the tool's force is rendered alone" in stderr) == (wrist == 0)
