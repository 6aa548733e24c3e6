"""Devices from outside: whatever their code does ends as one line that names them."""

import math
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet.assembly.build import device_session, device_side, prepare
from hapnet.assembly.device_class import load_class
from hapnet.assembly.user_device import UserDevice
from hapnet.checks import Vector
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.operator import Impedance, Rest
from hapnet.recording.samples import Event, Sample
from hapnet.side.endpoint import DeviceEndpoint
from hapnet.side.sampled_device import SampledDeviceSide
from hapnet.simulation.simulation import simulate
from hapnet.summary.run import device_summary
from tests.support.paper import PAPER


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
        ("Nothing", "gave None instead of position and velocity"),
        ("Limitless", "force_limit is -1"),
        ("OtherAxes", "3 degrees of freedom"),
        ("Path", "the class Path has no method read"),
    ],
)
def test_a_device_that_cannot_be_is_named_with_the_cause(name: str, says: str) -> None:
    with pytest.raises(InvalidParameter) as caught:
        UserDevice(f"tests.assembly.test_user_device:{name}", 3)
    assert re.match(rf"hardware (is ')?tests.assembly.test_user_device:{name}\b", str(caught.value))
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
    assert load_class("tests.assembly.test_user_device:Absent") is Absent


def test_a_driver_that_fails_while_running_is_named() -> None:
    device = UserDevice("tests.assembly.test_user_device:Unplugged", 1)
    device.device.plugged = False
    with pytest.raises(
        HapnetError, match=r"^the device tests\.assembly\.test_user_device:Unplugged failed.*OSError: unplugged"
    ):
        device.read()
    with pytest.raises(
        HapnetError, match=r"^the device tests\.assembly\.test_user_device:Unplugged failed.*overcurrent"
    ):
        device.apply((0.0,))


def test_a_device_that_works_is_passed_through() -> None:
    device = UserDevice("tests.assembly.test_user_device:Still", 2)
    assert (device.dof, device.force_limit, device.resolution) == (2, 2.0, 1e-5)
    device.apply((0.5, -0.5))
    assert device.device.held == (0.5, -0.5)
    position, velocity = UserDevice("tests.assembly.test_user_device:InArrays", 2).read()
    assert (position, velocity) == ((0.25, 0.25), (0.0, 0.0))
    assert all(type(value) is float for value in (*position, *velocity))


class Turned(Still):
    """Tells how its handle is turned, and takes signals."""

    def __init__(self, dof: int) -> None:
        super().__init__(dof)
        self.turned: Vector | None = None
        self.heard: list[tuple[str, object]] = []

    def orientation(self) -> Vector | None:
        return self.turned

    def signal(self, name: str, value: object) -> None:
        self.heard.append((name, value))


def test_how_a_handle_is_turned_is_a_unit_quaternion_and_signals_are_handed_on() -> None:
    device = UserDevice("tests.assembly.test_user_device:Turned", 1)
    assert isinstance(device.device, Turned)
    for turned in (None, (0.6, 0.0, -0.8, 0.0)):
        device.device.turned = turned
        assert device.orientation() == turned
    for wrong in ((0.6, 0.8), (0.6, 0.0, 0.0, 0.0), (2.0, 0.0, 0.0, 0.0)):
        device.device.turned = wrong
        with pytest.raises(HapnetError, match="a unit quaternion w, x, y, z, or None"):
            device.orientation()
    device.signal("colour", 2.0)
    assert device.device.heard == [("colour", 2.0)]
    mute = UserDevice("tests.assembly.test_user_device:Still", 1)
    mute.signal("colour", 2.0)
    assert mute.orientation() is None


