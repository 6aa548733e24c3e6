"""The packages for LeRobot beside a thin double of its interface (lerobot 0.6.1: robots/, teleoperators/, loop).

LeRobot's own programs, parser and SO-101 classes are tested in test_lerobot_itself.py, where they are installed.
"""

import abc
import math
import sys
import threading
import time
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

import hapnet
from hapnet.transport.config import free_address
from tests.conftest import ROOT

PACKAGES = ("lerobot_robot_hapnet", "lerobot_teleoperator_hapnet")
FOLDER = ROOT / "examples" / "lerobot"
LINK = "delay 40ms 10ms distribution normal loss 5%"


def base(name: str, *parts: str) -> tuple[type, type]:
    """A base class of devices with these abstract parts, and that of its configurations."""
    known: dict[str, type] = {}

    @dataclass(kw_only=True)
    class Config:
        id: str | None = None

        @classmethod
        def register_subclass(cls, choice: str) -> Callable[[type], type]:
            return lambda one: known.setdefault(choice, one)

    part = property(abc.abstractmethod(lambda self: None))
    made = type(name, (abc.ABC,), dict.fromkeys(parts, part) | {"__init__": lambda self, config: None, "known": known})
    return made, Config


@pytest.fixture
def lerobot(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, dict[str, type]]]:
    shared = ("action_features", "is_connected", "is_calibrated", "connect", "calibrate", "configure", "disconnect")
    robot, robot_config = base("Robot", *shared, "observation_features", "get_observation", "send_action")
    teleop, teleop_config = base("Teleoperator", *shared, "feedback_features", "get_action", "send_feedback")
    robots, teleops = ModuleType("lerobot.robots"), ModuleType("lerobot.teleoperators")
    vars(robots).update(Robot=robot, RobotConfig=robot_config, make_robot_from_config=lambda made: made)
    vars(teleops).update(
        Teleoperator=teleop, TeleoperatorConfig=teleop_config, make_teleoperator_from_config=lambda made: made
    )
    draccus = ModuleType("draccus")
    vars(draccus).update(decode=lambda kind, options: options["made"], utils=SimpleNamespace(DecodingError=ValueError))
    for module in (ModuleType("lerobot"), robots, teleops, draccus):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    for package in PACKAGES:
        monkeypatch.syspath_prepend(str(FOLDER / package))
    yield {"robot": vars(robot)["known"], "teleop": vars(teleop)["known"]}
    for name in [name for name in sys.modules if name.startswith(PACKAGES)]:
        del sys.modules[name]


def test_their_names_are_found_by_lerobot() -> None:
    for package in PACKAGES:
        found = tomllib.loads((FOLDER / package / "pyproject.toml").read_text("utf-8"))
        assert found["project"]["name"] == package
        assert (FOLDER / package / package / "__init__.py").is_file()


STARTS = (-20.0, 15.0, 60.0, -40.0, 30.0, 50.0)
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


class Arm:
    """A robot of LeRobot's that goes to each action at once, its gripper no further than an object."""

    def __init__(self) -> None:
        self.at = {f"{joint}.pos": start for joint, start in zip(JOINTS, STARTS, strict=True)}
        self.action_features = dict.fromkeys(self.at, float)
        self.observation_features = self.action_features | {"front": (480, 640, 3)}
        self.cameras = {"front": object()}
        self.is_connected = self.is_calibrated = True
        self.told: list[dict[str, float]] = []

    def connect(self, calibrate: bool = True) -> None: ...

    def disconnect(self) -> None: ...

    def get_observation(self) -> dict[str, Any]:
        return dict(self.at)

    def send_action(self, action: dict[str, float]) -> dict[str, float]:
        self.told.append(action)
        self.at = action | {"gripper.pos": max(action["gripper.pos"], 45.0)}
        return action


class Sides:
    """Both sides in this process, with the defaults of six joints; `loop` is LeRobot's, with identical processors."""

    def __init__(self, **hand: Any) -> None:
        import importlib

        far = importlib.import_module("lerobot_robot_hapnet")
        near = importlib.import_module("lerobot_teleoperator_hapnet")
        address = free_address()
        self.arm = Arm()
        self.hand = far.HapnetRobot(far.HapnetRobotConfig(listen=address, params={"link.up": LINK}, **hand))
        self.teleop = near.HapnetTeleoperator(
            near.HapnetTeleoperatorConfig(connect=address, params={"link.down": LINK})
        )
        self.robot = near.HapnetArm(near.HapnetArmConfig(arm={"made": self.arm}))
        self.observed: list[dict[str, Any]] = []
        self._robot_is_ready = threading.Event()
        self._thread = threading.Thread(target=self._connect)

    def _connect(self) -> None:
        self.teleop.connect()
        self.robot.connect()
        self.loop(1)
        self._robot_is_ready.set()

    def __enter__(self) -> "Sides":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.teleop.disconnect()
        self.hand.disconnect()
        self._thread.join(60.0)

    def pair(self) -> None:
        self.hand.connect()
        assert self._robot_is_ready.wait(60.0)

    def loop(self, frames: int) -> None:
        for _ in range(frames):
            self.observed.append(self.robot.get_observation())
            self.robot.send_action(self.teleop.get_action())
            time.sleep(1.0 / 60.0)

    def lead(self, by: float, seconds: float) -> None:
        """Move the hand's six joints by so many degrees from 10, both loops running."""
        began = time.monotonic()
        while (t := time.monotonic() - began) < seconds:
            self.hand.get_observation()
            self.hand.send_action({f"{joint}.pos": 10.0 + by * min(1.0, 2.0 * t / seconds) for joint in JOINTS})
            self.loop(1)


