"""Faults between a force and the positions that follow: found by the doctor, when a run starts, and while it runs."""

import itertools
import math
import random
import re
from pathlib import Path
from typing import Any

import pytest

from hapnet import cli
from hapnet.assembly.build import device_session, device_side, prepare
from hapnet.assembly.user_device import UserDevice
from hapnet.checks import Vector
from hapnet.commands import known_devices
from hapnet.errors import HapnetError
from hapnet.ext.doctor.device import examine_device
from hapnet.ext.doctor.machine import OK, WARNING, Check
from hapnet.params import Params
from hapnet.plant.actuator_check import ActuatorCheck, response
from hapnet.plant.force_probe import Agreement, ForceProbe
from hapnet.recording.samples import Event, Sample
from hapnet.side.endpoint import DeviceEndpoint
from hapnet.side.real_device import RealDeviceSide
from hapnet.summary.run import device_summary
from tests.conftest import mostly_slow
from tests.measure.reversed_motors import flipped, run
from tests.support.commands import Capture
from tests.support.handles import FAULTS, DeadEncoder, Handle, Late

MS = 1_000_000


def name(kind: type) -> str:
    return f"{kind.__module__}:{kind.__name__}"


# A computer that stalls


def checked(seed: int, often: float, sign: float) -> ActuatorCheck:
    """100 g in a hand that pulls it, as the page's own device, checked by a computer that stalls for 2 to 60 ms: before
    a reading, before the reading is stamped, and before the force is applied, each so `often`."""
    rng = random.Random(seed)
    check, sent, force, now, at, x, v = ActuatorCheck(1, 0.3, 0.001, rounds=2), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    last: float | None = None

    def stalled() -> float:
        return rng.uniform(0.002, 0.06) if rng.random() < often else 0.0

    def moved() -> None:
        nonlocal at, x, v
        steps = max(1, round((now - at) / 1e-4))
        for _ in range(steps):
            v += (now - at) / steps * (sign * force + 40.0 * (0.03 - x) - 4.0 * v) / 0.1
            x += (now - at) / steps * v
        at = now

    while not check.done:
        now += 0.001 + stalled()
        moved()
        now += stalled()
        (sent,) = check.step(0.0 if last is None else now - last, (sent,), (x,), (v,))
        last = now
        now += stalled()
        moved()
        force = sent
    return check


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_sign_is_known_although_the_computer_stalls_now_and_then(sign: float) -> None:
    for seed in range(20):
        check = checked(seed, 0.01, sign)
        assert bool(check.wrong_way) is (sign < 0.0), seed
        assert check.responses[0].mass == pytest.approx(0.1 * sign, rel=0.1), seed
        assert check.doubts == []


def test_where_it_stalls_all_the_time_nobody_is_accused_and_it_is_said() -> None:
    for seed in range(20):
        check = checked(seed, 0.1, 1.0)
        assert check.wrong_way == ""
        assert check.doubts == ["the handle could not be checked: too many of its readings came late"]


# The doctor


def sleep(seconds: float) -> None:
    Handle.now_ns += round(seconds * 1e9)


def examined(kind: type[Handle], force_N: float = 0.3, known_mass: Vector = ()) -> tuple[Check, Handle, list[Vector]]:
    """What the doctor says about force and motion, the handle, and the masses that it would remember."""
    Handle.now_ns = 0
    device = UserDevice(name(kind), 1)
    masses: list[Vector] = []
    checks = examine_device(
        device, 1000.0, lambda: Handle.now_ns, sleep, force_N, known_mass=known_mass, on_mass=masses.append
    )
    found = {check.name: check for check in checks}
    assert Handle.now_ns < 10_000 * MS
    return found["force and motion"], device.device, masses


@pytest.mark.parametrize(("kind", "says"), FAULTS)
def test_the_doctor_finds_the_fault_with_0_3_N_within_10_s_and_10_mm(kind: type[Handle], says: str) -> None:
    check, handle, _ = examined(kind)
    assert check.state == WARNING
    assert says in check.value
    assert handle.hardest_N == pytest.approx(0.3)
    assert handle.moved_m < 0.032  # 30 mm of them are the hand's own


def test_the_doctor_finds_nothing_wrong_with_a_good_one_and_its_mass() -> None:
    """The mass is the handle's own: 0.1 kg."""
    check, handle, masses = examined(Handle)
    assert check.state == OK
    assert re.fullmatch(r"0\.3 N move it as [0-9.]+ kg would, at the next reading", check.value)
    assert handle.began_after == 0
    assert masses[0] == pytest.approx((0.1,), rel=0.03)


