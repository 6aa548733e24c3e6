"""Position-force with a robot of a driver: the hand feels what its sensor measures, and never a sensor that fails."""

import math
from collections import deque
from collections.abc import Callable
from contextlib import nullcontext
from itertools import count, cycle
from typing import Any, ClassVar

import numpy as np
import pytest

from hapnet.assembly.build import device_session, device_side, prepare, world_session
from hapnet.assembly.user_device import UserDevice
from hapnet.checks import Vector
from hapnet.cli import main
from hapnet.devices.driver import Driver
from hapnet.errors import DeviceSilent, InvalidParameter
from hapnet.ext.doctor.device import examine_device
from hapnet.ext.robots.robot_side import robot_side
from hapnet.params import Params
from hapnet.recording.samples import DeviceSample, Event, WorldSample
from hapnet.side.contact_force import HELD_NS
from hapnet.side.endpoint import DeviceEndpoint
from hapnet.summary.run import device_summary
from hapnet.wire.session import Session
from tests.conftest import mostly_slow
from tests.support.own_motion import largest_step

MS = 1_000_000
WALL_NPM, WALL_M = 300.0, 0.01
HERE = "tests.side.test_contact_force"


class Robot(Driver):
    """0.3 kg before a wall; its sensor says the wall's force, or what a test puts in `reports`."""

    rate_hz = 1000.0
    force_limit, greatest_speed, workspace, smallest_mass = 10.0, 2.0, 1.0, 0.3

    def __init__(self, dof: int) -> None:
        self.dof, self.x, self.v, self.force = dof, 0.0, 0.0, 0.0
        self.begun = False
        self.reports: Callable[[float], Any] = lambda force: (force,)

    def begin(self) -> None:
        self.begun = True

    @property
    def wall(self) -> float:
        return -WALL_NPM * max(0.0, self.x - WALL_M)

    def read(self) -> tuple[Vector, Vector]:
        if self.begun:
            self.v += 1e-3 * (self.force + self.wall - 4.0 * self.v) / 0.3
            self.x += 1e-3 * self.v
        return (self.x,), (self.v,)

    def apply(self, force: Vector) -> Vector:
        self.force = force[0]
        return force

    def contact_force(self) -> Vector | None:
        return self.reports(self.wall)


class Numb(Robot):
    contact_force = Driver.contact_force


class Unplugged(Robot):
    def contact_force(self) -> None:
        return


class Ranged(Robot):
    stiffness_range, damping_range = (100.0, 2000.0), (1.0, 20.0)


class Late(Robot):
    """Its sensor says nothing at the first three readings."""

    forces = 3

    def contact_force(self) -> Vector | None:
        self.forces -= 1
        return None if self.forces else (0.0,)


class Awaited(Late):
    def home(self) -> None:
        self.forces = 1


class Pair:
    """A simulated hand that presses, and the robot, one tick a millisecond in virtual time, 10 ms apart."""

    def __init__(self, **changes: object) -> None:
        given = {
            "scene": "free", "follower.robot": f"{HERE}:Robot", "follower.feedback": "force", "operator": "press",
            "operator_model.goal_m": 0.02, "operator_model.hold_s": 10.0, "device.servo": "sampled",
            "record_hz": 1000.0,
            "world.stiffness": 400.0, "world.damping": 10.0,
        }  # fmt: skip
        setup = prepare(Params().set({**given, **{name.replace("__", "."): one for name, one in changes.items()}}))
        self.now_ns = 0
        self.felt: list[float] = []
        self.places: list[float] = []
        self.recorded: list[float] = []
        self.events: list[str] = []
        self.leader = device_side(setup, DeviceEndpoint(device_session(setup, 1)), lambda: self.now_ns, self._take)
        self.follower = robot_side(setup, DeviceEndpoint(world_session(setup, 2)), lambda: self.now_ns, self._take)
        self.robot: Robot = self.follower.device.device  # type: ignore[attr-defined]  # the test's, inside
        self.wall: list[float] = []
        self._on_the_way: deque[tuple[int, Any, bytes]] = deque()

    def _take(self, sample: Any) -> None:
        match sample:
            case DeviceSample():
                self.felt.append(sample.force_N[0])
                self.places.append(sample.position_m[0])
            case WorldSample():
                self.recorded.append(sample.contact_force_N[0])
            case Event(kind="device"):
                self.events.append(sample.text)

    def run(self, ticks: int) -> None:
        for _ in range(ticks):
            self.now_ns += MS
            while self._on_the_way and self._on_the_way[0][0] <= self.now_ns:
                _, to, data = self._on_the_way.popleft()
                to.endpoint.receive(self.now_ns, data)
            for side, peer in ((self.leader, self.follower), (self.follower, self.leader)):
                tick: Any = side.tick
                message = tick(self.now_ns)
                others = [one.data for one in side.endpoint.poll(self.now_ns)[0]]  # type: ignore[attr-defined]
                for data in filter(None, [message, *others]):
                    self._on_the_way.append((self.now_ns + 10 * MS, peer, data))
            self.wall.append(self.robot.wall)


