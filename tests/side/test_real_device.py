"""A real device's side: silences, blocking readings, the dead-man switch, and an account that never flatters."""

import math

import pytest

from hapnet.assembly.build import device_session, device_side, prepare
from hapnet.checks import Vector
from hapnet.errors import DeviceSilent, HapnetError, InvalidParameter
from hapnet.recording.samples import Event, Sample
from hapnet.side.endpoint import DeviceEndpoint
from hapnet.side.real_device import RealDeviceSide
from hapnet.side.real_device_state import FIRST_READING_S
from hapnet.summary.run import device_summary
from hapnet.summary.verdict import findings, incomplete
from tests.support.paper import PAPER

MS = 1_000_000


class Arm:
    """A handle that a test moves, with a watchdog of 5 ms and a switch."""

    dof, force_limit, resolution, greatest_speed, smallest_mass = 1, 3.0, 0.0, 0.5, 0.2
    watchdog_s: float | None = 0.005
    dead_man: int | None = None
    rate_hz = 500.0

    def __init__(self, dof: int) -> None:
        self.x = 0.0
        self.silent = self.deaf = self.closed = False
        self.pressed = True
        self.reported: list[Vector] = []

    def read(self) -> tuple[Vector, Vector]:
        if self.silent:
            raise DeviceSilent("no answer for 5 ms")
        return (self.x,), (0.0,)

    def apply(self, force: Vector) -> Vector:
        if self.deaf:
            raise DeviceSilent("the cable is out")
        self.reported.append(force)
        return force

    def buttons(self) -> tuple[bool, ...]:
        return (self.pressed,)

    def close(self) -> None:
        self.closed = True


class Unguarded(Arm):
    watchdog_s = None


class Switched(Arm):
    dead_man = 0


class Rig:
    """A paired side around an `Arm`, with a set-position 20 mm away; every tick is 2 ms."""

    def __init__(self, device: type[Arm] = Arm, **params: object) -> None:
        self.events: list[str] = []
        self.levels: list[str] = []
        self.now_ns = 0
        given = {
            "hardware": f"{device.__module__}:{device.__name__}", "scene": "free", "device.damping": 1e-9,
            "device.step_limit_N": 0.0, "device.force_ramp_s": 0.0, "device.self_test_N": 0.0,
        } | {name.replace("__", "."): value for name, value in params.items()}  # fmt: skip
        setup = prepare(PAPER.set(given))
        assert setup.params.device.servo_hz == 500.0
        side = device_side(setup, DeviceEndpoint(device_session(setup, 1)), lambda: self.now_ns, self._write)
        assert isinstance(side, RealDeviceSide)
        self.side = side
        self.arm: Arm = side.device.device  # type: ignore[attr-defined]  # the user's, inside
        side.endpoint.paired = True
        self.tick(0.0, ms=0)
        side.coupling.receive((0.02,), 0.0, 0.0)

    def _write(self, sample: Sample) -> None:
        if isinstance(sample, Event) and sample.kind != "signal":
            self.events.append(f"{sample.kind}: {sample.text}")
            self.levels.append(sample.level)

    def tick(self, x: float, ms: int = 2, times: int = 1) -> None:
        self.arm.x = x
        for _ in range(times):
            self.now_ns += ms * MS
            self.side.tick(self.now_ns)

    @property
    def work(self) -> float:
        return self.side.coupling.ledger.work


def test_the_servo_is_no_faster_than_the_device() -> None:
    assert prepare(PAPER.set({"hardware": "tests.side.test_real_device:Arm"})).params.device.servo_hz == 500.0
    slower = PAPER.set({"hardware": "tests.side.test_real_device:Arm", "device.servo_hz": 200.0})
    assert prepare(slower).params.device.servo_hz == 200.0


def test_before_pairing_the_device_hears_zero_forces() -> None:
    setup = prepare(PAPER.set({"hardware": "tests.side.test_real_device:Arm", "scene": "free"}))
    side = device_side(setup, DeviceEndpoint(device_session(setup, 1)), lambda: 0, lambda sample: None)
    assert isinstance(side, RealDeviceSide)
    for _ in range(3):
        side.tick(0)
    assert side.device.device.reported == [(0.0,)] * 3  # type: ignore[attr-defined]
    assert side.origin_ns is None