@pytest.mark.parametrize("name", ["Still", "Simulated"])
def test_a_side_is_made_around_it(name: str) -> None:
    params = PAPER.set({"scene": "free", "dof": 2, "hardware": f"tests.assembly.test_user_device:{name}"})
    setup = prepare(params, "sampled")
    side = device_side(setup, DeviceEndpoint(device_session(setup, 1)), lambda: 0, lambda sample: None)
    assert side.device.dof == 2
    assert isinstance(side.device, SimulatedDevice) == (name == "Simulated")  # the side advances what is simulated


class PulledOut(Still):
    """Can be read once: when it is made."""

    def __init__(self, dof: int) -> None:
        super().__init__(dof)
        self.reads = 0

    def read(self) -> tuple[Vector, Vector]:
        self.reads += 1
        if self.reads > 1:
            raise OSError("the cable is out")
        return super().read()


def test_one_that_fails_right_after_pairing_says_so_and_ends_in_order() -> None:
    setup = prepare(PAPER.set({"scene": "free", "hardware": "tests.assembly.test_user_device:PulledOut"}), "sampled")
    side = device_side(setup, DeviceEndpoint(device_session(setup, 1)), lambda: 0, lambda sample: None)
    side.endpoint.paired = True
    with pytest.raises(HapnetError, match=r"PulledOut failed: read\(\) raised OSError: the cable is out"):
        side.tick(0)
    side.stop()
    assert side.device.device.held == (0.0,)
    assert device_summary(side, "pspm")["quantisation_J"] is None


def test_its_coupling_is_checked_before_pairing() -> None:
    params = PAPER.set({"scene": "free", "dof": 2, "hardware": "tests.assembly.test_user_device:Still"})
    with pytest.raises(InvalidParameter, match=r"^device\.stiffness is"):
        prepare(params.set({"device.stiffness": ((1, 2), (2, 1))}), "sampled")


class Telling:
    """Tells what it applies: half of what it is asked for; its handle is heavy and slow."""

    dof, force_limit, resolution, greatest_speed, smallest_mass = 1, 2.0, 0.0, 0.3, 0.2

    def __init__(self, dof: int) -> None:
        self.x = 0.0

    def read(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        return (self.x,), (0.0,)

    def apply(self, force: Vector) -> object:
        return [0.5 * component for component in force]


class TellingNonsense(Telling):
    def apply(self, force: Vector) -> object:
        return (math.nan,)


class Silent(Telling):
    def apply(self, force: Vector) -> object:
        return None


class Light(Telling):
    greatest_speed, smallest_mass = 5.0, 0.001


class Unweighed(Telling):
    smallest_mass = None


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Telling", []),
        # B T/2 = 0.02 kg; 5 m/s for 21 ms
        ("Light", ["at up to 5 m/s", "this device has 0.001 kg"]),
        ("Unweighed", ["it declares no smallest_mass"]),
    ],
)
def test_what_it_declares_is_what_is_warned_of(name: str, words: list[str]) -> None:
    changes = {"scene": "free", "hardware": f"tests.assembly.test_user_device:{name}", "device.damping": 40.0}
    setup = prepare(PAPER.set({**changes, "device.ceiling_J": 10.0 if name != "Light" else 0.05}), "sampled")
    reported: list[str] = []

    def write(sample: Sample) -> None:
        assert isinstance(sample, Event)
        reported.append(sample.text)

    device_side(setup, DeviceEndpoint(device_session(setup, 1)), lambda: 0, write)
    assert setup.warnings == ()
    assert [word in text for word, text in zip(words, reported, strict=True)] == [True] * len(words)


def driven(name: str) -> SampledDeviceSide:
    """A side around the device, paired, with a set-position 10 mm off; 10 ticks, the handle going 0.1 mm in each."""
    words = {"device.damping": 1e-9, "device.step_limit_N": 0.0, "device.force_ramp_s": 0.0, "device.self_test_N": 0.0}
    params = PAPER.set({"scene": "free", "hardware": f"tests.assembly.test_user_device:{name}", **words})
    setup = prepare(params, "sampled")
    now_ns = 0
    side = device_side(setup, DeviceEndpoint(device_session(setup, 1)), lambda: now_ns, lambda sample: None)
    assert isinstance(side, SampledDeviceSide)
    device = side.device.device  # type: ignore[attr-defined]  # the user's, inside
    side.endpoint.paired = True
    side.tick(0)
    side.coupling.receive((0.01,), 0.0, 0.0)
    for _ in range(10):
        device.x += 1e-4
        now_ns += 1_000_000
        side.tick(now_ns)
    return side