def test_half_the_mass_of_before_is_another_grip_or_force() -> None:
    check, _, _ = examined(Handle, known_mass=(0.2,))
    (mass,) = re.findall(r"moves like (.*) kg, earlier like 0\.2 kg: another grip, or force\?", check.value)
    assert float(mass) == pytest.approx(0.1, rel=0.03)


def test_a_force_too_small_to_show_is_no_fault() -> None:
    check, _, masses = examined(Handle, force_N=1e-4)
    assert check.state == WARNING
    assert check.value == "0.0001 N do not show in its positions"
    assert masses == []


class Braked(Handle):
    def braked(self) -> str:
        return "its brake is on"


@pytest.mark.parametrize(("readings", "force_N", "stands"), [(100, 0.0, False), (15, 0.3, False), (16, 0.3, True)])
def test_an_axis_stands_still_only_if_it_was_pushed_for_two_readings_a_pulse(
    readings: int, force_N: float, stands: bool
) -> None:
    found = response([(0.001 * k, force_N, 0.0, 0.0) for k in range(readings)])
    assert found.stood_still == stands
    assert not found.known


def test_a_brake_is_said_and_nothing_is_pushed() -> None:
    check, handle, _ = examined(Braked)
    assert check.value == "not known: it renders no force (its brake is on)"
    assert handle.hardest_N == 0.0


# A run


class Rig:
    """A side around a handle, paired from the start; each tick is a millisecond."""

    def __init__(self, kind: type[Handle], dof: int = 1, **params: object) -> None:
        Handle.now_ns = 0
        self.events: list[Event] = []
        given = {"hardware": name(kind), "scene": "free", "dof": dof} | params
        setup = prepare(Params().set(given))
        side = device_side(setup, DeviceEndpoint(device_session(setup, 1)), lambda: Handle.now_ns, self._write)
        assert isinstance(side, RealDeviceSide)
        self.side = side
        self.handle: Handle = side.device.device  # type: ignore[attr-defined]  # the user's, inside
        side.endpoint.pair(False)

    def _write(self, sample: Sample) -> None:
        if isinstance(sample, Event):
            self.events.append(sample)

    def run(self, until_ms: int) -> None:
        while until_ms * MS > Handle.now_ns:
            Handle.now_ns += MS
            self.side.tick(Handle.now_ns)

    @property
    def said(self) -> list[str]:
        return [event.text for event in self.events if event.kind in ("device", "stopped")]


@pytest.mark.parametrize(("kind", "says"), FAULTS)
def test_a_run_finds_the_fault_within_half_a_second_and_10_mm(kind: type[Handle], says: str) -> None:
    rig = Rig(kind)
    try:
        rig.run(500)
        said = rig.said
    except HapnetError as error:
        said = [str(error)]
        assert "reversed" in says
    assert any(says in text for text in said)
    assert rig.handle.moved_m < 0.01
    assert rig.handle.hardest_N < 0.301
    if kind is DeadEncoder:
        assert rig.side.stopped is not None


@pytest.mark.parametrize("dof", [1, 2])
def test_a_good_device_is_pushed_then_control_begins_and_its_mass_is_told(dof: int) -> None:
    rig = Rig(Handle)
    rig.run(300)
    assert rig.side.origin_ns is None
    rig.run(450)
    assert rig.said == []
    assert rig.side.origin_ns < 450 * MS
    driver = device_summary(rig.side, "pspm")["driver"]
    assert driver["mass_kg"] == pytest.approx([0.1], rel=0.05)
    assert rig.side.coupling.ledger.work == pytest.approx(0.0, abs=1e-6)  # the pushes are not the coupling's


def test_who_does_not_want_it_is_not_pushed() -> None:
    rig = Rig(Handle, **{"device.self_test_N": 0.0})
    rig.run(5)
    assert rig.side.origin_ns == MS
    assert rig.handle.hardest_N == 0.0


class Switched(Handle):
    dead_man, held = 0, False

    def buttons(self) -> tuple[bool, ...]:
        return (self.held,)


def test_with_its_brake_on_it_is_not_pushed_and_that_is_said() -> None:
    rig = Rig(Braked)
    rig.run(5)
    assert rig.side.origin_ns is not None
    assert rig.handle.hardest_N == 0.0
    assert "are not checked: its" in rig.said[0]