def test_the_first_action_is_where_the_arm_is_and_there_is_none_without_a_peer(lerobot: Any) -> None:
    with Sides() as sides:
        time.sleep(1.0)
        assert sides.arm.told == []
        sides.pair()
        sides.lead(0.0, 0.5)
        assert sides.arm.told[0] == pytest.approx(dict(zip(sides.arm.action_features, STARTS, strict=True)), abs=0.1)
        far = [max(abs(one[name] - at) for name, at in zip(one, STARTS, strict=True)) for one in sides.arm.told]
        assert max(far) < 1.0
        told = sides.hand.get_observation()
        assert [told[f"{joint}.pos"] for joint in JOINTS] == pytest.approx(STARTS, abs=1.0), "the arm's own degrees"


def test_observations_have_force_beside_position(lerobot: Any) -> None:
    """What lerobot-record needs of a robot: features that fit the observations, and cameras."""
    sides = Sides()
    forces = [f"{joint}.force" for joint in JOINTS]
    assert set(sides.robot.observation_features) == {*sides.arm.observation_features, *forces}
    assert sides.robot.action_features == sides.arm.action_features == sides.hand.action_features
    assert set(sides.robot.get_observation()) == {*sides.arm.at, *forces}
    assert set(sides.hand.observation_features) == {*sides.arm.at, *forces}
    assert list(sides.robot.cameras) == ["front"]
    assert sides.hand.cameras == {}


def test_other_joints_are_refused(lerobot: Any) -> None:
    joints = [*JOINTS[:5], "jaw"]
    with Sides(joints=joints) as sides, pytest.raises(ConnectionError, match=f"allowed: {','.join(JOINTS)}"):
        sides.pair()


def test_the_teleoperators_joints_are_the_arms(lerobot: Any) -> None:
    sides = Sides()
    sides.teleop.config.joints = ["x"]
    sides.teleop.opened.append(sides.teleop)
    try:
        with pytest.raises(ValueError, match=r"allowed: --teleop.joints='\[shoulder_pan, .*, gripper\]'"):
            sides.robot.connect()
    finally:
        sides.teleop.disconnect()


def test_without_knowing_where_the_arm_is_there_is_no_action(lerobot: Any) -> None:
    with pytest.raises(RuntimeError, match="hapnet_arm"):
        Sides().teleop.get_action()


@pytest.mark.slow
def test_a_haptic_device_in_metres_leads_three_joints(lerobot: Any) -> None:
    """A simulated device whose hand moves by 30 mm: 30 units of 1 mm."""
    import importlib

    near = importlib.import_module("lerobot_teleoperator_hapnet")
    side = importlib.import_module("lerobot_robot_hapnet.side").Side
    address, joints = free_address(), list(JOINTS[:3])
    teleop = near.HapnetTeleoperator(
        near.HapnetTeleoperatorConfig(
            connect=address, joints=joints, units="m", scale=0.001, stiffness=200.0, damping=2.0
        )
    )
    params = {"scene": "free", "dof": 3, "operator": "sine", "operator_model.frequency_hz": 1.0}
    device = side(lambda: hapnet.connect_device(params, listen=address))
    device.open()
    try:
        teleop.connect()
        at, seen = dict.fromkeys(teleop.action_features, 5.0), list[float]()
        began = time.monotonic()
        while time.monotonic() - began < 4.0:
            teleop.send_feedback(at)
            at = teleop.get_action()
            seen.append(at["shoulder_pan.pos"])
            time.sleep(1.0 / 60.0)
    finally:
        teleop.disconnect()
        device.close()
    assert seen[0] == pytest.approx(5.0, abs=0.1)
    assert 20.0 < max(seen) - min(seen) < 70.0


