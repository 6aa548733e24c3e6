"""A follower's simulated robot, in the leader's units; `hapnet.ext.robots.robot_scene` is what it stands in.

The leader's motion may be scaled to the robot, and the robot's force to the hand (`hapnet.mechanics.frame`). Only this
module uses the robot's own units.

The robot has a mass, its own damping, friction and encoders, and touches any contacts of the scene. If its force is
held from tick to tick, its port is the actuator's, and mass and contacts are the environment behind it. If the coupling
acts within the step, its port is that of its contacts, as with a virtual mass.

A robot with a position servo gets a place from each tick, and renders the spring and the damper to it itself, in steps
of 1 ms at most. The account counts the force that the servo really applied, as that of a driver that measures it.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

from hapnet.checks import Vector
from hapnet.ext.robots.friction import friction_drag
from hapnet.mechanics.contacts import Mass, Step, Surroundings, doing
from hapnet.mechanics.frame import Frame
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


class RobotForces(NamedTuple):
    """The forces on a robot in a part of a tick besides its contacts, in its own units.

    pull, brake : of its servo [N], [Ns/m]. push, hold : of all else from outside. drag : all drag together, with its
    own damping and friction.
    """

    pull: Vector
    brake: float
    push: Vector
    hold: float
    drag: float

    @property
    def force(self) -> Vector:
        """Of the servo and from outside [N]."""
        return tuple([one + more for one, more in zip(self.pull, self.push, strict=True)])


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
        self.is_joint = False
        """Whether its contacts are solved together with those of other robots, once a tick."""
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
        frame = self.frame
        held = frame.own_force(push)
        count = max(1, round(dt / PART_S)) if self.held and not (self._engine or self.is_joint) else 1
        part, begun = dt / count, self.body.position
        aim = self._aim(held)
        force, applied, work, served, depth = [0.0] * len(held), [0.0] * len(held), 0.0, 0.0, 0.0
        for _ in range(count):
            acts = self._forces_in(part, drag / (frame.motion * frame.force), held, aim)
            done = self.body.push(part, acts.drag, acts.force if self.outside else acts.pull, self.contacts)
            self._touched = done.force
            if self.outside is not None:
                moving = done.velocity
                self.outside.put_in_J += part * (inner(acts.push, moving) - acts.hold * inner(moving, moving))
            servo = [one - acts.brake * v for one, v in zip(acts.pull, done.velocity, strict=True)]
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

    def drive(self, dt: float, push: Vector) -> tuple[float, Vector]:
        """The drag [Ns/m] and the push [N] of a joint step of `dt` seconds under the held force `push` [N] (in the
        leader's units), in its own units and without its contacts."""
        held = self.frame.own_force(push)
        acts = self._forces_in(dt, 0.0, held, self._aim(held))
        return acts.drag, acts.pull

    def _forces_in(self, dt: float, drag: float, held: Vector, aim: Vector | None) -> RobotForces:
        """The forces in a part of a tick; drag : of the coupling [Ns/m]."""
        own = self._own
        pull, brake = (held, 0.0) if aim is None else self._serve(dt, aim)
        known = tuple([one + touch for one, touch in zip(pull, self._touched, strict=True)])
        others, push, hold = drag + own.damping + brake, (0.0,) * len(pull), 0.0
        if self.outside is not None:
            push, hold = self.outside.acts(dt, self.body.position)
            known = tuple([one + more for one, more in zip(known, push, strict=True)])
            others += hold
        rubs = friction_drag(own.friction, own.mass, others, dt, self.body.velocity, known)
        return RobotForces(pull, brake, push, hold, others + rubs)

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
