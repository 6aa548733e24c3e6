"""A robot that takes positions, behind a mock of ros2_control in virtual time, and its account."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags.typesys")
pytest.importorskip("xxhash")

from hapnet import simulate
from hapnet.errors import DeviceSilent, HapnetError, InvalidParameter
from hapnet.ext.engines.observer import Observer
from hapnet.ext.robots.position_robot import SetPointLimits
from hapnet.ext.robots.position_world import PositionWorld
from hapnet.ext.robots.ros2_positions import Ros2Positions
from hapnet.ext.robots.target_age import TargetAge
from tests.conftest import mostly_slow
from tests.support.position_rig import MS, Cut, PositionRig, cut
from tests.support.ros2_control import CONTROLLERS, STORE

WATCHDOG_MS = 100.0
WHERE = ("leader", "lost", "late", "stale")
TIMED = ("TwistStamped", "JointTrajectory")
"""The types with a time that their controllers check."""

CASES = [*[(kind, 100.0) for kind in CONTROLLERS], ("PoseStamped", 500.0)]


def judge(rig: PositionRig, where: str, found: Cut) -> None:
    """The bounds of the page. A network to the robot that is cut ends in a jump that the time until it is noticed
    bounds: three periods, and 20 ms at least; then a period until the next message."""
    period_ms = rig.controller.period_ns / MS
    kind = rig.controller.kind.rpartition("/")[2]
    assert found.moved > 0.002, "it follows"
    assert found.sent <= rig.step
    unnoticed_s = 1e-3 * (max(20.0, 3.0 * period_ms) + 2.0 * period_ms)
    assert found.step <= rig.step + (rig.speed * unnoticed_s if where != "leader" else 0.0)
    assert found.oldest_ms <= WATCHDOG_MS, "nothing stale is executed"
    assert found.sent_ms <= WATCHDOG_MS + period_ms
    ends_ms = 2.0 * period_ms if kind == "JointTrajectory" else 0.0  # its last point lies two periods ahead
    assert found.stops_ms <= WATCHDOG_MS + 2.0 * period_ms + 1.0 + ends_ms  # a period of each, and the network


def cuts(kind: str, hz: float, times: int, seed: int = 1) -> None:
    rig, rng = PositionRig(kind, hz, seed), np.random.default_rng(seed)
    rig.run(300)
    for i in range(times):
        where = (WHERE if kind in TIMED else WHERE[:3])[i % (4 if kind in TIMED else 3)]
        judge(rig, where, cut(rig, where, rng))


@pytest.mark.parametrize(("kind", "hz"), CASES)
def test_cuts_of_the_links_make_no_jump_and_execute_nothing_stale(kind: str, hz: float) -> None:
    cuts(kind, hz, 4)


@pytest.mark.parametrize("checked", [True, False])
def test_old_set_points_of_the_leader_that_come_at_once_are_not_executed(
    checked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """0.4 s after the link was cut, what it held of the first 50 ms is delivered, and nothing else."""
    if not checked:
        hear = TargetAge.hear

        def without_transit(age: TargetAge, now_ns: int, came_ns: int, took_ns: int) -> None:
            hear(age, now_ns, came_ns, min(took_ns, 20 * MS))

        monkeypatch.setattr(TargetAge, "hear", without_transit)
    rig = PositionRig("PoseStamped", 100.0)
    rig.run(700)
    rig.linked = False
    rig.run(1100)
    rig.deliver_kept(20)
    since = len(rig.controller.executed)
    rig.run(1300)
    moved = float(np.ptp([one.position[0] for one in rig.controller.executed[since:]]))
    assert (moved == 0.0) == checked


@pytest.mark.slow
@pytest.mark.parametrize("hz", [100.0, 500.0])
def test_a_hundred_cuts(hz: float) -> None:
    for seed, kind in enumerate(CONTROLLERS):
        cuts(kind, hz, 25, 10 + seed)


def always(value: object) -> Callable[..., object]:
    return lambda *given: value


@pytest.mark.parametrize(
    ("part", "name", "value"),
    [(TargetAge, "why", ""), (SetPointLimits, "share", 1.0)],
    ids=["without watchdog", "without limits"],
)
def test_the_judge_notices_what_is_switched_off(
    part: type, name: str, value: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(part, name, always(value))
    with pytest.raises(AssertionError):
        cuts("PoseStamped", 100.0, 3)


def test_the_step_is_limited_where_the_speed_would_allow_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        SetPointLimits, "of", classmethod(lambda cls, robot: cls(100.0, 0.25, 1.0, 0.05, 0.1, 200.0, False))
    )
    with pytest.raises(AssertionError):
        cuts("PoseStamped", 100.0, 3)


def test_the_first_set_point_is_where_the_robot_is_wherever_the_hand_is() -> None:
    rig = PositionRig("PoseStamped", 100.0)
    rig.run(100)
    assert rig.controller.received[0][0] == pytest.approx(0.3, abs=rig.step)
    pose = STORE.deserialize_cdr(rig.network.published[0][1], rig.controller.kind).pose
    assert (pose.position.y, pose.position.z) == (0.5, 0.7), "what is not led stays"
    assert (pose.orientation.x, pose.orientation.w) == (0.0, 1.0)


def moved_before_the_first_step(rig: PositionRig) -> None:
    while rig.world.origin_ns is None:
        rig.run(rig.now_ns // MS + 1)
    rig.controller.position += 0.03
    rig.network.send_state()
    rig.run(rig.now_ns // MS + 30)


def test_a_robot_that_is_elsewhere_at_the_first_step_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = PositionRig("PoseStamped", 100.0)
    rig.controller.update = always(None)  # type: ignore[method-assign]
    with pytest.raises(HapnetError, match=r"first set-point is 0\.03 m from its measured position; allowed: 0\.005 m"):
        moved_before_the_first_step(rig)
    assert not rig.network.published
    rig.world.scene.close()
    assert not rig.network.published, "a last command would be a jump"
    assert rig.network.closed
    monkeypatch.setattr(PositionWorld, "_came", always(""))
    rig = PositionRig("PoseStamped", 100.0)
    moved_before_the_first_step(rig)
    assert rig.network.published, "without the check it is thrown"


def test_nothing_is_sent_before_a_position_has_come(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = PositionRig("PoseStamped", 100.0)
    while rig.world.origin_ns is None:
        rig.run(rig.now_ns // MS + 1)
    rig.network.interrupt("lost")
    rig.run(rig.now_ns // MS + 25)
    before = len(rig.network.published)
    rig.run(rig.now_ns // MS + 100)
    holds = {round(x, 9) for x in asked(rig)[before:]}
    assert len(holds) == 1

    silent = PositionRig("PoseStamped", 100.0)
    monkeypatch.setattr(Ros2Positions, "read", raises)
    monkeypatch.setattr("hapnet.ext.robots.position_world.TRIES", 2)
    with pytest.raises(HapnetError, match="gives no position at the start: a test keeps it silent"):
        silent.run(200)
    assert not silent.network.published


def raises(robot: Ros2Positions) -> None:
    raise DeviceSilent("a test keeps it silent")


def asked(rig: PositionRig) -> list[float]:
    messages = [STORE.deserialize_cdr(data, rig.controller.kind) for _, data in rig.network.published]
    return [rig.controller.asked(message)[0] for message in messages]


def test_a_robot_that_is_moved_by_hand_is_not_pulled_back() -> None:
    rig = PositionRig("PoseStamped", 100.0)
    rig.run(500)
    rig.controller.position += 0.15
    with pytest.raises(HapnetError, match=r"from its set-point; allowed: 0\.1 m"):
        rig.run(520)
    rig.world.scene.close()
    before, last = asked(rig)[-2:]
    assert last - before > 0.1, "it stays where it is"


@pytest.mark.parametrize("kind", CONTROLLERS)
def test_its_last_message_stops_it(kind: str) -> None:
    rig = PositionRig(kind, 100.0)
    rig.run(500)
    count = len(rig.network.published)
    rig.world.scene.close()
    before, last = [
        rig.controller.asked(STORE.deserialize_cdr(data, rig.controller.kind))
        for _, data in (rig.network.published[count - 1], rig.network.published[-1])
    ]
    if kind == "TwistStamped":
        assert abs(before[0]) > 0.05
        assert last == (0.0,)
        assert len(rig.network.published) == count + 1
    else:
        assert last == pytest.approx(before, abs=1e-9)
    assert rig.network.closed


@pytest.mark.parametrize("cause", ["dead-man", "closed page", "remote stop", "remote stop at the robot"])
@pytest.mark.parametrize("on_stop", ["freeze", "release"])
def test_what_stops_a_robot_stops_this_one(cause: str, on_stop: str) -> None:
    """0.2 s and one way after the cause it stands, as `stops.md` says; then it is led from where it is."""
    rig = PositionRig("PoseStamped", 100.0, **{"follower.on_stop": on_stop})
    rig.run(700)
    if cause == "dead-man":
        rig.held = False
    elif cause == "closed page":
        rig.device.let_go = "the page is closed"
    elif cause == "remote stop":
        rig.leader.stop_force("a test stops it")
    else:
        rig.far.stop_force("a test stops it")
    assert np.ptp([one.position for one in rig.controller.executed]) > 0.02
    rig.run(700 + 200 + 20)
    since = len(rig.controller.executed)
    rig.run(1500)
    stands = [one.position[0] for one in rig.controller.executed[since:]]
    assert np.ptp(stands) < 1e-3
    rig.held, rig.device.let_go = True, ""
    rig.run(2500)
    again = np.array([one.position[0] for one in rig.controller.executed[since:]])
    assert np.abs(np.diff(again)).max() <= rig.step
    assert (np.ptp(again) > 0.02) == (not cause.startswith("remote")), "a remote stop is for good"


def test_another_leader_leads_after_one_that_had_released_it() -> None:
    rig = PositionRig("PoseStamped", 100.0)
    rig.run(700)
    rig.held = False
    rig.run(1000)
    rig.held = True
    rig.begin_leader(7)
    since = len(rig.controller.executed)
    rig.run(5000)
    places = [one.position[0] for one in rig.controller.executed[since:]]
    assert np.abs(np.diff(places)).max() <= rig.step
    assert np.ptp(places) > 0.02


class Arm:
    """A simulated arm, 20 ms late, in front of foam at 20 mm; `lies` : what its sensor says instead."""

    simulated, rate_hz = True, 100.0
    lies: Callable[[float, float], float] | None = None

    def __init__(self, dof: int, senses: bool = True) -> None:
        self.dof, self.x, self.v = dof, 0.0, 0.0
        self._senses = senses

    def read(self) -> tuple[float, ...]:
        return (self.x,)

    def move(self, dt: float, position: tuple[float, ...], velocity: tuple[float, ...]) -> None:
        self.x += (position[0] - self.x) * min(1.0, dt / 0.02)
        self.v = velocity[0]

    def contact_force(self) -> tuple[float, ...] | None:
        if not self._senses:
            return None
        return (-300.0 * max(0.0, self.x - 0.02) if Arm.lies is None else Arm.lies(self.x, self.v),)


def led(name: str, **changes: object) -> Any:
    return simulate(
        {
            "follower.robot": name, "scene": "free", "dof": 1, "operator": "press", "link.up": "4g", "link.down": "4g",
            "duration_s": 3.0, "record_hz": 1000.0, "device.servo": "sampled", **changes,
        },
        seed=3,
    )  # fmt: skip


def sums(result: Any) -> tuple[Any, float]:
    """The work of the robot's force on the proxy [J], after each step; and the least energy that both ports together
    have taken in [J], from the recorded samples."""
    world, device = result.recording.world, result.recording.device
    x = np.concatenate([world["position_m"][:1], world["position_m"]])
    work = np.cumsum(world["contact_force_N"][:, 0] * np.diff(x[:, 0]))
    taken = -np.cumsum(device["force_N"][:-1, 0] * np.diff(device["position_m"][:, 0]))
    times = np.union1d(world["time_s"], device["time_s"][1:])
    both = np.interp(times, device["time_s"][1:], taken) + np.interp(times, world["time_s"], work)
    return work, min(0.0, float(both.min()))


@pytest.mark.parametrize(
    "lies",
    mostly_slow(
        [None, lambda x, v: 5.0 if v > 0.0 else -5.0, lambda x, v: -300.0 * (x - 0.02), lambda x, v: 1e4 * v], 2
    ),
    ids=["late", "pushes on", "pulls", "negative damping"],
)
def test_the_port_is_passive_whatever_the_robot_says(
    lies: Callable[[float, float], float] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both ports, summed up from the recorded samples alone, beside the summary's account."""
    monkeypatch.setattr(Arm, "lies", lies)
    result = led(f"{__name__}:Arm", duration_s=4.5)
    summary, own = result.summary, result.summary["environment"]
    assert summary["verdict"]["passive"] is True
    work, least = sums(result)
    assert work[-1] == pytest.approx(own["work_J"], abs=1e-9)
    assert work.max() <= 1e-12, "the robot gives out nothing, at any time"
    assert least == pytest.approx(summary["theorem"]["margin_J"] - summary["theorem"]["bound_J"], abs=2e-5)
    assert own["env_slack_J"] >= -1e-12
    assert own["env_given_J"] > 1e-3, "it would have"
    assert re.search(r"would have given .* mJ of its own, of which damping took back", summary["verdict"]["reason"])


