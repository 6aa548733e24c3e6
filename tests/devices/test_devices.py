"""Devices by name: options, axes, published drivers, an emulator's handle, and the doctor's measurements."""

import json
import math
from collections.abc import Iterator
from importlib import metadata
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from hapnet import cli
from hapnet.assembly.device_class import load_class
from hapnet.assembly.user_device import UserDevice
from hapnet.checks import Vector
from hapnet.devices import registry
from hapnet.devices.driver import Axes
from hapnet.errors import DeviceSilent, InvalidParameter
from hapnet.ext.devices.emulator import EmulatedHandle
from hapnet.ext.doctor.device import examine_device
from hapnet.ext.doctor.machine import OK, WARNING
from hapnet.loading import published
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.operator import Impedance, Rest
from tests.support.commands import Capture


class Arm:
    """A device with options of every type; its handle swings with 1 Hz and 10 mm."""

    about, tested, emulator = "an arm for tests", "untested", ""
    force_limit, resolution = 4.0, 1e-6
    now_ns = 0
    unit, silent_every = 1.0, 0

    def __init__(self, dof: int, port: str = "", gain: float = 1.0, side: int = 1, fast: bool = False) -> None:
        self.dof, self.options = dof, (port, gain, side, fast)
        self.reads = 0
        self.pushed: list[Vector] = []

    def read(self) -> tuple[Vector, Vector]:
        self.reads += 1
        if self.silent_every and self.reads % self.silent_every == 0:
            raise DeviceSilent("not now")
        phase = 2.0 * math.pi * Arm.now_ns * 1e-9
        x, v = 0.01 * math.sin(phase), 0.01 * 2.0 * math.pi * math.cos(phase)
        return (x,) * self.dof, (self.unit * v,) * self.dof

    def apply(self, force: Vector) -> Vector:
        self.pushed.append(force)
        return force


class Millimetres(Arm):
    unit = 1000.0


class Stuck(Arm):
    """Its handle does not move at all."""

    def read(self) -> tuple[Vector, Vector]:
        return (0.0,) * self.dof, (0.0,) * self.dof


class Stuttering(Arm):
    silent_every = 10


ARM = "tests.devices.test_devices:Arm"


@pytest.fixture
def named(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(registry, "BUILT_IN", {"arm": ARM})
    yield
    registry.published.cache_clear()


# Names and options


@pytest.mark.usefixtures("named")
@pytest.mark.parametrize(
    ("words", "options"),
    [
        ("arm", ("", 1.0, 1, False)),
        ("arm:/dev/ttyACM0", ("/dev/ttyACM0", 1.0, 1, False)),
        ("arm:/dev/ttyACM0,gain=2", ("/dev/ttyACM0", 2.0, 1, False)),
        ("arm:side=-3,fast=yes", ("", 1.0, -3, True)),
        (f"{ARM},gain=0.5", ("", 0.5, 1, False)),
        (ARM, ("", 1.0, 1, False)),
    ],
)
def test_options_are_the_constructors_keywords(words: str, options: tuple[object, ...]) -> None:
    device = UserDevice(words, 2)
    assert device.device.options == options
    assert device.dof == 2


@pytest.mark.usefixtures("named")
@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("arm:speed=2", "port=, gain=1.0, side=1, fast=False"),
        ("arm:gain=1,gain=2", "each at most once"),
        ("arm:gain=much", "a number for gain, such as gain=1.0"),
        ("arm:side=1.5", "a whole number for side"),
        ("arm:fast=maybe", "yes or no for fast"),
        ("arm:gain=1,/dev/x", "these options"),
        ("leg", "arm, or module:Class"),
    ],
)
def test_what_is_no_option_is_refused_with_those_that_are(words: str, says: str) -> None:
    with pytest.raises(InvalidParameter, match=r"^hardware ") as caught:
        load_class(words)
    assert says in str(caught.value) or words == "leg"


