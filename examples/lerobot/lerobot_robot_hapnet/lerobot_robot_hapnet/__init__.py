"""A remote robot for LeRobot, over a bad network: ``--robot.type=hapnet`` with any of LeRobot's teleoperators.

Each action moves the leader of a hapnet pair. The other side, on the robot's host, is LeRobot with
``--teleop.type=hapnet``, `hapnet world`, or `hapnet device --role follower`. An observation has the position of the
mass that the hand moves, and the force with which a haptic device would push the hand back. A leader of type
``hapnet_leader`` renders this force.
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from lerobot.robots import Robot, RobotConfig

from hapnet import connect_device

from .hand import DEGREE_RAD, SO101, Hand
from .leader import HapnetLeader, HapnetLeaderConfig
from .side import Side

__all__ = ["HapnetLeader", "HapnetLeaderConfig", "HapnetRobot", "HapnetRobotConfig"]

_LEROBOT_S = 2.0
"""A peer that does not say within this time after pairing that it is LeRobot is another program."""


@RobotConfig.register_subclass("hapnet")
@dataclass(kw_only=True)
class HapnetRobotConfig(RobotConfig):
    """joints : the action's names, one for each axis; default: SO-101's. scale : radians in a unit of an action.

    connect, listen : endpoints, as of `hapnet device`. params : hapnet's parameters, such as {"link.up": "4g"}.
    speed : the leader's maximum, of all joints together [rad/s]. fps : the rate of LeRobot's loop. stiffness : of the
    spring that the hand feels [Nm/rad]. force_limit : the largest force at a joint [Nm].
    """

    joints: list[str] = field(default_factory=lambda: list(SO101))
    scale: float = DEGREE_RAD
    connect: str = ""
    listen: str = ""
    params: dict[str, Any] = field(default_factory=dict)
    speed: float = 6.0
    fps: float = 60.0
    stiffness: float = 2.0
    force_limit: float = 0.33


class HapnetRobot(Robot):
    """The remote robot."""

    config_class = HapnetRobotConfig
    name = "hapnet"

    def __init__(self, config: HapnetRobotConfig) -> None:
        super().__init__(config)
        self.config = config
        self.cameras: dict[str, Any] = {}  # lerobot-record counts them
        self.hand = Hand(len(config.joints), config.speed, config.fps, config.force_limit)
        self.side: Side | None = None
        self._first: dict[str, float] = {}

    @cached_property
    def action_features(self) -> dict[str, type]:
        return {f"{joint}.pos": float for joint in self.config.joints}

    @cached_property
    def observation_features(self) -> dict[str, type]:
        return self.action_features | {f"{joint}.force": float for joint in self.config.joints}

    @property
    def is_connected(self) -> bool:
        return self.side is not None and self.side.is_open

    is_calibrated = True

    def calibrate(self) -> None: ...

    def configure(self) -> None: ...

    def connect(self, calibrate: bool = True) -> None:
        """Wait for the other side; if that is LeRobot, until it knows its robot's position.

        Raises ConnectionError: the side failed, or the other side has other joints.
        """
        given = self.config
        params = {
            "dof": len(given.joints), "scene": "joints", "device.stiffness": given.stiffness, "device.self_test_N": 0.0,
            "device.servo_hz": given.fps, "device.pspm_period_s": 1.0 / given.fps, "device.watchdog_s": 0.05,
            "device.force_limit_N": given.force_limit, "device.ceiling_J": 0.2,
        } | given.params  # fmt: skip
        ends = {name: value for name in ("connect", "listen") if (value := getattr(given, name))}
        self.side = side = Side(lambda: connect_device(params, device=self.hand, **ends))
        side.open()
        logging.info("hapnet: waiting for the robot's side (%s)", given.listen or given.connect or "the local network")
        side.wait_for_peer()
        until, ours = time.monotonic() + _LEROBOT_S, ",".join(given.joints)
        while self.hand.joints != ours or self.hand.zero is None:
            if self.hand.joints not in ("", ours):
                side.close()
                raise ConnectionError(f"hapnet: robot.joints is {ours}; allowed: {self.hand.joints}, as the other side")
            if not self.hand.joints and time.monotonic() > until:
                return
            side.require_open()
            time.sleep(0.01)

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Move the leader. The first action corresponds to the remote robot's position, so the robot does not jump."""
        now = {name: float(action[name]) for name in self.action_features}
        self._first = self._first or now
        goal = tuple((now[name] - first) * self.config.scale for name, first in self._first.items())
        leader = next(iter(HapnetLeader.opened), None)
        if leader is None:
            self.hand.go(goal)
            return now
        joints = self.config.joints
        force = self.hand.go(goal, tuple(leader.measured[joint] for joint in joints))
        unit = self.config.stiffness * self.config.scale
        leader.send_feedback(
            {f"{joint}.pos": now[f"{joint}.pos"] + one / unit for joint, one in zip(joints, force, strict=True)}
            | {f"{joint}.force": one for joint, one in zip(joints, force, strict=True)}
        )
        return now

    def get_observation(self) -> dict[str, Any]:
        """The mass's position in the remote robot's units and the force for the hand [Nm].

        If the other side is not LeRobot, its position counts from the first action.
        """
        assert self.side is not None, "connect comes first"
        sample = self.side.sample
        at = (0.0,) * self.hand.dof if sample is None else sample.target_m
        names = self.action_features
        zero = self.hand.zero or tuple(self._first.get(name, 0.0) for name in names)
        found = {name: start + x / self.config.scale for name, start, x in zip(names, zero, at, strict=True)}
        felt = dict(zip(self.config.joints, self.hand.felt, strict=True))
        return found | {f"{joint}.force": force for joint, force in felt.items()}

    def disconnect(self) -> None:
        if self.side is not None:
            self.side.close()