def test_a_silent_device_gets_no_force_and_one_line_each_way() -> None:
    rig = Rig()
    for k in range(5):
        rig.tick(1e-4 * k)
    assert rig.arm.reported[-1][0] > 1.0
    rig.arm.silent = True
    rig.tick(0.0, times=100)
    assert rig.arm.reported[-98:] == [(0.0,)] * 98  # after the 5 ms of its watchdog
    assert rig.arm.reported[-99][0] > 1.0
    rig.arm.silent = False
    rig.tick(5e-4, times=3)
    assert rig.events == [
        "device: the device tests.side.test_real_device:Arm is silent, no force: no answer for 5 ms",
        "device: the device tests.side.test_real_device:Arm is back after 202.0 ms: the force grows",
    ]
    assert rig.levels == ["warning", "info"]
    part = device_summary(rig.side, "pspm")
    assert part["driver"] == {
        "name": "tests.side.test_real_device:Arm",
        "missed": 100,
        "silences": 1,
        "silent_s": 0.202,
        "hot_s": 0.0,
        "mass_kg": None,
        "blocked": None,
        "reads_hz": None,
        "contact_missed": None,
    }


def test_a_device_that_gave_no_reading_after_it_was_opened_fails_and_its_run_is_not_complete() -> None:
    setup, now_ns = prepare(PAPER.set({"hardware": "tests.side.test_real_device:Arm", "scene": "free"})), 0
    side = device_side(setup, DeviceEndpoint(device_session(setup, 1)), lambda: now_ns, lambda sample: None)
    assert isinstance(side, RealDeviceSide)
    side.endpoint.paired = True
    side.device.device.silent = side.device.device.deaf = True  # type: ignore[attr-defined]  # after it was opened
    for now_ns in range(0, round(FIRST_READING_S * 1e9) + 1, 100 * MS):
        side.tick(now_ns)
    part = device_summary(side, "pspm")
    assert findings({"device": part, "coupling": "pspm"})[0].cause == "no reading"
    assert incomplete({"device": part, "coupling": "pspm"}) == [
        "the device's account is missing: tests.side.test_real_device:Arm gave no reading"
    ]
    now_ns += MS
    with pytest.raises(HapnetError, match="Arm failed: no reading within 10 s: no answer for 5 ms"):
        side.tick(now_ns)


@pytest.mark.parametrize("to", [-0.03, 0.03])
def test_what_a_silence_hid_never_counts_as_energy_taken_in(to: float) -> None:
    """2 N towards +x. Going on to -x would have taken energy in, had the force still acted: that does not count. Going
    with it counts in full, as far as the device can go (0.5 m/s) in the 5 ms until its own watchdog acts."""
    rig = Rig()
    rig.tick(0.0, times=3)
    held, before = rig.arm.reported[-1][0], rig.work
    assert held == pytest.approx(2.0)
    rig.arm.silent = True
    rig.tick(0.0, ms=10)
    rig.arm.silent = False
    rig.tick(to, ms=200)
    assert rig.work - before == pytest.approx(-held * 0.5 * 0.005 if to > 0.0 else 0.0, rel=1e-9, abs=1e-15)


def test_only_a_device_without_a_watchdog_of_its_own_is_held_less_after_an_overrun() -> None:
    """100 N/m, 20 mm: 2 N. The servo is away for 202 ms at 0.5 m/s: 0.1 J cover 1 N over such a way."""
    forces = []
    for device in (Arm, Unguarded):
        rig = Rig(device)
        rig.tick(0.0)
        rig.tick(0.0, ms=202)
        assert rig.arm.reported[-1] == (0.0,)
        rig.side.coupling.receive((0.02,), 0.0, 0.0)
        rig.tick(0.0, times=5)
        forces.append(rig.arm.reported[-1][0])
    assert forces == pytest.approx([2.0, 0.1 / 0.101], rel=0.02)


def test_without_a_watchdog_of_its_own_the_whole_way_counts() -> None:
    rig = Rig(Unguarded)
    rig.tick(0.0, times=3)
    held, before = rig.arm.reported[-1][0], rig.work
    rig.arm.silent = True
    rig.tick(0.0)
    rig.arm.silent = False
    rig.tick(0.03, ms=200)
    assert rig.work - before == pytest.approx(-held * 0.03, rel=1e-9)
    part = device_summary(rig.side, "pspm")
    assert part["overrun_leak_J"] == pytest.approx(held * 0.03 - 0.05, abs=0.01)  # beyond what the account held
    assert part["overrun_risk_J"] > 0.1  # 0.5 m/s for 0.2 s at 2 N, less the account