def test_another_packages_driver_is_found_by_its_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    point = metadata.EntryPoint("third-arm", ARM, registry.GROUP)
    clash = metadata.EntryPoint("serial", ARM, registry.GROUP)
    monkeypatch.setattr(metadata, "entry_points", lambda group: [point, clash] if group == registry.GROUP else [])
    published.cache_clear()
    try:
        assert registry.resolve("third-arm:gain=2") == (ARM, "gain=2")
        assert registry.known()["third-arm"] == (ARM, "")
        assert registry.known()["serial"][1] == "hapnet"  # a package cannot replace hapnet's own
    finally:
        published.cache_clear()


# Axes


@given(st.permutations("xyz"), st.tuples(st.booleans(), st.booleans(), st.booleans()), st.integers(1, 3))
def test_axes_keep_power(letters: list[str], turned: tuple[bool, ...], dof: int) -> None:
    """The work of a force over a motion is the same in the scene's axes and in the device's."""
    words = "".join("-" * minus + letter for letter, minus in zip(letters[:dof], turned, strict=False))
    axes = Axes(words, dof)
    force, motion = tuple(range(1, dof + 1)), (0.5, -2.0, 3.0)
    there = sum(f * x for f, x in zip(axes.spread(force), motion, strict=True))
    here = sum(f * x for f, x in zip(force, axes.take(motion), strict=True))
    assert there == pytest.approx(here)


@pytest.mark.parametrize("words", ["x", "xx", "xw", "x-", "--xy", "xyz"])
def test_axes_that_do_not_fit_are_refused(words: str) -> None:
    with pytest.raises(InvalidParameter, match="axes is"):
        Axes(words, 2)


def test_without_words_the_first_axes_are_used() -> None:
    assert Axes("", 2).take((1.0, 2.0, 3.0)) == (1.0, 2.0)


# An emulator's handle


def handle(watchdog_s: float | None = 0.02) -> EmulatedHandle:
    device = SimulatedDevice(Rest(1, Impedance(0.5, 6.0, 100.0), (0.0,)), mass=0.05, damping=0.0)
    return EmulatedHandle(device, watchdog_s)


def test_the_watchdog_takes_the_force_away() -> None:
    here = handle()
    here.hold(0, (1.0,))
    here.read(19_000_000)
    assert here.force == (1.0,)
    here.read(25_000_000)
    assert here.force == (0.0,)
    assert here.released == 1
    assert here.impulse_Ns[0] == pytest.approx(0.020)  # 1 N for 20 ms


def test_the_impulse_is_that_of_the_moment() -> None:
    """Its clock and its impulse fit together however late it is asked: the mean force is the one that was held."""
    here = handle(None)
    here.hold(0, (1.5,))
    times_ns = (300_000, 1_000_000, 34_700_000, 34_900_000)
    reported = []
    for now_ns in times_ns:
        here.read(now_ns)
        reported.append(here.impulse_at(now_ns)[0])
    for (a, b), (start, end) in zip(pairwise(reported), pairwise(times_ns), strict=True):
        assert (b - a) / ((end - start) * 1e-9) == pytest.approx(1.5)


def test_energy_given_is_the_force_over_the_way() -> None:
    """A constant force against a spring of 100 N/m: it has given F x by the time the handle rests at F / K."""
    here = handle(None)
    here.hold(0, (0.5,))
    for tenth in range(50):
        here.read(tenth * 100_000_000)
    (x,), _ = here.read(5_000_000_000)
    assert x == pytest.approx(0.5 / 100.0, rel=1e-3)
    assert here.work_J == pytest.approx(0.5 * x, rel=1e-9)
    here.hold(5_000_000_000, (0.0,))
    here.read(10_000_000_000)
    assert here.work_J == pytest.approx(0.5 * x, rel=1e-9)  # no force, no work on the way back
    assert here.most_given_J >= here.work_J


# Commands


def test_every_device_has_its_lines(capsys: Capture) -> None:
    assert cli.main(["devices", "--json", "-"]) == 0
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)}
    assert set(rows) == set(registry.known())
    assert all(row["about"] and row["from"] for row in rows.values())
    assert rows["serial"]["tested"] == "tested with an emulator"
    assert 'TAG+="uaccess"' in rows["3dmouse"]["udev"]
    assert rows["inverse3"]["udev"] == ""


