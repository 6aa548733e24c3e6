"""The scene of a follower: the surroundings of its robot, their picture and their account, in the leader's units."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from hapnet.checks import Array, Signal, Vector
from hapnet.ext.robots.follower import Robot
from hapnet.mechanics.contacts import Inverse, Mass, Observed, Surroundings
from hapnet.mechanics.frame import Frame
from hapnet.mechanics.plane import Plane
from hapnet.plant.worlds.account import EnvironmentAccount
from hapnet.plant.worlds.picture import Part, Picture, Touch
from hapnet.plant.worlds.protocol import Surface, World, WorldDefaults
from hapnet.plant.worlds.walls import Wall


class RobotContacts(Surroundings):
    """The contacts around the robot, in the leader's units. sees : whether the leader gets the planes."""

    def __init__(self, robot: Robot, sees: bool) -> None:
        self._robot, self._contacts, self._sees = robot, robot.contacts, sees

    @property
    def dof(self) -> int:
        return self._contacts.dof

    def solve(
        self, dt: float, position: Sequence[float], velocity: list[float], inverse: Inverse
    ) -> tuple[Sequence[float], list[float]]:
        raise NotImplementedError("the robot's body solves its contacts")

    def stored_J(self, position: Sequence[float]) -> float:
        """Energy of its contacts, and of its motion if its port is the actuator's, at its true position."""
        robot = self._robot
        behind = robot.frame.energy * self._contacts.stored_J(robot.body.position)
        return behind + (robot.moving_J if robot.held else 0.0)

    @property
    def supplied_J(self) -> float:
        """Work of its moved contacts, and of what else acts on the robot."""
        outside = self._robot.outside
        by_others = 0.0 if outside is None else outside.put_in_J
        return self._robot.frame.energy * (self._contacts.supplied_J + by_others)

    @property
    def observed(self) -> Observed | None:
        return self._contacts.observed

    @property
    def contact_force(self) -> Vector | None:
        own = self._contacts.contact_force
        return None if own is None else self._robot.frame.coupled_force(own)

    def planes(self, position: Sequence[float], reach_m: float) -> tuple[Plane, ...] | None:
        if not self._sees:
            return None
        frame = self._robot.frame
        own = self._contacts.planes(frame.own(position), frame.reach(reach_m))
        return None if own is None else tuple([frame.plane(one) for one in own])

    def penetration(self, position: Sequence[float]) -> float:
        frame = self._robot.frame
        return self._contacts.penetration(frame.own(position)) / frame.motion


class LeadersPicture:
    """A picture of the robot's surroundings, scaled and placed in the leader's units."""

    def __init__(self, picture: Picture, frame: Frame) -> None:
        self._picture, self._frame = picture, frame

    @property
    def parts(self) -> tuple[Part, ...]:
        a = np.float32(self._frame.motion)
        return tuple([
            one._replace(vertices=self._placed(one.vertices).astype(np.float32) if one.body < 0 else one.vertices / a)
            for one in self._picture.parts
        ])  # fmt: skip

    def poses(self) -> Array:
        own = self._picture.poses()
        return np.concatenate([self._placed(own[:, :3]), own[:, 3:]], axis=1)

    def soft(self) -> Array:
        return self._placed(self._picture.soft())

    def touches(self, position: Vector, force: Vector) -> list[Touch]:
        frame = self._frame
        return [
            one._replace(
                point=tuple(self._placed(one.point).tolist()), force_N=tuple([frame.force * f for f in one.force_N])
            )
            for one in self._picture.touches(frame.own(position), frame.own_force(force))
        ]

    def _placed(self, own: ArrayLike) -> Array:
        """Convert points (..., 3) to the leader's units [m]."""
        o = np.zeros(3)
        known = self._frame.offset[:3]
        o[: len(known)] = known
        placed: Array = (np.asarray(own, dtype=float) - o) / self._frame.motion
        return placed


class RobotScene(WorldDefaults):
    """A scene in which a robot stands in the virtual mass's place. A step is a tick of its servo.

    scene : its surroundings. made : a function of them, B' [Ns/m] and K' [N/m] that makes the robot. period_s : of its
    servo. frame : used until the robot is made. sees : as in `RobotContacts`. The picture is scaled and placed in the
    leader's units.

    Attributes: is_joint, whether other robots touch the same bodies: their steps are solved together.
    """

    robot: bool = True

    def __init__(
        self,
        scene: World,
        made: Callable[[World, ArrayLike, ArrayLike], Robot],
        period_s: float,
        frame: Frame,
        *,
        sees: bool,
    ) -> None:
        self.scene, self._made, self._period_s, self._sees = scene, made, period_s, sees
        self._frame = frame
        self.is_joint = False
        self._robot: Robot | None = None
        self.contacts: Surroundings = scene.contacts

    @property
    def name(self) -> str:
        return self.scene.name

    @property
    def dof(self) -> int:
        return self.scene.dof

    @property
    def units(self) -> str:
        return self.scene.units

    @property
    def start(self) -> Vector:
        return self.scene.start

    @property
    def jaw(self) -> bool:
        return self.scene.jaw

    @property
    def rest(self) -> Vector:
        return tuple([x / self._frame.motion for x in self.scene.rest])

    @property
    def pressed(self) -> Vector:
        return self.scene.pressed

    @property
    def stiffnesses(self) -> tuple[float, ...] | None:
        own = self.scene.stiffnesses
        stiff = self._frame.motion * self._frame.force
        return None if own is None else tuple([stiff * one for one in own])

    @property
    def walls(self) -> tuple[Wall, ...]:
        own, frame = self.scene.walls, self._now
        planes = [frame.plane(Plane(one.normal, one.offset, one.stiffness, one.damping)) for one in own]
        return own if frame.is_one else tuple([Wall(*plane[:4]) for plane in planes])

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        frame, own = self._now, self.scene.surfaces
        return tuple([
            one._replace(position_m=(one.position_m - frame.offset[one.axis]) / frame.motion) for one in own
        ])  # fmt: skip

    @property
    def warnings(self) -> tuple[str, ...]:
        return self.scene.warnings

    def picture(self) -> Picture | None:
        picture = self.scene.picture()
        return picture if picture is None or self._now.is_one else LeadersPicture(picture, self._now)

    @property
    def _now(self) -> Frame:
        return self._frame if self._robot is None else self._robot.frame

    def proxy(self, mass: ArrayLike, damping: ArrayLike, stiffness: ArrayLike) -> Mass:
        self._robot = robot = self._made(self.scene, damping, stiffness)
        robot.is_joint = self.is_joint
        self.contacts = RobotContacts(robot, self._sees)
        return robot

    def for_hand_at(self, at: Vector) -> RobotScene | None:
        scene = self.scene.for_hand_at(at)
        return None if scene is None else RobotScene(scene, self._made, self._period_s, self._frame, sees=self._sees)

    def environment_account(self, contacts: Surroundings, position: Vector) -> EnvironmentAccount:
        if self.is_joint:
            return self.scene.environment_account(self.scene.contacts, position)
        return super().environment_account(contacts, position)

    def next_step_s(self, rng: np.random.Generator) -> float:
        return self._period_s

    def towards(self, position: Vector) -> Vector:
        return position

    def signal(self, name: str, value: Signal) -> None:
        self.scene.signal(name, value)

    def signals(self) -> Mapping[str, Signal]:
        return self.scene.signals()
