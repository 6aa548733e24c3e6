"""The driver of Force Dimension's devices, with a stand-in of the maker's library that is compiled here."""

from __future__ import annotations

import ctypes
import json
import math
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from hapnet.devices.force_dimension import _FUNCTIONS, ForceDimension, _quaternion
from hapnet.errors import DeviceSilent, HapnetError, InvalidParameter
from tests.conftest import ROOT
from tests.processes import assert_passive, started

OPEN, WATCHDOG, GRAVITY, ENABLED, STOPPED = range(5)

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no C compiler")


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> str:
    library = tmp_path_factory.mktemp("dhd") / "libdhd.so"
    flags = ["-std=gnu11", "-O1", "-Wall", "-Wextra", "-shared", "-fPIC"]
    subprocess.run(["gcc", *flags, ROOT / "tests" / "sketch" / "dhd.c", "-o", library, "-lm"], check=True)
    return str(library)


@pytest.fixture
def stub(library: str) -> ctypes.CDLL:
    stub = ctypes.CDLL(library)
    stub.stub_set(0, 0, 0, 0)
    stub.stub_frame((ctypes.c_double * 9)(1, 0, 0, 0, 1, 0, 0, 0, 1))
    return stub


@pytest.fixture
def device(library: str, stub: ctypes.CDLL) -> Iterator[ForceDimension]:
    device = ForceDimension(3, library=library)
    yield device
    device.close()


def test_it_is_set_up_with_a_watchdog_of_20_ms(device: ForceDimension, stub: ctypes.CDLL) -> None:
    assert [stub.stub_state(what) for what in (OPEN, WATCHDOG, GRAVITY, ENABLED)] == [1, 160, 1, 1]
    assert (device.watchdog_s, device.force_limit) == (0.02, 12.0)
    assert len(_FUNCTIONS) <= 20


def test_axes_and_forces_are_in_our_frame(device: ForceDimension, stub: ctypes.CDLL) -> None:
    """Their x is to the user, y to the right: a force to our right and away is (-y, x) of theirs, and comes back so."""
    device.read()
    assert device.apply((1.0, 2.0, 3.0)) == pytest.approx((1.0, 2.0, 3.0))
    theirs = (ctypes.c_double(), ctypes.c_double(), ctypes.c_double())
    stub.dhdGetForce(*map(ctypes.byref, theirs), ctypes.c_byte(0))
    assert [part.value for part in theirs] == pytest.approx([-2.0, 1.0, 3.0])


def test_a_saturated_motors_force_is_told(device: ForceDimension) -> None:
    assert device.apply((0.0, 0.0, 30.0)) == pytest.approx((0.0, 0.0, 12.0))


def test_with_the_brake_on_no_force_is_told_and_then_it_grows(device: ForceDimension, stub: ctypes.CDLL) -> None:
    stub.stub_set(0, 1, 0, 0)
    assert device.apply((1.0, 0.0, 0.0)) == (0.0, 0.0, 0.0)
    assert device.braked() == "its brake is on"
    stub.stub_set(0, 0, 0, 0)
    device.apply((0.0, 0.0, 0.0))
    assert device.braked() == ""


def test_one_that_fails_is_silent(device: ForceDimension, stub: ctypes.CDLL) -> None:
    stub.stub_set(1, 0, 0, 0)
    with pytest.raises(DeviceSilent, match="gives no reading: no such device"):
        device.read()
    with pytest.raises(DeviceSilent, match="takes no force"):
        device.apply((0.0, 0.0, 0.0))


def test_one_that_is_not_calibrated_says_so(device: ForceDimension, stub: ctypes.CDLL) -> None:
    device.home()
    stub.stub_set(0, 0, 1, 0)
    with pytest.raises(HapnetError, match="not calibrated"):
        device.home()


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


@pytest.mark.parametrize("angle", [0.0, 0.3, math.pi / 2, 3.0, math.pi])
@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 0.6, 0.8), (2 / 3, -1 / 3, 2 / 3)])
def test_a_quaternion_is_that_of_its_rotation(axis: tuple[float, float, float], angle: float) -> None:
    """Rodrigues' formula makes the matrix."""
    x, y, z = axis
    c, s = math.cos(angle), math.sin(angle)
    rows = [
        [c + x * x * (1 - c), x * y * (1 - c) - z * s, x * z * (1 - c) + y * s],
        [y * x * (1 - c) + z * s, c + y * y * (1 - c), y * z * (1 - c) - x * s],
        [z * x * (1 - c) - y * s, z * y * (1 - c) + x * s, c + z * z * (1 - c)],
    ]
    found = _quaternion(rows)
    expected = (math.cos(angle / 2), *(math.sin(angle / 2) * part for part in axis))
    sign = 1.0 if sum(a * b for a, b in zip(found, expected, strict=True)) > 0.0 else -1.0
    assert [sign * part for part in found] == pytest.approx(expected, abs=1e-12)


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
def test_a_run_with_the_stand_in(library: str, tmp_path: Path) -> None:
    device = f"dhd:library={library}"
    with started("run", "--device", device, "--duration", 4, "--json", "-", "--out", tmp_path / "run") as program:
        code, stdout, stderr = program.end()
    assert code == 0, stderr
    summary = json.loads(stdout)
    assert_passive(summary)
    assert summary["device"]["force"] == "applied"
    assert summary["motion"]["contacts"] >= 1
    assert summary["motion"]["peak_force_N"] > 0.3