@pytest.mark.slow
def test_a_pause_moves_nothing_and_a_gripper_keeps_its_grip(lerobot: Any) -> None:
    """LeRobot saves an episode for as long as it takes, while the hand goes on."""
    with Sides() as sides:
        sides.pair()
        sides.lead(-10.0, 3.0)
        before, count = sides.arm.told[-1], len(sides.arm.told)
        assert before["gripper.pos"] < 43.0, "the gripper is told to close, beyond the object at 45"
        for rate in (0.0, 0.3):
            for k in range(60):
                sides.hand.send_action({f"{joint}.pos": 0.0 + rate * k for joint in JOINTS})
                time.sleep(1.0 / 60.0)
            sides.loop(10 if rate == 0.0 else 1)
            assert sides.arm.told[count] == pytest.approx(before, abs=0.5)
            assert min(one["gripper.force"] for one in sides.observed[count:]) > 0.01
            assert sides.arm.told[-1] == pytest.approx(before, abs=0.5)
            before, count = sides.arm.told[-1], len(sides.arm.told)
    for side in (sides.hand.side, sides.teleop.side):
        assert side.summary["verdict"]["passive"] is not False


class Bus:
    """A bus of STS3215 servos, as much of LeRobot's as `hapnet_leader` calls."""

    def __init__(self) -> None:
        self.motors = {joint: SimpleNamespace(model="sts3215") for joint in JOINTS}
        registers = dict.fromkeys(("Torque_Limit", "Present_Current", "Goal_Position"), (0, 2))
        self.model_ctrl_table = {"sts3215": registers}
        self.port_handler = SimpleNamespace(ser=SimpleNamespace(reset_input_buffer=lambda: None))
        self.currents = dict.fromkeys(JOINTS, 0)
        self.written: dict[str, dict[str, float]] = {}
        self.is_on = False

    def enable_torque(self) -> None:
        assert set(self.written["Torque_Limit"].values()) == {0}
        self.is_on = True

    def sync_read(self, name: str, **_: object) -> dict[str, float]:
        return dict(self.currents) if name == "Present_Current" else dict.fromkeys(JOINTS, 0.0)

    def sync_write(self, name: str, values: dict[str, float], **_: object) -> None:
        self.written[name] = values


def test_a_leaders_limits_and_currents(lerobot: Any) -> None:
    """Of 2.94 Nm at stall and 1.09 Nm/A with a gear of 345; the gripper's gear is 147, a count is 6.5 mA."""
    import importlib

    module = importlib.import_module("lerobot_robot_hapnet")
    bus = Bus()
    action = {f"{joint}.pos": 1.0 for joint in JOINTS}
    arm = SimpleNamespace(
        bus=bus, config=SimpleNamespace(), action_features=action, get_action=lambda: action,
        connect=lambda calibrate: None, disconnect=lambda: None,
    )  # fmt: skip
    leader = module.HapnetLeader(module.HapnetLeaderConfig(leader={"made": arm}))
    leader.connect()
    try:
        assert bus.is_on
        places = {f"{joint}.pos": 5.0 for joint in JOINTS}
        leader.send_feedback(places | {f"{joint}.force": -0.294 for joint in JOINTS})
        assert bus.written["Torque_Limit"]["shoulder_lift"] == 100
        assert bus.written["Torque_Limit"]["gripper"] == round(100 * 345 / 147)
        assert bus.written["Goal_Position"] == dict.fromkeys(JOINTS, 5.0)
        bus.currents["gripper"] = 1 << 15 | 20
        leader.get_action()
        leader.get_action()
        assert leader.measured["gripper"] == pytest.approx(-20 * 6.5e-3 * 1.09 * 147 / 345)
        bus.currents["gripper"] = 2048  # a late answer, a position
        leader.get_action()
        assert leader.measured["gripper"] == pytest.approx(-20 * 6.5e-3 * 1.09 * 147 / 345)
    finally:
        leader.disconnect()
    assert set(bus.written["Torque_Limit"].values()) == {0}
    assert module.HapnetLeader.opened == []


def test_a_leader_without_torque_limits_is_refused(lerobot: Any) -> None:
    import importlib

    module = importlib.import_module("lerobot_robot_hapnet")
    options = {"type": "koch_leader", "made": SimpleNamespace()}
    with pytest.raises(ValueError, match=r"koch_leader has no torque limits; allowed: so100_leader, so101_leader"):
        module.HapnetLeader(module.HapnetLeaderConfig(leader=options))


def test_a_hand_is_no_faster_than_its_speed_and_counts_measured_torque_once(lerobot: Any) -> None:
    import importlib

    hand = importlib.import_module("lerobot_robot_hapnet.hand").Hand(2, 1.0, 60.0, 0.33)
    hand.go((3.0, -4.0), (0.1, 5.0))
    x, v = hand.read()
    assert math.hypot(*v) == pytest.approx(1.0)
    assert x[0] / x[1] == pytest.approx(-0.75)
    assert hand.acted() == pytest.approx((0.1, 1.9 * 0.33))
    hand.read()
    assert hand.acted() == (0.0, 0.0), "the same place again: nothing was measured since"
