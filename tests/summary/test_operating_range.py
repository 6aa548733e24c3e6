"""Metres and millimetres: what a device, a recorded hand or a parameter says is checked against its operating range."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from hapnet.assembly.build import device_session, device_side, prepare
from hapnet.assembly.device_class import declared_range
from hapnet.assembly.operators import UserOperator, operator
from hapnet.assembly.user_device import UserDevice
from hapnet.checks import Vector
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.params import DeviceParams
from hapnet.plant.operating_range import OperatingRange, RangeWatch
from hapnet.plant.operator import Impedance
from hapnet.recording.samples import DeviceSample, Event, Sample
from hapnet.side.device import DeviceSide
from hapnet.side.endpoint import DeviceEndpoint
from hapnet.summary.run import device_summary, unknown_device
from hapnet.summary.verdict import incomplete, judge
from tests.conftest import mostly_slow
from tests.support.paper import PAPER
from tests.support.processes import read_json, started

MS = 1_000_000
PARAMS = PAPER


class Arm:
    """Stands where it is put, on one axis; a class to declare more in."""

    force_limit, resolution = 3.0, 1e-5

    def __init__(self, dof: int) -> None:
        self.dof = dof
        self.x, self.v = 0.0, 0.0
        self.held: Vector = ()

    def read(self) -> tuple[Vector, Vector]:
        return (self.x,) + (0.0,) * (self.dof - 1), (self.v,) * self.dof

    def apply(self, force: Vector) -> None:
        self.held = force


class Millimetres(Arm):
    workspace = (160.0, 120.0, 120.0)


class Short(Arm):
    workspace = 0.1
    greatest_speed = 1.0


class PerAxis(Arm):
    workspace = (0.1, 0.02)


class PerSecond(Arm):
    greatest_speed = 1000.0


class Soft(Arm):
    stiffness_range = (0.0, 80.0)


class NewtonsPerMillimetre(Arm):
    stiffness_range = (0.0, 3.0)


class Away(Arm):
    def __init__(self, dof: int) -> None:
        super().__init__(dof)
        self.x = 30.0


class FarHand:
    def __init__(self, dof: int, impedance: Impedance) -> None:
        self.impedance = impedance

    def reference(self, t: float) -> Vector:
        return (30.0 * t,)


def named(device: type) -> str:
    return f"{__name__}:{device.__name__}"


# -- at the start ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("device", "dof", "says"),
    [
        (Millimetres, 3, "workspace is (160.0, 120.0, 120.0); allowed: 0.001 to 10 m"),
        (PerAxis, 3, "workspace is (0.1, 0.02)"),
        (PerSecond, 1, "greatest_speed is 1000.0; allowed: 0.01 to 100 m/s"),
        (NewtonsPerMillimetre, 1, "stiffness_range is (0.0, 3.0)"),
        (Away, 1, "it reads 30 m from its origin, its workspace ends at 2 m (are these millimetres?)"),
    ],
)
def test_a_device_that_is_not_in_metres_is_refused_in_one_line(device: type, dof: int, says: str) -> None:
    with pytest.raises(InvalidParameter) as caught:
        UserDevice(named(device), dof)
    assert str(caught.value).startswith(f"hardware is '{named(device)}'; allowed: ")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_a_device_declares_holds_and_else_the_parameters() -> None:
    params = DeviceParams(workspace_m=0.5, stiffness_range=(10.0, 1000.0))
    assert UserDevice(named(Short), 1, params).declared == OperatingRange((0.1,), 1.0, (10.0, 1000.0))
    assert UserDevice(named(PerAxis), 2, params).declared.workspace == (0.1, 0.02)
    assert UserDevice(named(Soft), 1, params).declared.stiffness == (0.0, 80.0)
    assert UserDevice(named(Arm), 1, params).declared.workspace == (0.5,)


@pytest.mark.parametrize(
    ("device", "given", "says"),
    [
        (Soft, {}, r"0 to 80 N/m in every direction, as the device renders"),
        (Arm, {"device.stiffness_range": (1.0, 80.0)}, r"1 to 80 N/m in .* renders \(device\.stiffness_range\)"),
    ],
)
def test_a_stiffness_that_a_device_does_not_render_is_refused(device: type, given: dict[str, Any], says: str) -> None:
    """Only what the user can change is named: the parameter that a driver without a range of its own goes by."""
    setup = prepare(PARAMS.set({"hardware": named(device), "scene": "free", **given}))
    with pytest.raises(InvalidParameter, match=rf"^device\.stiffness is 100\.0; allowed: {says}$"):
        device_side(setup, DeviceEndpoint(device_session(setup, 1)), lambda: 0, lambda sample: None)


@pytest.mark.parametrize(
    "changes",
    [
        {"operator_model.goal_m": 40.0},
        {"operator_model.start_m": -30.0},
        {"operator_model.amplitude_m": 30.0},
        {"operator_model.press_depth_m": 8.0},
        {"operator_model.hover_m": 6.0},
        {"world.wall.position_m": 20.0},
        {"world.wall.half_width_m": 30.0},
        {"device.resolution_m": 0.055},
        {"device.workspace_m": 100.0},
        {"device.stiffness": 0.1},  # N/mm
        {"device.stiffness": 573_000.0},
        {"device.stiffness_range": (0.1, 3.0)},
        {"device.stiffness_range": (3.0, 0.5)},
        {"tdpa.speed_limit": 250.0},
    ],
    ids=str,
)
def test_parameters_a_thousand_times_too_large_or_small_are_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(InvalidParameter) as caught:
        prepare(PARAMS.set(changes))
    assert str(caught.value).startswith(next(iter(changes)))


def test_the_stiffness_counts_in_every_direction() -> None:
    """Eigenvalues of [[100, 60], [60, 100]]: 40 and 160."""
    K = ((100.0, 60.0), (60.0, 100.0))
    for allowed, fits in (((39.0, 161.0), True), ((41.0, 161.0), False), ((39.0, 159.0), False)):
        params = PARAMS.set({"scene": "free", "dof": 2, "device.stiffness": K, "device.stiffness_range": allowed})
        if fits:
            prepare(params)
        else:
            with pytest.raises(InvalidParameter, match=r"^device\.stiffness is"):
                prepare(params)


@pytest.mark.parametrize("scale", [1.0, 1e3, 1e-3])
def test_a_recorded_hand_is_in_metres(scale: float, tmp_path: Path) -> None:
    """A circle of 30 mm, in m, in mm and in km."""
    t = np.arange(0.0, 3.0, 0.01)
    columns = np.column_stack([t, scale * 0.03 * np.cos(t), scale * 0.03 * np.sin(t)])
    file = tmp_path / "hand.csv"
    np.savetxt(file, columns, delimiter=",", header="time_s,x_m,y_m", comments="")
    params = PARAMS.set({"scene": "free", "dof": 2, "operator": str(file)})
    if scale == 1.0:
        operator(params, prepare(params).scene)
        return
    with pytest.raises(
        InvalidParameter, match="are these millimetres" if scale > 1.0 else "is their unit right"
    ) as caught:
        operator(params, prepare(params).scene)
    assert str(caught.value).startswith(f"operator is '{file}'; allowed: positions in m")


def test_a_hand_of_ones_own_is_named_when_it_goes_out_of_reach() -> None:
    hand = UserOperator(named(FarHand), 1, Impedance(), 2.0)
    assert hand.reference(0.05) == (1.5,)
    with pytest.raises(
        HapnetError, match=r"FarHand failed: reference\(0\.1\) gave \(3\.0,\) instead of a place within"
    ):
        hand.reference(0.1)


# -- while it runs -----------------------------------------------------------------------------------------------------


def begun(device: type, **changes: object) -> tuple[DeviceSide, Arm, list[Sample]]:
    """A side whose device pulls at its spring: control has started at 0, and the set-position lies 20 mm away."""
    written: list[Sample] = []
    given = {
        "hardware": named(device), "scene": "free", "record_hz": 1000.0, "device.force_ramp_s": 0.0,
        "device.self_test_N": 0.0, **changes,
    }  # fmt: skip
    setup = prepare(PARAMS.set({name.replace("__", "."): value for name, value in given.items()}))
    clock = [0]
    side = device_side(setup, DeviceEndpoint(device_session(setup, 1)), lambda: clock[0], written.append)
    side.endpoint.pair(False)
    side.clock = clock  # type: ignore[attr-defined]
    side.tick(0)
    if changes.get("coupling", "pspm") in ("pspm", "zoh"):
        side.endpoint.on_sample((0.02,), 0, 0, 0)
    arm = side.device.device
    return side, arm, written


def tick(side: DeviceSide, at_ms: int) -> None:
    side.clock[0] = at_ms * MS  # type: ignore[attr-defined]
    side.tick(at_ms * MS)


@pytest.mark.parametrize("coupling", ["pspm", "zoh", "tdpa", "wave"])
def test_a_device_that_leaves_its_workspace_renders_no_force_any_more_and_says_why(coupling: str) -> None:
    """The reading that cannot be moves no energy: 30 m at 0.4 N would be 12 J."""
    side, arm, written = begun(Arm, coupling=coupling)
    for at in range(1, 50):
        tick(side, at)
    if coupling in ("pspm", "zoh"):
        assert arm.held[0] > 0.3
    before = side.coupling.ledger.work
    arm.x = 30.0
    for at in range(50, 60):
        tick(side, at)
        assert arm.held == (0.0,)
    arm.x = 0.0
    for at in range(60, 70):
        tick(side, at)
    assert arm.held == (0.0,)  # for good
    assert abs(side.coupling.ledger.work - before) < 1e-12
    assert all(abs(sample.position_m[0]) < 1.0 for sample in written if isinstance(sample, DeviceSample))
    why = "it reads 30 m from its origin, its workspace ends at 2 m (are these millimetres?)"
    (event,) = [sample for sample in written if isinstance(sample, Event)]
    assert event == Event(50 * MS, "stopped", f"the device renders no force any more: {why}", "error")
    part = device_summary(side, coupling)
    assert part["stopped"] == {"after_s": 0.05, "why": why, "asked": False}
    line = f"the device's force was stopped after 0.05 s: {why}"
    assert line in incomplete({"device": part})
    verdict = judge({"coupling": coupling, "theorem": {"margin_J": 0.1, "bound_J": 0.1}, "device": part})
    assert verdict["passive"] is None
    assert line in verdict["reason"]


def test_one_that_is_outside_when_it_is_to_begin_does_not_begin() -> None:
    setup = prepare(PARAMS.set({"hardware": named(Short), "scene": "free"}))
    side = device_side(setup, DeviceEndpoint(device_session(setup, 1)), lambda: 0, lambda sample: None)
    side.device.device.x = 0.5  # type: ignore[attr-defined]
    side.endpoint.pair(False)
    with pytest.raises(HapnetError, match=r"the device cannot begin: it reads 0\.5 m from its origin"):
        side.tick(0)
    side.stop()


def test_one_that_jumps_is_stopped() -> None:
    """20 mm in a millisecond are 20 m/s; from one reading to the next it may be 5 ms older than it says: 6 mm."""
    side, arm, _ = begun(Short)
    arm.x = 0.0059
    tick(side, 1)
    assert side.stopped is None
    arm.x = 0.026
    tick(side, 2)
    assert "it reads a displacement of 0.02009 m in 1 ms, its maximum speed is 1 m/s" in side.stopped[1]


def test_one_whose_velocity_is_in_millimetres_a_second_is_stopped_and_a_single_spike_is_not() -> None:
    side, arm, _ = begun(Short)
    for at, speed in enumerate((50.0, 50.0, 0.05, 50.0, 50.0), start=1):
        arm.v = speed
        tick(side, at)
    assert side.stopped is None
    tick(side, 6)
    assert side.stopped == (
        6 * MS,
        "it reads a velocity of 50 m/s, its maximum speed is 1 m/s (is it in mm/s?)",
        False,
    )


@given(st.floats(0.01, 0.3), st.floats(0.1, 4.0), st.lists(st.integers(200_000, 3_000_000), min_size=2, max_size=200))
def test_no_motion_within_what_is_declared_is_stopped(amplitude: float, hz: float, steps_ns: list[int]) -> None:
    """A sine whose reach and greatest speed are just those declared, read at any times, from up to 5 ms ago."""
    omega = 2.0 * math.pi * hz
    declared = OperatingRange((amplitude,), max(0.01, amplitude * omega), (1.0, 1e5))
    watch, now = RangeWatch(declared, 0.0, (0.0,)), 0
    for k, step in enumerate(steps_ns):
        now += step
        t = max(0.0, now * 1e-9 - (0.0049 if k % 2 else 0.0))
        x, v = amplitude * math.sin(omega * t), amplitude * omega * math.cos(omega * t)
        assert watch.passes(step * 1e-9, (x * (1 - 1e-9),), (v * (1 - 1e-9),)), watch.why


def test_the_simulated_device_is_not_watched_and_its_summary_says_that_it_was_not_stopped() -> None:
    setup = prepare(PARAMS.set({"operator": "sine", "scene": "free"}))
    side = device_side(setup, DeviceEndpoint(device_session(setup, 1)), lambda: 0, lambda sample: None)
    side.endpoint.pair(False)
    for at in range(5):
        side.tick(at * MS)
    assert device_summary(side, "pspm")["stopped"] is None
    assert unknown_device()["stopped"] is None
    assert not any("stopped" in line for line in incomplete({"device": {"stopped": None}}))
    assert declared_range(PARAMS.device, 3).workspace == (2.0,)


@pytest.mark.parametrize("more", mostly_slow([(("--realtime",),), ((),)], 0, 1), ids=["realtime", "thread"])
def test_a_run_whose_device_leaves_its_workspace_goes_on_and_ends_with_code_3(
    more: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "driver.py").write_text(LEAVING, "utf-8")
    monkeypatch.chdir(tmp_path)
    words = ("--device", "driver:Leaving", "--scene", "free", "--duration", 2, "--out", "r", "--json", "s.json")
    words += ("--set", "device.self_test_N=0")
    with started("run", *words, *more) as program:
        code, stdout, stderr = program.end()
    why = "it reads 0.2 m from its origin, its workspace ends at 0.1 m"
    assert code == 3
    assert stderr.startswith("hapnet: the device's force was stopped after ")
    assert stderr.endswith(f" s: {why}\n")
    assert f"device: the device renders no force any more: {why}" in stdout
    summary = read_json(Path("s.json"))
    assert summary["device"]["stopped"]["why"] == why
    assert summary["duration_s"] >= 2.0
    assert "was stopped after" in Path("r/report.html").read_text("utf-8")


LEAVING = """
class Leaving:
    force_limit, resolution, workspace = 3.0, 0.0, 0.1
    def __init__(self, dof):
        self.dof, self.reads = dof, 0
    def read(self):
        self.reads += 1
        return (0.05 if self.reads < 500 else 0.2,) * self.dof, (0.0,) * self.dof
    def apply(self, force):
        pass
"""
