"""A remote hand for LeRobot, over a bad network: ``--teleop.type=hapnet`` with ``--robot.type=hapnet_arm``.

The other side, on the hand's host, is LeRobot with ``--robot.type=hapnet``, or `hapnet device` with any haptic device.
Here a virtual mass follows the hand, passively over any link; an action is the position of the mass. LeRobot's loop
passes observations to no teleoperator, so `HapnetArm` wraps the robot and feeds its position back: a spring pulls the
mass, and so the hand, towards the robot.
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

from lerobot.robots import Robot, RobotConfig, make_robot_from_config
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig
from lerobot_robot_hapnet.choice import config_of
from lerobot_robot_hapnet.hand import DEGREE_RAD, SO101, Vector
from lerobot_robot_hapnet.side import Side

from hapnet import connect_world

STALE_S = 0.25
"""After a longer pause of the loop a measured force has no effect, and the next action is again the one before."""

STEP_S = 0.01
"""The world's step: the mass is newer than an action of a loop of 60 a second."""

MASS_DAMPING = 0.03
"""Of the mass in the coupling [Nms/rad]: at 2 Nm/rad it follows the hand 15 ms behind, without overshoot."""


@TeleoperatorConfig.register_subclass("hapnet")
@dataclass(kw_only=True)
class HapnetTeleoperatorConfig(TeleoperatorConfig):
    """joints : the action's names, one for each axis; default: SO-101's. scale : radians in a unit of an action.

    connect, listen : endpoints, as of `hapnet world`. params : hapnet's parameters, such as {"link.down": "4g"}.
    stiffness : of the springs between hand and mass and between mass and robot [Nm/rad]. damping : of the mass while
    there is feedback [Nms/rad]. units : rad; or m, for a haptic device whose axes are in metres: then scale, stiffness
    and damping are in m, N/m and Ns/m.
    """

    joints: list[str] = field(default_factory=lambda: list(SO101))
    scale: float = DEGREE_RAD
    connect: str = ""
    listen: str = ""
    params: dict[str, Any] = field(default_factory=dict)
    stiffness: float = 2.0
    damping: float = 0.02
    units: str = "rad"


