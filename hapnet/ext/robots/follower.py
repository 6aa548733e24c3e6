"""A follower: a simulated robot in a scene, in the leader's units.

The leader's motion may be scaled to the robot, and the robot's force to the hand (`hapnet.mechanics.frame`). Only this
module uses the robot's own units.

The robot has a mass, its own damping, friction and encoders, and touches any contacts of the scene. If its force is
held from tick to tick, its port is the actuator's, and mass and contacts are the environment behind it. If the coupling
acts within the step, its port is that of its contacts, as with a virtual mass.

A robot with a position servo gets a place from each tick, and renders the spring and the damper to it itself, in steps
of 1 ms at most. The account counts the force that the servo really applied, as that of a driver that measures it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from hapnet.checks import Array, Signal, Vector
from hapnet.ext.robots.friction import friction_drag
from hapnet.mechanics.contacts import Inverse, Mass, Observed, Step, Surroundings, doing
from hapnet.mechanics.frame import Frame
from hapnet.mechanics.plane import Plane
from hapnet.plant.worlds.picture import Part, Picture, Touch
from hapnet.plant.worlds.protocol import Surface, World, WorldDefaults
from hapnet.plant.worlds.walls import Wall
from hapnet.records.vectors import inner

PART_S = 1e-3
"""The longest part of a tick in which a held force moves the robot [s]."""


class Mechanics(NamedTuple):
    """The friction and the position servo of a simulated robot, in its own units.

    damping, friction : of its own [Ns/m], [N]; mass : for its friction [kg]. stiffness, servo_damping : of its position
    servo [N/m], [Ns/m]; 0: it has none.
    """

    damping: float = 0.0
    friction: float = 0.0
    mass: float = 1.0
    stiffness: float = 0.0
    servo_damping: float = 0.0


class Outside(Protocol):
    """Everything else that acts on the robot, in its own units: a hand that holds it, other robots that it leads."""

    put_in_J: float
    """Its work on the robot so far [J]."""

    def acts(self, dt: float, position: Vector) -> tuple[Vector, float]:
        """Its push [N] and its drag [Ns/m] in the next `dt` seconds, from `position` [m] on."""


class Robot(Mass):
    """The robot among its contacts, in the leader's units: the `Mass` of a follower.

    body : the mass that moves among `contacts`, in its own units. frame : see `Frame`. own : see `Mechanics`.
    resolution : of its encoders [m]. held : whether its force is held, so that its port is the actuator's.
    engine : whether a physics engine moves it; its port is then the actuator's, and its damping the engine's.
    here : whether its position at the start corresponds to the leader's; else both share one origin.
    """

    def __init__(
        self,
        body: Mass,
        contacts: Surroundings,
        frame: Frame,
        own: Mechanics,
        resolution: float,
        *,
        held: bool,
        engine: bool,
        here: bool,
    ) -> None:
        self.body, self.frame = body, frame
        self.contacts = contacts
        self._own, self._resolution = own, resolution
        self.outside: Outside | None = None
        """What else acts on it besides its leader and the contacts; only with a held force, and without an engine."""
        self.held, self._engine, self._here = held, engine, here
        self.done_J = 0.0
        """Work put in at the actuator's port, with true positions [J]."""
        self._measured = self._counts()
        self._speed: Vector = (0.0,) * len(self._measured)
        self._touched: Vector = self._speed

    def _counts(self) -> Vector:
        own, r = self.body.position, self._resolution
        return self.frame.coupled(own if r == 0.0 else [r * round(one / r) for one in own])

    @property
    def position(self) -> Vector:
        """The measured position [m]."""
        return self._measured

    @property
    def velocity(self) -> Vector:
        """The measured velocity [m/s]."""
        return self._speed

    @property
    def kinetic_J(self) -> float:
        return 0.0 if self.held else self.moving_J

    @property
    def moving_J(self) -> float:
        """Its kinetic energy [J]."""
        return self.frame.energy * self.body.kinetic_J

    @property
    def waits(self) -> bool:
        return self._here

    def port_J(self, counted_J: float) -> float:
        return self.done_J if self.held else counted_J

    def set_contacts(self, contacts: Surroundings) -> None:
        self.body.set_contacts(self.contacts)

    def place(self, position: Vector) -> None:
        """Align the frame with the leader's `position` [m], if the robot begins `here`. The robot does not move."""
        if self._here:
            self.frame.meet(self.body.position, position)
        self._measured = self._counts()

    def step(self, dt: float, set_position: Vector, contacts: Surroundings) -> Step:
        """Step with the body's spring and damper, solved within the step, and without its own damping."""
        return self._to_leader(dt, self.body.step(dt, self.frame.own(set_position), self.contacts))

    def push(self, dt: float, drag: float, push: Vector, contacts: Surroundings) -> Step:
        """Step under a held force, or a law's; in short parts, so that its damping acts on the current velocity."""
        frame, own = self.frame, self._own
        own_drag = drag / (frame.motion * frame.force) + own.damping
        held = frame.own_force(push)
        count = max(1, round(dt / PART_S)) if self.held and not self._engine else 1
        part, begun = dt / count, self.body.position
        aim = self._aim(held)
        force, applied, work, served, depth = [0.0] * len(held), [0.0] * len(held), 0.0, 0.0, 0.0
        for _ in range(count):
            pull, brake = (held, 0.0) if aim is None else self._serve(part, aim)
            known = tuple([one + touch for one, touch in zip(pull, self._touched, strict=True)])
            others = own_drag + brake
            acting, push, hold = pull, pull, 0.0
            if self.outside is not None:
                push, hold = self.outside.acts(part, self.body.position)
                acting = tuple([one + more for one, more in zip(pull, push, strict=True)])
                known = tuple([one + more for one, more in zip(known, push, strict=True)])
                others += hold
            rubs = friction_drag(own.friction, own.mass, others, part, self.body.velocity, known)
            done = self.body.push(part, others + rubs, acting, self.contacts)
            self._touched = done.force
            if self.outside is not None:
                moving = done.velocity
                self.outside.put_in_J += part * (inner(push, moving) - hold * inner(moving, moving))
            servo = [one - brake * v for one, v in zip(pull, done.velocity, strict=True)]
            for i, f in enumerate(done.force):
                force[i] += f / count
                applied[i] += servo[i] / count
            work += done.work_J
            served += part * inner(servo, done.velocity)
            depth = done.penetration_m
        moved = [end - begin for begin, end in zip(begun, self.body.position, strict=True)]
        if self._engine:  # an engine may apply less: take the mean force with the same work
            held = doing(-work, done.coupling_force, moved)
            force = [-one for one in held]
        elif aim is not None:
            held = doing(served, tuple(applied), moved)
        if self.held:
            self.done_J -= frame.energy * inner(held, moved)
        velocity = tuple([one / dt for one in moved])
        return self._to_leader(dt, Step(velocity, tuple(force), work, 0.0, held, self.body.position, depth))

    def _aim(self, held: Vector) -> Vector | None:
        """The place that the position servo gets with the force `held` [N], in its own units; None: it has none.

        ``K' (aim - x) - B' v`` is that force at the measured position and velocity.
        """
        own, frame = self._own, self.frame
        if not own.stiffness:
            return None
        x, v = frame.own(self._measured), [frame.motion * one for one in self._speed]
        return tuple([
            at + (f + own.servo_damping * speed) / own.stiffness for at, f, speed in zip(x, held, v, strict=True)
        ])  # fmt: skip

    def _serve(self, dt: float, aim: Vector) -> tuple[Vector, float]:
        """The push [N] and the drag [Ns/m] of the position servo in a step: its spring acts at the step's middle."""
        own = self._own
        push = [own.stiffness * (to - x) for to, x in zip(aim, self.body.position, strict=True)]
        return tuple(push), own.servo_damping + 0.5 * own.stiffness * dt

    def _to_leader(self, dt: float, done: Step) -> Step:
        """Convert a step of the body to the leader's units."""
        frame, before = self.frame, self._measured
        self._measured = end = self._counts()
        if self._resolution == 0.0:
            self._speed = frame.velocity(self.body.velocity)
        else:
            self._speed = tuple([(one - two) / dt for one, two in zip(end, before, strict=True)])
        return Step(
            frame.velocity(done.velocity),
            frame.coupled_force(done.force),
            frame.energy * done.work_J,
            frame.energy * done.dissipated_J,
            frame.coupled_force(done.coupling_force),
            end,
            done.penetration_m / frame.motion,
        )


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

    scene : its surroundings. made : a function of B' [Ns/m] and K' [N/m] that makes the robot. period_s : of its servo.
    frame : used until the robot is made. sees : as in `RobotContacts`. The picture is scaled and placed in the leader's
    units.
    """

    robot: bool = True

    def __init__(
        self,
        scene: World,
        made: Callable[[ArrayLike, ArrayLike], Robot],
        period_s: float,
        frame: Frame,
        *,
        sees: bool,
    ) -> None:
        self._scene, self._made, self._period_s, self._sees = scene, made, period_s, sees
        self._frame = frame
        self._robot: Robot | None = None
        self.contacts: Surroundings = scene.contacts

    @property
    def name(self) -> str:
        return self._scene.name

    @property
    def dof(self) -> int:
        return self._scene.dof

    @property
    def units(self) -> str:
        return self._scene.units

    @property
    def start(self) -> Vector:
        return self._scene.start

    @property
    def jaw(self) -> bool:
        return self._scene.jaw

    @property
    def rest(self) -> Vector:
        return tuple([x / self._frame.motion for x in self._scene.rest])

    @property
    def pressed(self) -> Vector:
        return self._scene.pressed

    @property
    def stiffnesses(self) -> tuple[float, ...] | None:
        own = self._scene.stiffnesses
        stiff = self._frame.motion * self._frame.force
        return None if own is None else tuple([stiff * one for one in own])

    @property
    def walls(self) -> tuple[Wall, ...]:
        own, frame = self._scene.walls, self._now
        planes = [frame.plane(Plane(one.normal, one.offset, one.stiffness, one.damping)) for one in own]
        return own if frame.is_one else tuple([Wall(*plane[:4]) for plane in planes])

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        frame, own = self._now, self._scene.surfaces
        return tuple([
            one._replace(position_m=(one.position_m - frame.offset[one.axis]) / frame.motion) for one in own
        ])  # fmt: skip

    @property
    def warnings(self) -> tuple[str, ...]:
        return self._scene.warnings

    def picture(self) -> Picture | None:
        picture = self._scene.picture()
        return picture if picture is None or self._now.is_one else LeadersPicture(picture, self._now)

    @property
    def _now(self) -> Frame:
        return self._frame if self._robot is None else self._robot.frame

    def proxy(self, mass: ArrayLike, damping: ArrayLike, stiffness: ArrayLike) -> Mass:
        self._robot = robot = self._made(damping, stiffness)
        self.contacts = RobotContacts(robot, self._sees)
        return robot

    def next_step_s(self, rng: np.random.Generator) -> float:
        return self._period_s

    def towards(self, position: Vector) -> Vector:
        return position

    def signal(self, name: str, value: Signal) -> None:
        self._scene.signal(name, value)

    def signals(self) -> Mapping[str, Signal]:
        return self._scene.signals()
