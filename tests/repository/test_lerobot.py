"""The packages for LeRobot, beside a thin double of its interface (lerobot 0.4.4: robots/, teleoperators/, loop)."""

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
    vars(robots).update(Robot=robot, RobotConfig=robot_config)
    vars(teleops).update(Teleoperator=teleop, TeleoperatorConfig=teleop_config)
    utils = ModuleType("lerobot.robots.utils")
    vars(utils).update(make_robot_from_config=lambda config: config.made)
    for module in (ModuleType("lerobot"), robots, teleops, utils):
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


class Blocked:
    """A robot that follows each action at once, but not beyond 8 units from where it began."""

    at = -20.0

    def get_observation(self) -> dict[str, float]:
        return {"x.pos": self.at}

    def send_action(self, action: dict[str, float]) -> None:
        self.at = min(action["x.pos"], -12.0)


class Arm:
    """A robot of LeRobot's that goes to each action at once."""

    def __init__(self) -> None:
        self.at, self.told = -20.0, list[dict[str, float]]()

    def get_observation(self) -> dict[str, float]:
        return {"x.pos": self.at, "gripper.pos": 3.0}

    def send_action(self, action: dict[str, float]) -> dict[str, float]:
        self.told.append(action)
        self.at = action["x.pos"]
        return action


def loop(teleop: Any, robot: Any, frames: int) -> None:
    """LeRobot's `teleop_loop` (0.4.4): the observation, the action, the robot, with processors that change nothing."""
    for _ in range(frames):
        robot.get_observation()
        robot.send_action(teleop.get_action())
        time.sleep(1.0 / 60.0)


def test_the_first_action_is_where_the_arm_is_and_there_is_none_without_a_peer(
    lerobot: dict[str, dict[str, type]],
) -> None:
    import importlib

    far = importlib.import_module("lerobot_robot_hapnet")
    hand = importlib.import_module("lerobot_teleoperator_hapnet")
    address, params = free_address(), {"link.up": LINK, "link.down": LINK}
    teleop = hand.HapnetTeleoperator(hand.HapnetTeleoperatorConfig(connect=address, params=params))
    plain, arm = Arm(), Arm()
    led = hand.HapnetArm(hand.HapnetArmConfig(arm=SimpleNamespace(made=arm)))
    ran = threading.Thread(target=lambda: (teleop.connect(), loop(teleop, led, 20)))
    ran.start()  # as LeRobot's program does
    time.sleep(1.0)
    assert arm.told == []
    assert plain.told == []
    robot = far.HapnetRobot(far.HapnetRobotConfig(listen=address, params=params))
    robot.connect()
    try:
        ran.join(60.0)
        assert len(arm.told) == 20
        assert arm.told[0]["x.pos"] == pytest.approx(-20.0, abs=0.1)
        assert max(abs(one["x.pos"] + 20.0) for one in arm.told) < 1.0
    finally:
        teleop.disconnect()
        robot.disconnect()


def test_without_knowing_where_the_arm_is_there_is_no_action(lerobot: dict[str, dict[str, type]]) -> None:
    import importlib

    hand = importlib.import_module("lerobot_teleoperator_hapnet")
    teleop, arm = hand.HapnetTeleoperator(hand.HapnetTeleoperatorConfig()), Arm()
    with pytest.raises(RuntimeError, match="hapnet_arm"):
        loop(teleop, arm, 1)
    assert arm.told == []


@pytest.mark.slow
def test_a_hand_feels_a_robot_that_is_blocked_over_a_lossy_link(lerobot: dict[str, dict[str, type]]) -> None:
    """As LeRobot's loop does, 60 times a second on each side."""
    import importlib

    far = importlib.import_module("lerobot_robot_hapnet")
    hand = importlib.import_module("lerobot_teleoperator_hapnet")
    robots = {"hapnet": far.HapnetRobotConfig, "hapnet_arm": hand.HapnetArmConfig}
    assert lerobot == {"robot": robots, "teleop": {"hapnet": hand.HapnetTeleoperatorConfig}}
    address = free_address()
    robot = far.HapnetRobot(far.HapnetRobotConfig(listen=address, params={"link.up": LINK, "scene": "free"}))
    teleop = hand.HapnetTeleoperator(hand.HapnetTeleoperatorConfig(connect=address, params={"link.down": LINK}))
    process, arm = hand.with_feedback(teleop), Blocked()
    told, seen, felt = list[float](), list[float](), list[float]()
    robot.connect()
    teleop.connect()
    try:
        began = time.monotonic()
        while (t := time.monotonic() - began) < 8.0:
            observed = robot.get_observation()
            told.append(40.0 + 15.0 * math.sin(2.0 * math.pi * 0.25 * max(0.0, t - 2.0)))
            robot.send_action({"x.pos": told[-1]})
            seen.append(observed["x.pos"])
            felt.append(observed["x.force"])
            state = arm.get_observation()
            arm.send_action(process((teleop.get_action(), state)))
            time.sleep(1.0 / 60.0)
    finally:
        robot.disconnect()
        teleop.disconnect()
    assert max(abs(one - 40.0) for one in seen[20:100]) < 1.0, "nothing jumps at the start"
    assert max(seen) < 55.0 - 0.5, "it is held back where the robot is blocked"
    free = sorted(abs(a - b) for a, b in zip(told, seen, strict=True) if a < 40.0)
    assert min(seen[20:]) < 28.0, "and follows where it is not"
    assert free[len(free) // 2] < 6.0
    blocked = [force for a, force in zip(told, felt, strict=True) if a > 52.0]
    assert sum(blocked) / len(blocked) < -0.1, "the hand is pushed back"
    for side in (robot.side, teleop.side):
        assert side.summary["verdict"]["passive"] is not False
