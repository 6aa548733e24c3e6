"""A remote hand for LeRobot, over a bad network: ``--teleop.type=hapnet`` with any of LeRobot's robots.

The other side, on the hand's host, is `hapnet device` with any haptic device, or LeRobot with ``--robot.type=hapnet``.
Here a virtual mass follows the hand, passively over any link; an action is the position of the mass. `send_feedback`
makes the robot's state act on the mass, and so on the hand. The first feedback sets the initial position of the mass;
before it there is no action. LeRobot's loop passes observations to no teleoperator: use ``--robot.type=hapnet_arm``.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

from lerobot.robots import Robot, RobotConfig
from lerobot.robots.utils import make_robot_from_config
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig
from lerobot_robot_hapnet.side import Side

from hapnet import connect_world

STALE_S = 0.25
"""Maximum age of feedback; older feedback has no effect."""


@TeleoperatorConfig.register_subclass("hapnet")
@dataclass(kw_only=True)
class HapnetTeleoperatorConfig(TeleoperatorConfig):
    """joints : the action's names, one for each axis. scale : metres (radians of joints) in a unit of an action.

    connect, listen : endpoints, as of `hapnet world`. params : hapnet's parameters, such as {"link.down": "4g"}.
    stiffness, damping : of the spring between mass and robot, used for feedback with positions [N/m], [Ns/m].
    """

    joints: list[str] = field(default_factory=lambda: ["x"])
    scale: float = 0.001
    connect: str = ""
    listen: str = ""
    params: dict[str, Any] = field(default_factory=dict)
    stiffness: float = 200.0
    damping: float = 2.0


class HapnetTeleoperator(Teleoperator):
    """The remote hand."""

    config_class = HapnetTeleoperatorConfig
    name = "hapnet"
    opened: ClassVar[list[HapnetTeleoperator]] = []
    """The connected teleoperators."""

    def __init__(self, config: HapnetTeleoperatorConfig) -> None:
        super().__init__(config)
        self.config = config
        self.robot = Measured(len(config.joints), config.stiffness, config.damping)
        self.side: Side | None = None
        self._first = dict.fromkeys(self.action_features, 0.0)
        self._fed = self.waits = False

    @cached_property
    def action_features(self) -> dict[str, type]:
        return {f"{joint}.pos": float for joint in self.config.joints}

    @cached_property
    def feedback_features(self) -> dict[str, type]:
        return self.action_features | {f"{joint}.force": float for joint in self.config.joints}

    @property
    def is_connected(self) -> bool:
        return self.side is not None and self.side.is_open

    is_calibrated = True

    def calibrate(self) -> None: ...

    def configure(self) -> None: ...

    def connect(self, calibrate: bool = True) -> None:
        given = self.config
        params = {"dof": len(given.joints)} | given.params
        ends = {name: value for name in ("connect", "listen") if (value := getattr(given, name))}
        self.side = Side(lambda: connect_world(params, scene=lambda **_: self.robot, **ends))
        self.side.open()
        self.side.wait_for_peer()
        self.opened.append(self)

    def get_action(self) -> dict[str, float]:
        """The position of the mass, which begins at the robot's position. Empty before the first feedback, if
        `with_feedback` is used.

        Raises RuntimeError: the robot's position was not fed back.
        """
        if not self._fed:
            if self.waits:
                return {}
            raise RuntimeError("the arm's position is not known: use --robot.type=hapnet_arm, see hapnet's README")
        return {
            name: first + x / self.config.scale
            for (name, first), x in zip(self._first.items(), self._at(), strict=True)
        }

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Take the robot's position (``x.pos``) or the force on it (``x.force``, in N). Once the position is known, the
        force has precedence."""
        forces = [feedback.get(f"{joint}.force") for joint in self.config.joints]
        if self._fed and None not in forces:
            self.robot.feed(force=tuple(map(float, forces)))
            return
        now = {name: float(feedback[name]) for name in self.action_features}
        if not self._fed:
            at = zip(now.items(), self._at(), strict=True)
            self._fed, self._first = True, {name: place - x / self.config.scale for (name, place), x in at}
        self.robot.feed(at=tuple((now[name] - first) * self.config.scale for name, first in self._first.items()))

    def _at(self) -> tuple[float, ...]:
        assert self.side is not None, "connect comes first"
        sample = self.side.sample
        return (0.0,) * self.robot.dof if sample is None else tuple(sample.position_m)

    def disconnect(self) -> None:
        if self in self.opened:
            self.opened.remove(self)
        if self.side is not None:
            self.side.close()