def test_it_is_pushed_when_its_switch_is_first_held_and_control_begins_then() -> None:
    rig = Rig(Switched)
    rig.run(500)
    assert rig.side.origin_ns is None
    assert rig.handle.hardest_N == 0.0
    assert [event.text for event in rig.events if event.kind == "dead-man"] == [
        f"hold the dead-man switch of {name(Switched)}: its force and motion are checked first"
    ]
    rig.handle.held = True  # type: ignore[attr-defined]
    rig.run(600)
    rig.handle.held = False  # type: ignore[attr-defined]
    rig.run(650)
    assert rig.side.origin_ns is None  # all of it, in one go
    rig.handle.held = True  # type: ignore[attr-defined]
    rig.run(1200)
    assert rig.side.origin_ns is not None
    assert rig.handle.hardest_N == pytest.approx(0.3)
    assert device_summary(rig.side, "pspm")["driver"]["mass_kg"] == pytest.approx([0.1], rel=0.05)


def test_axes_are_pushed_one_after_another() -> None:
    check = ActuatorCheck(3, 0.3, 1e-3)
    force: Vector = (0.0,) * 3
    pushed = []
    for k in itertools.count():
        force = check.step(1e-3 if k else 0.0, force, (1e-9 * k,) * 3, (0.0,) * 3)
        if check.done:
            break
        assert sum(map(bool, force)) <= 1
        pushed += [i for i, part in enumerate(force) if part]
    assert k < 450
    assert pushed == sorted(pushed)
    assert [pushed.count(i) for i in range(3)] == pytest.approx([128] * 3, abs=2)


# While it runs


def driven(mass: float, stiffness: float, seconds: float, hand_N: float = 0.0) -> tuple[str, float]:
    """A handle on a spring of `stiffness`, given as `stiffness` that pulls: below zero the motor is reversed."""
    watch, x, v, f, said = ForceProbe(1e-3, mass), 1e-4, 0.0, 0.0, ""
    for _ in range(round(seconds / 1e-3)):
        for _ in range(10):
            v += 1e-4 * (math.copysign(1.0, stiffness) * f + hand_N - 4.0 * v) / mass
            x += 1e-4 * v
        said = said or watch.wrong(1e-3, (f,), (x,))
        if said:
            break
        f = watch.share * max(-3.0, min(3.0, -abs(stiffness) * x))
    return said, x


@pytest.mark.parametrize("stiffness", [-200.0, -600.0])
def test_a_motor_that_is_reversed_while_it_runs_ends_the_force(stiffness: float) -> None:
    said, x = driven(0.1, stiffness, 1.0)
    assert abs(x) < 0.01
    assert "moves against its force: is the motor reversed?" in said


@pytest.mark.parametrize("hand_N", [0.0, 1.0, 3.0])
def test_a_hand_that_pushes_into_a_spring_is_none(hand_N: float) -> None:
    assert driven(0.1, 200.0, 2.0, hand_N)[0] == ""


@pytest.mark.parametrize("way_s", [0.15, 0.3, 0.6, 1.2])
@pytest.mark.parametrize("stiffness", [100.0, 600.0])
def test_a_hand_that_moves_as_fast_as_hands_do_is_none(way_s: float, stiffness: float) -> None:
    """Minimum jerk (Flash and Hogan 1985), 150 mm, against a damper of 1 Ns/m and a spring to a place 5 mm behind."""
    watch = ForceProbe(1e-3, 0.1)
    for k in range(round(way_s / 1e-3)):
        s = k * 1e-3 / way_s
        x = 0.15 * (10 * s**3 - 15 * s**4 + 6 * s**5)
        v = 0.15 / way_s * (30 * s**2 - 60 * s**3 + 30 * s**4)
        force = max(-3.3, -v - stiffness * min(0.005, 0.02 * v))
        assert watch.wrong(1e-3, (watch.share * force,), (x,)) == ""


@pytest.mark.parametrize(
    ("seed", "encoder_m"),
    mostly_slow(
        [(35, 0.0), (0, 2e-5), (13, 2e-5), *[(one, 2e-5) for one in (1, 16, 18, 21, 33)], (3, 0.0), (14, 0.0)], 3
    ),
)
def test_a_sign_that_flips_in_a_run_is_named_within_half_a_second_and_10_mm(seed: int, encoder_m: float) -> None:
    """Of a soft hand that moves slowly into a wall, of one that rests, of one of two masses that moves fast."""
    found = flipped(seed, encoder_m)
    assert "is the motor reversed?" in found.run.said
    assert found.shown_s is not None
    assert found.shown_s <= 0.5
    assert found.far_m <= 0.01


