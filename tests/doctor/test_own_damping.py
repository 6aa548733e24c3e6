"""The doctor's lower bound of a device's own damping, on handles whose damping only the tests know."""

import math
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import Phase, given, settings, strategies as st

from hapnet import cli
from hapnet.assembly.user_device import UserDevice
from hapnet.checks import Vector
from hapnet.errors import DeviceSilent
from hapnet.ext.devices.emulator import EmulatedHandle
from hapnet.ext.doctor.device import examine_device
from hapnet.ext.doctor.machine import OK, SKIPPED, WARNING, Check
from hapnet.ext.doctor.own_damping import DampingEstimate, lower_bound, own_damping
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.operator import Impedance, Rest
from tests.support.commands import Capture

NOBODY = Impedance(0.0, 0.0, 0.0)
SUBSTEPS = 4


class Slide:
    """A handle that nobody holds: mass, damper, Coulomb friction, weight, a spring of its own, by the midpoint rule.

    noise : of its encoder, rms [m]; late : its force acts so many readings later, which it does not report.
    """

    force_limit, resolution = 3.0, 0.0
    now_ns = 0
    mass, damping, friction, weight, spring = 0.045, 0.3, 0.0, 0.0, 0.0
    noise, count, late, silent_every, seed = 0.0, 0.0, 0, 0, 0

    def __init__(self, dof: int) -> None:
        self.dof = dof
        self.x = self.v = 0.0
        self._at_ns, self._reads, self._random = Slide.now_ns, 0, np.random.default_rng(self.seed)
        self.pushed: list[float] = []

    def read(self) -> tuple[Vector, Vector]:
        self._reads += 1
        self._move()
        if self.silent_every and self._reads % self.silent_every == 0:
            raise DeviceSilent("not now")
        x = self.x + self.noise * self._random.normal()
        return ((self.count * round(x / self.count) if self.count else x),), (self.v,)

    def apply(self, force: Vector) -> Vector:
        self.pushed.append(force[0])
        return force

    def _move(self) -> None:
        force = self.pushed[-1 - self.late] if len(self.pushed) > self.late else 0.0
        steps = SUBSTEPS * max(0, round((Slide.now_ns - self._at_ns) / 1e6))
        h = 1e-3 / SUBSTEPS
        for _ in range(steps):
            before, drag = self.v, 0.5 * h * self.damping / self.mass
            push = force - self.weight - self.spring * (self.x + 0.5 * h * before)
            v = (before * (1.0 - drag) + h / self.mass * push) / (1.0 + drag)
            stopping = h * self.friction / self.mass
            self.v = math.copysign(max(0.0, abs(v) - stopping), v)
            self.x += 0.5 * h * (before + self.v)
        self._at_ns = Slide.now_ns


class Emulated:
    """The handle of hapnet's emulators, with three axes and a simulated hand on it."""

    force_limit, resolution = 3.0, 0.0
    hand, damping = NOBODY, 0.2

    def __init__(self, dof: int) -> None:
        self.dof = dof
        self._handle = EmulatedHandle(SimulatedDevice(Rest(dof, self.hand), mass=0.1, damping=self.damping))

    def read(self) -> tuple[Vector, Vector]:
        return self._handle.read(Slide.now_ns)

    def apply(self, force: Vector) -> Vector:
        return self._handle.hold(Slide.now_ns, force)


class Held(Emulated):
    hand = Impedance()


class Backwards(Emulated):
    def apply(self, force: Vector) -> Vector:
        super().apply(tuple(-f for f in force))
        return force


class Braked(Slide):
    def braked(self) -> str:
        return "its brake is on"


class Switched(Slide):
    """Its dead-man switch is let go after a second."""

    dead_man = 0

    def buttons(self) -> tuple[bool, ...]:
        return (Slide.now_ns < 1_000_000_000,)


class Begun(Slide):
    """Remembers how many pushes came before its `begin`."""

    pushes_before: int | None = None

    def begin(self) -> None:
        self.pushes_before = sum(force != 0.0 for force in self.pushed)


def sleep(seconds: float) -> None:
    Slide.now_ns += round(seconds * 1e9)


def measured(name: str, most_N: float = 0.3, dof: int = 1) -> tuple[Check, UserDevice]:
    Slide.now_ns = 0
    device = UserDevice(f"tests.doctor.test_own_damping:{name}", dof)
    return own_damping(device, 1000.0, lambda: Slide.now_ns, sleep, most_N), device


def bound(check: Check) -> float:
    """What it says to set; 0: nothing."""
    if check.state != OK:
        assert check.value.startswith("not known: ")
        assert check.advice == "leave device.trusted_damping at 0"
        return 0.0
    value = float(check.value.split()[2])
    assert f"device.trusted_damping={value:g}" in check.advice
    return value


@pytest.fixture
def slide() -> Iterator[type[Slide]]:
    kept = {name: value for name, value in vars(Slide).items() if isinstance(value, int | float)}
    yield Slide
    for name, value in kept.items():
        setattr(Slide, name, value)


SLOW = pytest.mark.slow
QUIET = [
    {"count": 55e-6},
    {"damping": 3.0},
    pytest.param({"mass": 0.5, "damping": 0.1, "count": 1e-6}, marks=SLOW),
    pytest.param({"mass": 0.2, "weight": 0.03, "spring": 2.0}, marks=SLOW),
]


@pytest.mark.parametrize("words", QUIET, ids=str)
def test_the_bound_is_below_the_truth_and_at_least_half_of_it_where_it_is_quiet(
    words: dict[str, float], slide: type[Slide]
) -> None:
    for name, value in words.items():
        setattr(slide, name, value)
    assert 0.5 * slide.damping <= bound(measured("Slide")[0]) <= slide.damping


