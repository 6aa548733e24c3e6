"""Devices from outside: whatever their code does ends as one line that names them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet.checks import Vector
from hapnet.endpoint import DeviceEndpoint
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.params import Params
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.operator import Impedance, Rest
from hapnet.runtime.build import device_session, device_side, prepare
from hapnet.runtime.own_device import OwnDevice, load_class


class Still:
    """A device that stands at the origin."""

    force_limit: float | None = 2.0
    resolution = 1e-5

    def __init__(self, dof: int) -> None:
        self.dof = dof
        self.held: Vector = ()

    def read(self) -> tuple[Vector, Vector]:
        return (0.0,) * self.dof, (0.0,) * self.dof

    def apply(self, force: Vector) -> None:
        self.held = force


class Absent(Still):
    def __init__(self, dof: int) -> None:
        raise OSError("no such device:\n/dev/ttyACM7")


class Unplugged(Still):
    """Works until it is pulled out."""

    plugged = True

    def read(self) -> tuple[Vector, Vector]:
        if not self.plugged:
            raise OSError("unplugged")
        return super().read()

    def apply(self, force: Vector) -> None:
        raise RuntimeError("overcurrent")


class TwoAxes(Still):
    def read(self) -> tuple[Vector, Vector]:
        return (0.0,) * 2, (0.0,) * 2


class NotANumber(Still):
    def read(self) -> tuple[Vector, Vector]:
        return (math.nan,) * self.dof, (0.0,) * self.dof


class Nothing(Still):
    def read(self) -> Any:
        return None


class Limitless(Still):
    force_limit = -1.0


class OtherAxes(Still):
    def __init__(self, dof: int) -> None:
        super().__init__(dof + 1)


class InArrays(Still):
    """Numpy's arrays are what drivers give."""

    def read(self) -> Any:
        return np.full(self.dof, 0.25), np.zeros(self.dof)


class Simulated(SimulatedDevice):
    def __init__(self, dof: int) -> None:
        super().__init__(Rest(dof, Impedance(0.5, 6.0, 100.0), (0.0,) * dof))


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("Absent", "OSError: no such device: /dev/ttyACM7"),
        ("TwoAxes", "3 finite numbers"),
        ("NotANumber", "nan"),
        ("Nothing", "TypeError"),
        ("Limitless", "force_limit is -1"),
        ("OtherAxes", "3 degrees of freedom"),
        ("Path", "dof"),
    ],
)
def test_a_device_that_cannot_be_is_named_with_the_cause(name: str, says: str) -> None:
    with pytest.raises(InvalidParameter) as caught:
        OwnDevice(f"tests.test_own_device:{name}", 3)
    assert str(caught.value).startswith(f"hardware is 'tests.test_own_device:{name}'")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_module_that_is_not_python_is_named_with_the_cause(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "broken_driver.py").write_text("def (:\n", "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InvalidParameter, match=r"^hardware is 'broken_driver:Arm'.*SyntaxError"):
        load_class("broken_driver:Arm")


def test_what_is_no_class_is_refused() -> None:
    for name in ("math:pi", "math", ":x"):
        with pytest.raises(InvalidParameter, match="module:Class"):
            load_class(name)


def test_loading_the_class_does_not_make_it() -> None:
    assert load_class("tests.test_own_device:Absent") is Absent


def test_a_driver_that_fails_while_running_is_named() -> None:
    device = OwnDevice("tests.test_own_device:Unplugged", 1)
    assert isinstance(device.device, Unplugged)
    device.device.plugged = False
    with pytest.raises(HapnetError, match=r"^the device tests\.test_own_device:Unplugged failed.*OSError: unplugged"):
        device.read()
    with pytest.raises(HapnetError, match=r"^the device tests\.test_own_device:Unplugged failed.*overcurrent"):
        device.apply((0.0,))


def test_a_device_that_works_is_passed_through() -> None:
    device = OwnDevice("tests.test_own_device:Still", 2)
    assert (device.dof, device.force_limit, device.resolution) == (2, 2.0, 1e-5)
    device.apply((0.5, -0.5))
    assert isinstance(device.device, Still)
    assert device.device.held == (0.5, -0.5)
    position, velocity = OwnDevice("tests.test_own_device:InArrays", 2).read()
    assert (position, velocity) == ((0.25, 0.25), (0.0, 0.0))
    assert all(type(value) is float for value in (*position, *velocity))


@pytest.mark.parametrize("name", ["Still", "Simulated"])
def test_a_side_is_made_around_it(name: str) -> None:
    params = Params().set({"scene": "free", "dof": 2, "hardware": f"tests.test_own_device:{name}"})
    setup = prepare(params, "sampled")
    side = device_side(setup, DeviceEndpoint(device_session(setup, 1)), lambda: 0, lambda sample: None)
    assert side.device.dof == 2
    assert isinstance(side.device, SimulatedDevice) == (name == "Simulated")  # the side advances what is simulated


def test_its_coupling_is_checked_before_pairing() -> None:
    params = Params().set({"scene": "free", "dof": 2, "hardware": "tests.test_own_device:Still"})
    setup = prepare(params.set({"device.stiffness": ((1, 2), (2, 1))}), "sampled")
    with pytest.raises(InvalidParameter, match=r"^device\.stiffness is"):
        device_side(setup, DeviceEndpoint(device_session(setup, 1)), lambda: 0, lambda sample: None)