@pytest.mark.parametrize("way", [1, -1])
def test_a_command_that_did_not_go_out_leaves_the_older_force_in_doubt(way: int) -> None:
    """The cable is out while 1.9 N are asked for, and 2 N were held: going on, the worse one counts; back, neither."""
    rig = Rig()
    rig.tick(0.0, times=3)
    older = rig.arm.reported[-1][0]
    assert older == pytest.approx(2.0)
    rig.arm.deaf = True
    rig.tick(0.001)
    rig.arm.deaf = False
    before = rig.work
    rig.tick(0.001 + way * 0.0005)
    assert rig.work - before == pytest.approx(-older * 0.0005 if way > 0 else 0.0, rel=1e-6, abs=1e-15)


def test_the_dead_man_switch_takes_the_force_away_at_once() -> None:
    rig = Rig(Switched, device__force_ramp_s=0.02)
    rig.tick(0.0, times=20)
    assert (full := rig.arm.reported[-1][0]) == pytest.approx(2.0)
    rig.arm.pressed = False
    rig.tick(0.0)
    assert rig.arm.reported[-1] == (0.0,)
    rig.arm.pressed = True
    rig.tick(0.0, times=5)
    assert 0.0 < rig.arm.reported[-1][0] < full
    assert rig.events == [
        "dead-man: the dead-man switch is not held: no force",
        "dead-man: the dead-man switch is held: the force grows",
    ]
    assert rig.levels == ["warning", "info"]


class Braking(Arm):
    """It reports which force acted, as long as it knows it; that is a belief."""

    knows_force = False
    why = ""
    told_force: Vector | None = (0.0,)

    def braked(self) -> str:
        return self.why

    def acted(self) -> Vector | None:
        return self.told_force

    def apply(self, force: Vector) -> None:  # type: ignore[override]  # it does not say
        super().apply(force)


def test_a_brake_takes_the_force_away_at_once_and_then_it_grows() -> None:
    rig = Rig(Braking, device__force_ramp_s=0.02)
    rig.tick(0.0, times=20)
    full = rig.arm.reported[-1][0]
    assert full == pytest.approx(2.0)
    rig.arm.why = "its brake is on"
    rig.tick(0.0)
    rig.tick(0.0)
    assert rig.arm.reported[-2:] == [(0.0,)] * 2
    rig.arm.why = ""
    rig.tick(0.0, times=5)
    assert 0.0 < rig.arm.reported[-1][0] < full
    assert rig.events == [
        "device: the device tests.side.test_real_device:Braking renders no force: its brake is on",
        "device: the device tests.side.test_real_device:Braking renders force again: it grows",
    ]
    assert rig.levels == ["warning", "info"]
    assert not rig.side.applied  # it is only believed


@pytest.mark.parametrize(("to", "counts"), [(0.001, 1.0), (-0.001, 0.0)])
def test_where_a_device_that_tells_its_force_does_not_only_what_it_put_out_counts(to: float, counts: float) -> None:
    rig = Rig(Braking)
    rig.tick(0.0, times=3)
    before = rig.work
    rig.arm.told_force = None
    rig.tick(to)
    assert rig.work - before == pytest.approx(-counts * 2.0 * 0.001, rel=1e-6, abs=1e-15)


def test_energy_is_counted_from_the_force_that_the_limiter_let_through() -> None:
    rig = Rig(device__force_ramp_s=1.0)
    rig.tick(0.0)
    for k in range(1, 50):
        rig.tick(1e-4 * k)
    forces = [force[0] for force in rig.arm.reported]
    assert max(forces) < 0.25  # a tenth of the ramp at 2 N
    assert rig.work == pytest.approx(-sum(f * 1e-4 for f in forces[-50:-1]), rel=1e-6)


@pytest.mark.parametrize(("words", "says"), [("5", "which has 1"), ("left", "a button's number")])
def test_a_switch_that_the_device_does_not_have_is_refused(words: str, says: str) -> None:
    setup = prepare(PAPER.set({"hardware": f"{__name__}:Arm", "scene": "free", "device.dead_man": words}))
    with pytest.raises(InvalidParameter, match=says):
        device_side(setup, DeviceEndpoint(device_session(setup, 1)), lambda: 0, lambda sample: None)