@pytest.mark.parametrize(
    "words",
    [
        {"mass": 0.4191, "damping": 0.0535, "friction": 0.017, "weight": -0.0923, "spring": 0.917, "late": 2},
        pytest.param({"mass": 0.9587, "damping": 0.113, "friction": 0.0903, "late": 1, "silent_every": 7}, marks=SLOW),
    ],
    ids=str,
)
def test_friction_that_looks_like_damping_is_not_counted(words: dict[str, float], slide: type[Slide]) -> None:
    """Least squares alone find 0.13 and 0.14 Ns/m: with little force there is little between the two."""
    for name, value in words.items():
        setattr(slide, name, value)
    assert bound(measured("Slide", 0.15 if words["friction"] < 0.05 else 0.3)[0]) <= slide.damping


def test_friction_alone_is_no_damping(slide: type[Slide]) -> None:
    """Taken for damping at 0.2 m/s, 0.05 N would be 0.25 Ns/m; at 1 m/s it takes a fifth of that."""
    slide.damping, slide.friction = 0.0, 0.05
    assert bound(measured("Slide")[0]) <= 0.002


@SLOW
def test_all_axes_of_an_emulators_handle_are_measured() -> None:
    check, _ = measured("Emulated", dof=2)
    assert 0.1 <= bound(check) <= 0.2
    assert "6 trials" in check.value


def test_the_force_is_bounded_and_ends_at_zero() -> None:
    check, device = measured("Slide", 0.2)
    assert 0.15 <= bound(check) <= 0.3
    assert max(map(abs, device.device.pushed)) == pytest.approx(0.2)
    assert device.device.pushed[-1] == 0.0


@pytest.mark.parametrize(
    ("name", "state", "says"),
    [
        ("Held", SKIPPED, "let go"),
        ("Backwards", WARNING, "ran away"),
        ("Braked", SKIPPED, "its brake is on"),
        ("Switched", SKIPPED, "dead-man switch"),
    ],
)
def test_what_cannot_be_measured_says_why(name: str, state: str, says: str) -> None:
    check, device = measured(name)
    assert (check.state, bound(check)) == (state, 0.0)
    assert says in check.value
    if isinstance(device.device, Slide):
        assert device.device.pushed[-1] == 0.0


NO_SHRINKING = (Phase.explicit, Phase.reuse, Phase.generate)
"""An example takes a second."""

SLIDES = st.fixed_dictionaries(
    {
        "mass": st.floats(0.03, 1.0),
        "damping": st.one_of(st.just(0.0), st.floats(-2.5, 1.0).map(lambda power: 10.0**power)),
        "friction": st.one_of(st.just(0.0), st.floats(0.0, 0.1)),
        "weight": st.floats(-0.1, 0.1),
        "spring": st.one_of(st.just(0.0), st.floats(0.0, 10.0)),
        "noise": st.one_of(st.just(0.0), st.floats(0.0, 1e-4)),
        "count": st.sampled_from((0.0, 1e-6, 55e-6, 2e-4)),
        "late": st.integers(0, 3),
        "silent_every": st.sampled_from((0, 0, 7)),
        "seed": st.integers(0, 1000),
    }
)


def never_above_the_truth(words: dict[str, float], most_N: float) -> None:
    for name, value in words.items():
        setattr(Slide, name, value)
    assert bound(measured("Slide", most_N)[0]) <= Slide.damping


@pytest.mark.usefixtures("slide")
@pytest.mark.parametrize("devices", [pytest.param(2, marks=SLOW), pytest.param(12, marks=pytest.mark.soak)])
def test_the_bound_is_never_above_the_truth(devices: int) -> None:
    @settings(max_examples=devices, phases=NO_SHRINKING)
    @given(words=SLIDES, most_N=st.floats(0.1, 1.0))
    def check(words: dict[str, float], most_N: float) -> None:
        never_above_the_truth(words, most_N)

    check()


def test_the_bound_is_the_least_less_spread_and_a_tenth() -> None:
    trials = [DampingEstimate(0.30, 0.29, 0.0), DampingEstimate(0.31, 0.28, 0.0), DampingEstimate(0.32, 0.33, 0.0)]
    assert lower_bound(trials) == pytest.approx(0.23)  # 0.9 x 0.28 - 0.02 = 0.232
    assert lower_bound([DampingEstimate(0.0123, 0.0123, 0.0)] * 3) == pytest.approx(0.011)
    assert lower_bound([*trials, DampingEstimate(1.0, 1.0, 0.0)]) == 0.0


def test_the_doctor_begins_before_it_pushes_and_says_how_without() -> None:
    Slide.now_ns = 0
    device = UserDevice("tests.doctor.test_own_damping:Begun", 1)
    found = {c.name: c for c in examine_device(device, 1000.0, lambda: Slide.now_ns, sleep)}
    assert (found["own damping"].state, device.device.pushes_before) == (SKIPPED, None)
    assert "--damping" in found["own damping"].advice
    found = {c.name: c for c in examine_device(device, 1000.0, lambda: Slide.now_ns, sleep, damping_N=0.3)}
    assert device.device.pushes_before == 0
    assert 0.15 <= bound(found["own damping"]) <= 0.3


def test_force_is_checked_by_the_command(capsys: Capture) -> None:
    name = "tests.doctor.test_own_damping:Slide"
    for words, says in (
        (["--device", name, "--damping", "5"], "at most 3 N"),
        (["--device", name, "--damping", "0.3", "--ramp", "1"], "run --ramp and --damping one after the other"),
        (["--damping", "0.3"], "it needs --device"),
    ):
        assert cli.main(["doctor", *words]) == 2
        assert says in capsys.readouterr().err