def test_without_the_observer_it_gives_out_energy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Observer, "passive", lambda self, dt, force, free, G: (force, free + G @ force))
    monkeypatch.setattr(Arm, "lies", lambda x, v: 5.0 if v > 0.0 else -5.0)
    assert sums(led(f"{__name__}:Arm"))[0].max() > 1e-3


def test_without_a_sensor_the_hand_feels_a_spring_to_the_robot() -> None:
    result = led(f"{__name__}:Arm,senses=no")
    force = np.abs(result.recording.device["force_N"]).max()
    assert result.summary["verdict"]["passive"] is True
    assert 0.05 < force < 5.0
    with pytest.raises(HapnetError, match=r"measures no force, which follower\.feedback=force needs"):
        led(f"{__name__}:Arm,senses=no", **{"follower.feedback": "force"})


def test_a_scale_holds_for_motion_limits_and_force(monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot that goes half as far: a limit of 0.25 m/s is one of 0.5 m/s for the hand."""
    seen: list[float] = []
    move = Arm.move
    monkeypatch.setattr(Arm, "move", lambda arm, dt, x, v: (seen.append(x[0]), move(arm, dt, x, v))[1])
    result = led(f"{__name__}:Arm", **{"follower.motion_scale": 0.5, "operator": "sine", "duration_s": 2.0})
    hand = np.ptp(result.recording.world["position_m"])
    assert np.ptp(seen) == pytest.approx(0.5 * hand, rel=0.02)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("rate_hz", 5.0, "rate_hz is 5.0; allowed: 10 to 1000 Hz"),
        ("speed_limit", 0.0, "speed_limit is 0.0; allowed: a positive number, such as 0.25"),
        ("step_limit", -1.0, "step_limit is -1.0"), ("lag_limit", float("nan"), "lag_limit is nan"),
        ("watchdog_s", 2.0, "watchdog_s is 2.0; allowed: 0.02 to 1 s"),
        ("tie_stiffness", "soft", "tie_stiffness is 'soft'"), ("units", "rad", "its units are rad"),
    ],
)  # fmt: skip
def test_what_a_robot_declares_is_checked(
    name: str, value: object, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Arm, name, value, raising=False)
    with pytest.raises(InvalidParameter, match=message):
        led(f"{__name__}:Arm")