def test_at_the_end_it_is_closed_once_and_after_its_last_force() -> None:
    rig = Rig()
    rig.tick(0.0, times=3)
    rig.side.stop()
    rig.side.stop()
    assert rig.arm.reported[-1] == (0.0,)
    assert rig.arm.closed


def test_one_that_cannot_be_told_at_the_end_is_named_and_closed() -> None:
    rig = Rig()
    rig.tick(0.0)
    rig.arm.deaf = True
    rig.side.stop()
    assert rig.arm.closed
    assert "did not end its force: the cable is out" in rig.events[-1]
    assert rig.levels[-1] == "error"


class NeverPressed(Switched):
    def __init__(self, dof: int) -> None:
        super().__init__(dof)
        self.pressed = False


def test_a_switch_that_nobody_holds_is_told_at_the_start() -> None:
    rig = Rig(NeverPressed)
    rig.tick(0.0, times=3)
    assert rig.events == ["dead-man: the dead-man switch is not held: no force"]
    assert rig.arm.reported[-1] == (0.0,)


class Numbered(Arm):
    def buttons(self) -> tuple[int, ...]:  # type: ignore[override]
        return (0,)


class Misnumbered(Arm):
    dead_man = 3


class InMillinewtons(Arm):
    def apply(self, force: Vector) -> Vector:
        return tuple(1e3 * component for component in force)


class Bare(Arm):
    def apply(self, force: Vector) -> Vector:
        return 0.0  # type: ignore[return-value]


@pytest.mark.parametrize(
    ("device", "says"),
    [
        (Numbered, r"buttons\(\) gave \(0,\) instead of a True or False for each button"),
        (Misnumbered, r"dead_man is 3; allowed: the number of one of its 1 buttons, from 0"),
        (InMillinewtons, r"apply\(\) gave \(\d{4}.*\) instead of a force within its force_limit, 3 N \(is the unit N"),
        (Bare, r"apply\(\) gave 0\.0 instead of the applied force, 1 finite numbers, or None"),
    ],
)
def test_a_driver_that_means_something_else_is_named(device: type[Arm], says: str) -> None:
    def run() -> None:
        rig = Rig(device)
        rig.tick(0.0, times=3)

    with pytest.raises(HapnetError, match=says):
        run()


class NeverHome(Arm):
    def home(self) -> None:
        raise HapnetError("put the handle into its dock first")


def test_one_that_is_not_calibrated_says_what_to_do() -> None:
    setup = prepare(PAPER.set({"hardware": "tests.side.test_real_device:NeverHome", "scene": "free"}))
    with pytest.raises(HapnetError, match=r"^the device .*NeverHome is not ready: put the handle into its dock first$"):
        device_side(setup, DeviceEndpoint(device_session(setup, 1)), lambda: 0, lambda sample: None)


class Late(Arm):
    """Each force acts a tick later than asked for; `work` is what the actuator really took in."""

    def __init__(self, dof: int) -> None:
        super().__init__(dof)
        self.acting = self.next = 0.0
        self.last_x = self.work = self.changes = 0.0

    def read(self) -> tuple[Vector, Vector]:
        moved, self.last_x = self.x - self.last_x, self.x
        self.work -= self.acting * moved
        self.changes += (self.next - self.acting) * moved
        return super().read()

    def apply(self, force: Vector) -> Vector:
        self.acting, self.next = self.next, force[0]
        return super().apply(force)


class LateAndTold(Late):
    """The same, but it reports what acted between its last two readings."""

    def read(self) -> tuple[Vector, Vector]:
        self.told_N = self.acting
        return super().read()

    def acted(self) -> Vector:
        return (self.told_N,)


@pytest.mark.parametrize("device", [Late, LateAndTold])
def test_a_force_that_acts_late_is_counted_where_it_is_told(device: type[Late]) -> None:
    """If it is not reported, the account is wrong by the sum of dF dx, as hapnet/devices/README.md says."""
    rig = Rig(device)
    for k in range(200):
        rig.tick(2e-3 * math.sin(0.1 * k))
    arm = rig.arm
    assert abs(arm.changes) > 1e-6
    unseen = 0.0 if device is LateAndTold else arm.changes
    assert rig.work == pytest.approx(arm.work - unseen, abs=1e-12)