def test_the_rules_name_the_usb_ids_of_force_dimension_and_of_the_falcon(capsys: Capture) -> None:
    """1451 is the maker's; a Falcon has a chip of FTDI (0403) with Novint's product number cb48. A rule is a line."""
    assert cli.main(["devices"]) == 0
    rules = [line for line in capsys.readouterr().out.splitlines() if line.startswith("  SUBSYSTEM")]
    assert any('ATTR{idVendor}=="1451"' in rule for rule in rules)
    assert any('ATTR{idVendor}=="0403", ATTR{idProduct}=="cb48"' in rule for rule in rules)
    assert all(rule.endswith('TAG+="uaccess"') for rule in rules)


class Leaving:
    @classmethod
    def missing(cls) -> str:
        raise SystemExit("no licence")


def test_a_driver_that_ends_the_program_is_listed_with_its_reason(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.setattr(registry, "known", lambda: {"mine": ("tests.devices.test_devices:Leaving", "my-arm")})
    assert cli.main(["devices", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["missing"] == "SystemExit: no licence"


def test_what_has_no_emulator_is_refused(capsys: Capture) -> None:
    assert cli.main(["emulate", "leg"]) == 2
    assert "one with an emulator: serial" in capsys.readouterr().err


def test_an_emulator_says_how_to_reach_it_and_what_it_gave(tmp_path: Path, capsys: Capture) -> None:
    link = tmp_path / "axis"
    assert cli.main(["emulate", f"serial:link={link}", "--duration", "0.2", "--json", str(tmp_path / "e.json")]) == 0
    out = capsys.readouterr().out
    assert f"emulates serial: hapnet run --device serial:{link}" in out
    assert json.loads((tmp_path / "e.json").read_text())["commands"] == 0
    assert not link.is_symlink()


# The doctor


def step(seconds: float) -> None:
    Arm.now_ns += round(seconds * 1e9)


def examined(name: str, ramp_N: float = 0.0) -> dict[str, tuple[str, str]]:
    Arm.now_ns = 0
    device = UserDevice(f"tests.devices.test_devices:{name}", 1)
    checks = list(examine_device(device, 1000.0, lambda: Arm.now_ns, step, ramp_N))
    assert all(force == (0.0,) for force in device.device.pushed) == (ramp_N == 0.0)
    return {check.name: (check.state, check.value) for check in checks}


def test_the_doctor_measures_a_device() -> None:
    found = examined("Arm")
    assert found["rate"][0] == OK
    assert found["rate"][1].startswith("1000 Hz")
    assert found["velocity"] == (OK, "1.00 times the speed of its positions")
    assert found["watchdog"][0] == WARNING


def test_the_doctor_sees_velocities_in_millimetres() -> None:
    state, value = examined("Millimetres")["velocity"]
    assert state == WARNING
    assert float(value.split()[0]) == pytest.approx(1000.0, rel=1e-3)


def test_the_doctor_counts_missed_readings() -> None:
    state, value = examined("Stuttering")["rate"]
    assert state == WARNING
    assert "200 of 2000 readings missed" in value


def test_the_doctor_pushes_only_when_asked() -> None:
    assert "force and motion" not in examined("Arm")


def test_a_hand_that_moves_is_not_taken_for_a_motor() -> None:
    """It swings by 10 mm, whatever the force; an older check took a good motor for a reversed one."""
    state, value = examined("Arm", ramp_N=1.0)["force and motion"]
    assert (state, value) == (WARNING, "1 N do not show in its positions")


def test_a_handle_that_did_not_move_at_all_is_named() -> None:
    state, value = examined("Stuck", ramp_N=1.0)["force and motion"]
    assert state == WARNING
    assert value.endswith("reads the same while 1 N push it to and fro: is its encoder connected?")


@pytest.mark.usefixtures("named")
@pytest.mark.parametrize("ramp", ["-1", "5"])
def test_a_ramp_beyond_the_device_is_refused(ramp: str, capsys: Capture) -> None:
    assert cli.main(["doctor", "--device", "arm", "--ramp", ramp]) == 2
    assert "at most 4 N" in capsys.readouterr().err
    assert cli.main(["doctor", "--ramp", "1"]) == 2
    assert "--ramp 1.0: it needs --device" in capsys.readouterr().err