@pytest.mark.parametrize(("seed", "encoder_m"), mostly_slow([(28, 0.0), (11, 0.0), (17, 2e-5), (34, 2e-5)], 2))
def test_no_hand_that_moves_is_taken_for_a_reversed_motor(seed: int, encoder_m: float) -> None:
    """Of these, two move while the pushes at the start go on: as no cubic does for 0.4 s."""
    found = run(seed, encoder_m, flips=False)
    assert found.said == ""
    assert max(map(abs, found.force)) > 0.25


@pytest.mark.parametrize(("changes_N", "still"), [(1.5, True), (0.5, False)])
def test_a_position_that_stands_still_while_the_force_changes_is_named(changes_N: float, still: bool) -> None:
    watch, said = Agreement(), ""
    for k in range(500):
        said = said or watch.wrong(1e-3, (changes_N * math.sin(0.02 * k),), (0.01,))
    assert ("reads the same position while its force changes" in said) == still


def test_a_silence_is_no_time_in_which_the_position_stood_still() -> None:
    watch = Agreement()
    assert not watch.wrong(1e-3, (1.8,), (0.01,))
    assert not watch.wrong(1.2, (0.0,), (0.01,))  # the force went, and no reading came meanwhile
    assert not watch.wrong(1e-3, (0.0,), (0.01,))


# The first start with a device


def test_a_new_device_is_asked_about_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    asked: list[str] = []
    params = Params().set({"hardware": "my:Arm", "dof": 2})
    assert known_devices.introduced(Params(), asked.append) == Params()
    assert known_devices.introduced(params, asked.append) == params
    (text,) = asked
    assert "hapnet has not used my:Arm on this machine before" in text
    assert "up to 0.3 N" in text
    summary: Any = {"device": {"driver": {"mass_kg": [0.2, 0.3]}}}
    known_devices.learn(params.set({"device.self_test_N": 0.0}), summary)
    assert known_devices.introduced(params, asked.append) == params, "a device that was not pushed stays new"
    assert asked.pop() == text
    known_devices.learn(params, summary)
    assert known_devices.introduced(params, asked.append).device.known_mass_kg == (0.2, 0.3)
    one = params.set({"dof": 1})  # which axis of the two nobody knows
    assert known_devices.introduced(one, asked.append) == one
    assert len(asked) == 1


@pytest.mark.parametrize("content", ["{", "[]", '{"my:Arm": {"mass_kg": ["x"]}}'])
def test_a_file_that_is_broken_makes_devices_new(content: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    known_devices.file().parent.mkdir()
    known_devices.file().write_text(content)
    assert known_devices.mass_of("my:Arm", 1) is None


def test_what_cannot_be_written_is_no_failure(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    known_devices.remember("my:Arm", (0.1,))
    assert known_devices.mass_of("my:Arm", 1) is None


@pytest.mark.slow
def test_a_mass_for_another_number_of_axes_is_refused(capsys: Capture) -> None:
    assert cli.main(["run", "--device", name(Late), "--dof", "1", "--set", "device.known_mass_kg=[1, 2]"]) == 2
    assert "device.known_mass_kg" in capsys.readouterr().err


def test_on_a_busy_machine_the_force_is_not_cut_again_and_again() -> None:
    """A light handle that a hand pulls into a spring, one reading in five late: no probe is worth anything."""
    rng, probe = random.Random(7), ForceProbe(0.001, 0.1)
    x = v = force = cut_s = now_s = 0.0
    while now_s < 5.0:
        dt = rng.uniform(0.01, 0.02) if rng.random() < 0.2 else 0.001
        steps = max(1, round(dt / 1e-4))
        for _ in range(steps):
            v += dt / steps * (force + 60.0 * (0.03 - x) - 4.0 * v) / 0.1
            x += dt / steps * v
        assert probe.wrong(dt, (force,), (x,)) == ""
        now_s += dt
        cut_s += dt if probe.share < 1.0 else 0.0
        force = -probe.share * max(0.0, 200.0 * (x - 0.02))
    assert cut_s < 0.05 * now_s
    assert x == pytest.approx((60.0 * 0.03 + 200.0 * 0.02) / 260.0, abs=2e-5)
