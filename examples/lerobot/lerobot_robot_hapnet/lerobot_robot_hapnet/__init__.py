"""A remote robot for LeRobot, over a bad network: ``--robot.type=hapnet`` with any of LeRobot's teleoperators.

Each action moves the leader of a hapnet pair. The other side, on the robot's host, is `hapnet device --role follower`,
`hapnet world`, or LeRobot with ``--teleop.type=hapnet``. An observation has the remote robot's position and the force
with which a haptic device would push the hand back.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from lerobot.robots import Robot, RobotConfig

from hapnet import connect_device
from hapnet.devices import DeviceSilent

from .side import Side

SMOOTHING_S = 0.02
"""Time constant of the low-pass filter that turns LeRobot's steps into a motion."""

STALE_S = 0.5
"""Longest time without an action; after it the device is silent, and the other side applies its `on_silence`."""


@RobotConfig.register_subclass("hapnet")
@dataclass(kw_only=True)
class HapnetRobotConfig(RobotConfig):
    """joints : the action's names, one for each axis. scale : metres (radians of joints) in a unit of an action.

    connect, listen : endpoints, as of `hapnet device`. params : hapnet's parameters, such as {"link.up": "4g"}. speed :
    the leader's maximum speed [m/s].
    """

    joints: list[str] = field(default_factory=lambda: ["x"])
    scale: float = 0.001
    connect: str = ""
    listen: str = ""
    params: dict[str, Any] = field(default_factory=dict)
    speed: float = 0.5


class HapnetRobot(Robot):
    """The remote robot."""

    config_class = HapnetRobotConfig
    name = "hapnet"

    def __init__(self, config: HapnetRobotConfig) -> None:
        super().__init__(config)
        self.config = config
        self.hand = Hand(len(config.joints), config.speed)
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
        given = self.config
        params = {"dof": len(given.joints), "device.servo_hz": 500.0, "device.self_test_N": 0.0} | given.params
        ends = {name: value for name in ("connect", "listen") if (value := getattr(given, name))}
        self.side = Side(lambda: connect_device(params, device=self.hand, **ends))
        self.side.open()

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Move the leader. The first action corresponds to the remote robot's position, so the robot does not jump."""
        now = {name: float(action[name]) for name in self.action_features}
        self._first = self._first or now
        self.hand.go(tuple((now[name] - first) * self.config.scale for name, first in self._first.items()))
        return now

    def get_observation(self) -> dict[str, Any]:
        """The remote robot's position and the force [N]; before a peer connects, the first action and no force."""
        assert self.side is not None, "connect comes first"
        sample = self.side.sample
        at = (0.0,) * self.hand.dof if sample is None else sample.target_m
        first = self._first or dict.fromkeys(self.action_features, 0.0)
        found = {name: start + x / self.config.scale for (name, start), x in zip(first.items(), at, strict=True)}
        felt = dict(zip(self.config.joints, self.hand.felt, strict=True))
        return found | {f"{joint}.force": force for joint, force in felt.items()}

    def disconnect(self) -> None:
        if self.side is not None:
            self.side.close()


class Hand:
    """A device without motors that follows LeRobot's actions; `felt` is the force that it would render [N]."""

    resolution = 0.0
    force_limit = 3.3

    def __init__(self, dof: int, speed: float) -> None:
        self.dof = dof
        self.greatest_speed = 2.0 * speed
        self.felt = self._x = self._goal = (0.0,) * dof
        self._speed = speed
        self._read_s = self._action_s = time.monotonic()
        self._began = False

    def go(self, goal: tuple[float, ...]) -> None:
        self._goal, self._action_s, self._began = goal, time.monotonic(), True

    def read(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        now = time.monotonic()
        dt, self._read_s = now - self._read_s, now
        if self._began and now - self._action_s > STALE_S:
            raise DeviceSilent(f"no action for {STALE_S:g} s")
        share, most = -math.expm1(-dt / SMOOTHING_S), self._speed * dt
        moved = tuple(max(-most, min(most, share * (g - x))) for g, x in zip(self._goal, self._x, strict=True))
        self._x = tuple(x + m for x, m in zip(self._x, moved, strict=True))
        return self._x, tuple(m / dt if dt > 0.0 else 0.0 for m in moved)

    def apply(self, force: tuple[float, ...]) -> tuple[float, ...]:
        self.felt = force
        return (0.0,) * self.dof