def test_what_the_device_applied_is_what_the_account_counts() -> None:
    """Asked for 100 N/m (10 mm - k 0.1 mm), of which half is applied: W is minus their sum times 0.1 mm."""
    side = driven("Telling")
    asked = [100.0 * (0.01 - 1e-4 * k) for k in range(1, 10)]
    assert side.coupling.ledger.work == pytest.approx(-sum(0.5 * force * 1e-4 for force in asked), rel=1e-6)
    assert side.coupling.ledger.slack == pytest.approx(0.0, abs=1e-15)
    part = device_summary(side, "pspm")
    assert part["force"] == "applied"
    assert part["speed_limit_mps"] == 0.3
    assert part["speed_max_mps"] == pytest.approx(0.1)


def test_a_device_that_does_not_tell_is_counted_as_commanded() -> None:
    side = driven("Silent")
    asked = [100.0 * (0.01 - 1e-4 * k) for k in range(1, 10)]
    assert side.coupling.ledger.work == pytest.approx(-sum(force * 1e-4 for force in asked), rel=1e-6)
    assert device_summary(side, "pspm")["force"] == "commanded"


def test_a_device_that_applies_nonsense_is_named() -> None:
    with pytest.raises(
        HapnetError, match=r"^the device tests\.assembly\.test_user_device:TellingNonsense failed: apply\(\) gave"
    ):
        driven("TellingNonsense")


def test_a_motor_connected_the_wrong_way_round_is_seen_and_rationed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A torque against the spring is energy for the hand, and nothing that is counted as commanded shows it.

    W of the forces that were really held, over the true positions, is what the summary says; and it stays within d^2.
    """
    applied: list[tuple[Vector, Vector]] = []
    apply = SimulatedDevice.apply

    def reversed_(device: SimulatedDevice, force: Vector) -> Vector:
        applied.append((device.position, tuple(-component for component in force)))
        return apply(device, applied[-1][1])

    monkeypatch.setattr(SimulatedDevice, "apply", reversed_)
    result = simulate(
        PAPER.set({"device.servo": "sampled", "operator": "sine", "scene": "free", "duration_s": 3.0}),
        seed=2,
        kernel=False,
    )
    work = -sum(
        sum(f * (b - a) for f, a, b in zip(force, before, after, strict=True))
        for (before, force), (after, _) in pairwise(applied)
    )
    ledger = result.summary["device"]["ledger"]
    assert ledger["work_J"] == pytest.approx(work, abs=1e-9)
    assert work < -0.01  # the hand was given energy
    assert ledger["margin_J"] >= 0.0
    assert result.summary["hand"]["margin_J"] >= 0.0
    assert abs(ledger["slack_J"]) <= 1e-9


class Jawed(Still):
    jaw = True


def test_a_scene_with_a_jaw_needs_a_device_with_one() -> None:
    here = "tests.assembly.test_user_device:"
    assert UserDevice(here + "Jawed", 2, jaw=True).read()
    assert UserDevice(here + "Jawed", 2).read(), "to measure it alone"
    with pytest.raises(InvalidParameter, match="Still'; allowed: a device with a jaw, the scene's last axis"):
        UserDevice(here + "Still", 2, jaw=True)
    with pytest.raises(InvalidParameter, match="Jawed'; allowed: a device without a jaw, as the scene has none"):
        UserDevice(here + "Jawed", 2, jaw=False)