class HapnetTeleoperator(Teleoperator):
    """The remote hand.

    Attributes
    ----------
    opened : the connected teleoperators, which `HapnetArm` feeds. world : the robot as hapnet's world.
    """

    config_class = HapnetTeleoperatorConfig
    name = "hapnet"
    opened: ClassVar[list[HapnetTeleoperator]] = []

    def __init__(self, config: HapnetTeleoperatorConfig) -> None:
        super().__init__(config)
        self.config = config
        self.world = Measured(tuple(config.joints), config.stiffness, config.damping, config.units)
        self.side: Side | None = None
        self._fed_s: float | None = None
        self._told: Vector = ()

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
        """Wait for the other side. Raises ConnectionError: this side failed."""
        given = self.config
        springs: dict[str, Any] = {}
        if given.units != "m":
            springs = {"world.stiffness": given.stiffness, "world.damping": MASS_DAMPING, "world.step_limit_N": 0.5}
        params = {"dof": len(given.joints)} | springs | given.params
        ends = {name: value for name in ("connect", "listen") if (value := getattr(given, name))}
        self.side = Side(lambda: connect_world(params, scene=lambda **_: self.world, **ends))
        self.side.open()
        logging.info("hapnet: waiting for the hand's side (%s)", given.listen or given.connect or "the local network")
        self.side.wait_for_peer()
        self.opened.append(self)

    def get_action(self) -> dict[str, float]:
        """The position of the mass, which begins at the robot's position.

        Raises RuntimeError: the robot's position was not fed back.
        """
        if self._fed_s is None:
            raise RuntimeError("the arm's position is not known: use --robot.type=hapnet_arm, see hapnet's README")
        self._told = tuple(zero + x / self.config.scale for zero, x in zip(self.world.zero, self._at(), strict=True))
        return dict(zip(self.action_features, self._told, strict=True))

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Take the robot's position (``x.pos``), or besides it the force on it (``x.force``, in Nm), which then acts on
        the mass in the spring's place.

        The first position becomes the mass's. After a pause of more than `STALE_S` the newest action does, so that
        the robot does not jump, and a gripper holds what it holds.
        """
        now, scale = time.monotonic(), self.config.scale
        place = tuple(float(feedback[name]) for name in self.action_features)
        if self._fed_s is None or now - self._fed_s > STALE_S:
            self.world.zero = tuple(one - x / scale for one, x in zip(self._told or place, self._at(), strict=True))
        self._fed_s = now
        forces = [feedback.get(f"{joint}.force") for joint in self.config.joints]
        force = None if None in forces else tuple(map(float, forces))
        at = tuple((one - zero) * scale for one, zero in zip(place, self.world.zero, strict=True))
        self.world.feed(at, force)

    def _at(self) -> Vector:
        assert self.side is not None, "connect comes first"
        sample = self.side.sample
        return (0.0,) * self.world.dof if sample is None else tuple(sample.position_m)

    def disconnect(self) -> None:
        if self in self.opened:
            self.opened.remove(self)
        if self.side is not None:
            self.side.close()


@RobotConfig.register_subclass("hapnet_arm")
@dataclass(kw_only=True)
class HapnetArmConfig(RobotConfig):
    """arm : any robot of LeRobot's with its options, as in
    ``--robot.arm='{type: so101_follower, port: /dev/ttyACM0}'``."""

    arm: dict[str, Any]  # a RobotConfig in a RobotConfig would have no end in LeRobot's parser


class HapnetArm(Robot):
    """A wrapper of any LeRobot robot that feeds its position back to hapnet's teleoperator in this program.

    LeRobot's loop reads the observation first, so the first action is the arm's position. An observation also has the
    force of the arm on the hand (``x.force``, in Nm), and so `lerobot-record` records it.
    """

    config_class = HapnetArmConfig
    name = "hapnet_arm"

    def __init__(self, config: HapnetArmConfig) -> None:
        super().__init__(config)
        self.arm: Robot = make_robot_from_config(config_of(RobotConfig, "robot.arm", config.arm))

    @property
    def cameras(self) -> dict[str, Any]:
        return getattr(self.arm, "cameras", {})

    @cached_property
    def observation_features(self) -> dict[str, Any]:
        return self._forces(float) | self.arm.observation_features

    @cached_property
    def action_features(self) -> dict[str, Any]:
        return dict(self.arm.action_features)

    @property
    def is_connected(self) -> bool:
        return bool(self.arm.is_connected)

    @property
    def is_calibrated(self) -> bool:
        return bool(self.arm.is_calibrated)

    def connect(self, calibrate: bool = True) -> None:
        """Connect the arm. Raises ValueError: hapnet's teleoperator has other joints."""
        arm = [name.removesuffix(".pos") for name in self.arm.action_features]
        for teleop in HapnetTeleoperator.opened:
            if sorted(teleop.config.joints) != sorted(arm):
                ours = f"teleop.joints: {','.join(teleop.config.joints)}"
                raise ValueError(f"{ours} does not fit the arm; allowed: --teleop.joints='[{', '.join(arm)}]'")
        self.arm.connect(calibrate)

    def calibrate(self) -> None:
        self.arm.calibrate()

    def configure(self) -> None:
        self.arm.configure()

    def get_observation(self) -> dict[str, Any]:
        found: dict[str, Any] = self.arm.get_observation()
        forces = self._forces(0.0)
        for teleop in HapnetTeleoperator.opened:
            teleop.send_feedback(found)
            forces |= {
                f"{joint}.force": one for joint, one in zip(teleop.config.joints, teleop.world.force, strict=True)
            }
        return forces | found

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        sent: dict[str, Any] = self.arm.send_action(action)
        return sent

    def disconnect(self) -> None:
        self.arm.disconnect()

    def _forces(self, value: Any) -> dict[str, Any]:
        return {name.removesuffix(".pos") + ".force": value for name in self.arm.action_features}


class Measured:
    """The robot as a world: its force on the mass from the newest feedback. hapnet keeps its energy account.

    Attributes
    ----------
    zero : the robot's position, in LeRobot's units, where the mass is at 0; empty: not known.
    """

    name = "lerobot"
    robot = True
    min_s = max_s = STEP_S

    def __init__(self, joints: tuple[str, ...], stiffness: float, damping: float, units: str = "rad") -> None:
        self.dof = len(joints)
        self.units = units
        self.zero: Vector = ()
        self._mass: tuple[Vector, Vector] = (0.0,) * self.dof, (0.0,) * self.dof
        self._joints = joints
        self._stiffness, self._damping = stiffness, damping
        self._newest: tuple[float, Vector, Vector | None] | None = None

    def feed(self, at: Vector, force: Vector | None = None) -> None:
        """Take the robot's position [rad], and if it is measured the force on it [Nm]."""
        self._newest = time.monotonic(), at, force

    def signals(self) -> dict[str, Any]:
        """What the other side's LeRobot must know."""
        return {"joints": ",".join(self._joints)} | ({"zero": self.zero} if self.zero else {})

    def step(self, dt: float, position: Vector, velocity: Vector) -> Vector:
        """The force on the mass [Nm]."""
        self._mass = position, velocity
        return self.force

    @property
    def force(self) -> Vector:
        """The force on the mass with the newest feedback [Nm]."""
        position, velocity = self._mass
        if self._newest is None:
            return (0.0,) * self.dof
        fed_s, at, force = self._newest
        if force is not None and time.monotonic() - fed_s <= STALE_S:
            return force
        return tuple(  # while LeRobot's loop pauses, the robot keeps its place, and so the grip is kept
            self._stiffness * (there - x) - self._damping * v
            for there, x, v in zip(at, position, velocity, strict=True)
        )