@pytest.mark.parametrize("rendering", mostly_slow(["paper", "hapnet"], 1))
@pytest.mark.parametrize(("a", "b"), mostly_slow([(0.5, 2.0), (1.0, 1.0), (1.0, 0.5)], 1))
def test_the_hand_feels_b_times_the_force_on_the_robot(rendering: str, a: float, b: float) -> None:
    pair = Pair(rendering=rendering, follower__motion_scale=a, follower__force_scale=b, operator_model__goal_m=0.02 / a)
    pair.run(2400)
    wall, felt = np.array(pair.wall[-150:]), np.array(pair.felt[-150:])
    assert wall.mean() < -0.3
    assert felt.mean() == pytest.approx(b * wall.mean(), rel=0.03)
    assert pair.recorded[-1] == pytest.approx(b * pair.wall[-1])
    for side in (pair.leader, pair.follower):
        assert side.coupling.ledger.slack_min >= -1e-12
        assert side.coupling.ledger.margin_min >= 0.0


def silent(force: float) -> Vector:
    raise DeviceSilent("no answer of the sensor")


@pytest.mark.parametrize(
    "fault",
    mostly_slow(
        [(one,) for one in [lambda f: None, lambda f: (math.nan,), lambda f: (math.inf,), lambda f: (-1e30,), silent]],
        1,
    ),
)
def test_a_sensor_that_fails_never_jumps_the_hand(fault: Callable[[float], Any]) -> None:
    """A short fault is not felt. A long one: no force any more, and the force again, all by the step limit's steps."""
    pair = Pair(rendering="paper", device__stiffness=100.0)
    pair.run(2000)
    steady = np.mean(pair.felt[-50:])
    assert steady < -0.3
    pair.robot.reports = fault
    pair.run(HELD_NS // MS)
    assert np.array(pair.felt[-50:]) == pytest.approx(steady, rel=0.1)
    assert not any("contact force" in one for one in pair.events)
    pair.run(200)
    assert np.mean(np.abs(pair.felt[-50:])) < 0.2 * abs(steady)
    pair.robot.reports = lambda force: (-9e3,)  # a number, and nonsense
    pair.run(1)
    pair.robot.reports = lambda force: (force,)
    pair.run(400)
    assert np.mean(pair.felt[-50:]) < 0.7 * steady
    assert pair.events[-2:] == [
        f"the contact force of {HERE}:Robot is missing: it counts as zero",
        f"the contact force of {HERE}:Robot is measured again",
    ]
    felt, places = np.array([pair.felt]).T, np.array([pair.places]).T
    assert largest_step(felt, places, 100.0) <= 0.5 + 1e-9
    assert device_summary(pair.follower, "pspm")["driver"]["contact_missed"] == HELD_NS // MS + 200
    assert pair.leader.coupling.ledger.slack_min >= -1e-12


@pytest.mark.parametrize("wrong", [(0.0, 0.0), "N", 3.0, (10**400,)])
def test_a_driver_that_gives_something_else_ends_the_run(wrong: object) -> None:
    pair = Pair()
    pair.run(200)
    pair.robot.reports = lambda force: wrong
    with pytest.raises(Exception, match=r"Robot failed: contact_force\(\) gave"):
        pair.run(2)


def test_a_driver_that_measures_none_is_refused_before_the_run(capsys: pytest.CaptureFixture[str]) -> None:
    line = ["run", "--scene", "free", "--dof", "1", "--set", "follower.feedback=force", "--follower"]
    for driver in (f"{HERE}:Numb", "dynamixel:/dev/null", "serial:/dev/null"):
        assert main([*line, driver]) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        assert "follower.feedback" in said
        assert "measures no contact force" in said
        assert "(franka, ros2)" in said
    with pytest.raises(InvalidParameter, match="measures no contact force"):
        Pair(follower__robot=f"{HERE}:Unplugged")  # its class has the method, its first readings nothing


def test_a_driver_waits_itself_for_a_sensor_that_begins_late() -> None:
    with pytest.raises(InvalidParameter, match="measures no contact force"):
        Pair(follower__robot=f"{HERE}:Late")
    assert Pair(follower__robot=f"{HERE}:Awaited").robot.forces == 0


class Soft(Robot):
    """Too soft for every spring here. closings : of all of its kind."""

    stiffness_range = (0.0, 10.0)
    closings: ClassVar[list[int]] = []

    def close(self) -> None:
        self.closings.append(1)


@pytest.mark.parametrize(
    ("name", "make", "session"),
    [("hardware", device_side, device_session), ("follower.robot", robot_side, world_session)],
)
def test_one_that_is_refused_after_it_was_opened_is_closed(
    name: str, make: Callable[..., object], session: Callable[..., Session]
) -> None:
    setup = prepare(Params().set({name: f"{__name__}:Soft", "scene": "free", "device.stiffness": 100.0}), "sampled")
    Soft.closings.clear()
    with pytest.raises(InvalidParameter, match="stiffness"):
        make(setup, DeviceEndpoint(session(setup, 1)), lambda: 0, lambda sample: None)
    assert Soft.closings == [1]


def test_a_leader_is_not_asked_for_a_contact_force() -> None:
    assert UserDevice(f"{HERE}:Late", 1).device.forces == 3  # type: ignore[attr-defined]  # the test's


def test_the_doctor_shows_it_so_that_its_sign_is_seen() -> None:
    device = UserDevice(f"{HERE}:Robot", 1)
    forces = cycle([-0.5, math.nan, -0.5, -3.0, -0.5])
    device.device.reports = lambda force: (next(forces),)  # type: ignore[attr-defined]
    found = {one.name: one for one in examine_device(device, 1000.0, count(0, MS).__next__, lambda seconds: None)}
    assert found["contact force"].value == "-0.5 N, up to -3 N"
    device.device.units = "rad"  # type: ignore[attr-defined]
    found = {one.name: one for one in examine_device(device, 1000.0, count(0, MS).__next__, lambda seconds: None)}
    assert found["contact force"].value == "-0.5 Nm, up to -3 Nm"
    numb = examine_device(UserDevice(f"{HERE}:Numb", 1), 1000.0, count(0, MS).__next__, lambda seconds: None)
    assert "contact force" not in [one.name for one in numb]


def test_what_it_cannot_be_is_named() -> None:
    for changes in ({"follower__feedback": "planes"}, {"scene": "tool:box"}):
        with pytest.raises(InvalidParameter) as caught:
            Pair(**changes)
        assert caught.value.name == "follower.feedback"


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"world__stiffness": 100.0, "world__damping": 20.0}, ""),
        ({"world__stiffness": 99.0}, "world.stiffness is 99.0; allowed: 100 to 2000 N/m .* as the device renders$"),
        ({"world__damping": 20.1}, "world.damping is 20.1; allowed: 1 to 20 Ns/m, as the device renders"),
    ],
)
def test_the_worlds_spring_and_damper_are_within_what_the_robot_renders(changes: dict[str, float], says: str) -> None:
    with pytest.raises(InvalidParameter, match=says) if says else nullcontext():
        Pair(follower__robot=f"{HERE}:Ranged", **changes)