@RobotConfig.register_subclass("hapnet_arm")
@dataclass(kw_only=True)
class HapnetArmConfig(RobotConfig):
    """arm : any robot of LeRobot's, as in ``--robot.arm.type=so101_follower --robot.arm.port=/dev/ttyACM0``."""

    arm: RobotConfig


class HapnetArm(Robot):
    """A wrapper of any LeRobot robot that feeds its position back to hapnet's teleoperators in this program.

    LeRobot's loop reads the observation first, so the first action is the arm's position.
    """

    config_class = HapnetArmConfig
    name = "hapnet_arm"

    def __init__(self, config: HapnetArmConfig) -> None:
        super().__init__(config)
        self.arm: Robot = make_robot_from_config(config.arm)

    @property
    def observation_features(self) -> dict[str, Any]:
        return self.arm.observation_features

    @property
    def action_features(self) -> dict[str, Any]:
        return self.arm.action_features

    @property
    def is_connected(self) -> bool:
        return self.arm.is_connected

    @property
    def is_calibrated(self) -> bool:
        return self.arm.is_calibrated

    def connect(self, calibrate: bool = True) -> None:
        self.arm.connect(calibrate)

    def calibrate(self) -> None:
        self.arm.calibrate()

    def configure(self) -> None:
        self.arm.configure()

    def get_observation(self) -> dict[str, Any]:
        found: dict[str, Any] = self.arm.get_observation()
        for teleop in HapnetTeleoperator.opened:
            if teleop.action_features.keys() <= found.keys():
                teleop.send_feedback(found)
        return found

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        sent: dict[str, Any] = self.arm.send_action(action) if action else action
        return sent

    def disconnect(self) -> None:
        self.arm.disconnect()


class Measured:
    """The robot as a world: its force on the mass from the newest feedback. hapnet keeps its energy account."""

    name = "lerobot"
    robot = True

    def __init__(self, dof: int, stiffness: float, damping: float) -> None:
        self.dof = dof
        self._stiffness, self._damping = stiffness, damping
        self._newest: tuple[float, tuple[float, ...] | None, tuple[float, ...] | None] = (-1.0, None, None)

    def feed(self, at: tuple[float, ...] | None = None, force: tuple[float, ...] | None = None) -> None:
        self._newest = time.monotonic(), at, force

    def step(self, dt: float, position: tuple[float, ...], velocity: tuple[float, ...]) -> tuple[float, ...]:
        """The force on the mass [N]."""
        fed_s, at, force = self._newest
        if time.monotonic() - fed_s > STALE_S:
            return (0.0,) * self.dof
        if force is not None:
            return force
        assert at is not None
        return tuple(
            self._stiffness * (there - x) - self._damping * v
            for there, x, v in zip(at, position, velocity, strict=True)
        )


def with_feedback(teleop: HapnetTeleoperator) -> Callable[[tuple[dict[str, Any], dict[str, Any]]], dict[str, Any]]:
    """A `teleop_action_processor` for LeRobot's own loop, which calls `send_feedback` for one robot only.

    The processor feeds the observation back first, so that the first action is the robot's position.
    """
    teleop.waits = True

    def process(action_and_observation: tuple[dict[str, Any], dict[str, Any]]) -> dict[str, Any]:
        teleop.send_feedback(action_and_observation[1])
        action: dict[str, Any] = teleop.get_action()
        return action

    return process
