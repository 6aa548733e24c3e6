"""A handle of six degrees of freedom in a simulated hand: a device of the twelve coordinates of a pose.

`TurningHand` is a hand that also turns: another hand's motion, with an orientation added.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import pi, sin
from typing import Any

from numpy.typing import ArrayLike

from hapnet import checks
from hapnet.assembly.choices import Choice, Contribution
from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.tools import body_step
from hapnet.ext.tools.body import RigidBody, Touched, kinetic, settle
from hapnet.mechanics.pose import ARM_M, AXES, OfPose, coordinates, nearest, of_rotation_vector
from hapnet.params import Params
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.live_hand import LiveHand, WrappedHand
from hapnet.plant.operator import Impedance, Operator, minimum_jerk
from hapnet.records.record import Reals, Record, equation, zero
from hapnet.records.vectors import copy

MOST_PARTS = 1024
"""The greatest number of parts into which a step is cut if it is not found at once."""


class Handle(Record):
    """A handle and the hand that holds it.

    period, h : of a tick, and of a step [s]; steps : their number in a tick. The body's damping is B_h + b.
    hand_share : of the hand's mass in the body's. hand_stiffness [N/m], hand_damping [Ns/m] : K_h, B_h.

    Attributes
    ----------
    held : the force that is held (12,) [N]. hand_force : mean in the last step (12,) [N], without its mass's.
    unsettled : number of steps that were not found, in which the handle did not move.
    """

    body: RigidBody
    steps: int
    period: float
    h: float
    hand_share: float
    hand_stiffness: float
    hand_damping: float
    held: OfPose
    hand_force: OfPose
    unsettled: int
    hand_work: float
    aim: OfPose
    push: OfPose
    begun: OfPose
    reached: OfPose
    free: Touched


@equation
def tick(handle: Handle, path: Sequence[Reals]) -> float:
    """Do a tick, while the hand's reference goes from path[0] to path[1] [m]. Returns the hand's work [J]."""
    body, h, K, B, work = handle.body, handle.h, handle.hand_stiffness, handle.hand_damping, 0.0
    for done in range(handle.steps):
        share = (done + 0.5) / handle.steps
        for i in range(AXES):
            rate = (path[1][i] - path[0][i]) / handle.period
            handle.aim[i] = path[0][i] + share * (path[1][i] - path[0][i])
            handle.push[i] = handle.held[i] + B * rate
            handle.begun[i] = body.x[i]
        before = kinetic(body)
        _go_on(handle, h)
        for i in range(AXES):
            middle, moved = 0.5 * (handle.begun[i] + body.x[i]), body.x[i] - handle.begun[i]
            handle.hand_force[i] = handle.push[i] - handle.held[i] + K * (handle.aim[i] - middle) - B * moved / h
        work += handle.hand_work
        work -= handle.hand_share * (kinetic(body) - before)
    return work


@equation
def _go_on(handle: Handle, h: float) -> None:
    """Move the handle by a step of `h` [s], in parts if it is not found at once. Returns the hand's work [J]."""
    body, left, part, K, B = handle.body, h, h, handle.hand_stiffness, handle.hand_damping
    handle.hand_work = 0.0
    while left > 0.25 * part:
        copy(AXES, body.x, handle.reached)
        if body_step.step(body, part, handle.push, handle.aim, handle.free):
            left -= part
            for i in range(AXES):
                pull = handle.push[i] - handle.held[i] + K * (handle.aim[i] - body.middle[i]) - B * body.mean[i]
                handle.hand_work += pull * (body.x[i] - handle.reached[i])
        elif part > h / MOST_PARTS:
            part *= 0.5
        else:
            handle.unsettled += 1
            _rest(body)
            left = 0.0


@equation
def _rest(body: RigidBody) -> None:
    """Stop the body where it is, after a step that cannot be found: this takes energy and never makes any."""
    for i in range(3):
        body.velocity[i] = body.spin[i] = 0.0
    for i in range(AXES):
        body.mean[i], body.middle[i] = 0.0, body.x[i]
    settle(body)


class SimulatedHandle(SimulatedDevice):
    """A handle that a simulated hand holds; it begins at rest at the hand's reference.

    Along all twelve coordinates it has the same mass and own damping, so its inertia is ``2 m l^2`` about every axis,
    and so is the hand's. The force of a tick is held along the coordinates: its torque turns with the handle.

    arm_m : the length of the pose's arms [m]. The other parameters are those of `SimulatedDevice`.

    Raises InvalidParameter: a value is not allowed.
    """

    def __init__(self, operator: Operator, *, arm_m: float = ARM_M, **others: Any) -> None:
        super().__init__(operator, **others)
        if self.dof != AXES:
            raise InvalidParameter("operator", f"{self.dof} axes", f"a hand that gives poses, of {AXES} coordinates")
        self.arm_m = checks.positive("arm_m", arm_m)
        hand = operator.impedance
        whole, damping = self.mass + hand.mass, hand.damping + self.damping
        self.handle = made = zero(Handle)
        made.body = RigidBody(whole, (2.0 * whole * arm_m * arm_m,) * 3, self.position, arm_m)
        made.body.hold(hand.stiffness, damping, hand.stiffness, damping)
        settle(made.body)
        made.steps, made.period, made.h = self._substeps, self.period, self.period / self._substeps
        made.hand_share = hand.mass / whole
        made.hand_stiffness, made.hand_damping = hand.stiffness, hand.damping
        self.compiled: Callable[[Vector, Vector], float] | None = None
        """A compiled tick of `handle`, for the hand's reference at its begin and end; None: Python runs the ticks."""

    @property
    def kinetic(self) -> float:
        return (1.0 - self.handle.hand_share) * self.handle.body.kinetic

    def place(self, position: Vector) -> None:
        position = nearest(position, self.arm_m)
        super().place(position)
        self.handle.body.x[:] = position
        settle(self.handle.body)

    def apply(self, force: Vector) -> Vector:
        held = super().apply(force)
        self.handle.held[:] = held
        return held

    def couple(
        self, stiffness: ArrayLike, damping: ArrayLike, set_position: Vector, spring_limit: float | None = None
    ) -> None:
        """Refuse: a handle's force is held from tick to tick."""
        raise InvalidParameter("device.servo", "continuous", "sampled with a pose")

    def _tick(self, begin: Vector, end: Vector) -> float:
        handle, state = self.handle, self.state
        work = self._run(begin, end)
        state.position[:], state.velocity[:] = handle.body.x, handle.body.v
        state.hand_force[:], state.actuator_force[:] = handle.hand_force, handle.held
        return work

    def _run(self, begin: Vector, end: Vector) -> float:
        """Do a tick of the handle's record. Returns the hand's work in it [J]."""
        return tick(self.handle, (begin, end)) if self.compiled is None else self.compiled(begin, end)


RATES = (1.0, 0.73, 0.59)
"""Frequencies of the three components of the rotation, relative to `turn_hz`: no multiples of each other."""

_START_S = 1.0
"""The time in which the turning grows to its amplitude [s]."""


class TurningHand(WrappedHand):
    """An operator of poses: its point follows `hand`, and it turns about all three axes.

    Its impedance along the pose's coordinates is that of `hand`, so K_h turns with ``2 K_h l^2`` Nm/rad.

    hand : of three axes; a hand led by a mouse does not turn. turn_rad : amplitude of each component of the rotation
        vector [rad]. turn_hz : the frequency of the first. arm_m : l [m].
    """

    def __init__(self, hand: Operator, turn_rad: float, turn_hz: float, arm_m: float = ARM_M) -> None:
        self.impedance: Impedance = hand.impedance
        self.hand, self._arm_m = hand, arm_m
        self._turn = 0.0 if isinstance(hand, LiveHand) else checks.non_negative("operator_model.turn_rad", turn_rad)
        self._omega = 2.0 * pi * checks.non_negative("operator_model.turn_hz", turn_hz)

    def reference(self, t: float) -> Vector:
        """The pose (12,) [m] at t [s]."""
        share = self._turn * minimum_jerk(t / _START_S)
        return turned(
            self.hand.reference(t), tuple([share * sin(self._omega * rate * t) for rate in RATES]), self._arm_m
        )


def turned(position: Vector, rotation: Vector, arm_m: float = ARM_M) -> Vector:
    """The coordinates (12,) [m] of the pose at `position` (3,) [m], turned by a rotation vector (3,) [rad]."""
    return coordinates(position, of_rotation_vector(rotation), arm_m)


_OF_SPRINGS = ("device.stiffness", "device.damping", "world.stiffness", "world.damping")


def for_all_coordinates(params: Params) -> Choice:
    """Expand a pose's two numbers, in N/m and Nm/rad (or Ns/m and Nms/rad), to one for each of its coordinates."""
    found: dict[str, object] = {}
    for name in _OF_SPRINGS:
        value = params.get(name)
        if isinstance(value, tuple) and len(value) == 2 and not isinstance(value[0], tuple):
            if not min(value) > 0.0:
                what = "N/m and Nm/rad" if name.endswith("stiffness") else "Ns/m and Nms/rad"
                raise InvalidParameter(name, value, f"one number, or two above 0 in {what}")
            found[name] = (value[0],) * 3 + (value[1] / (2.0 * ARM_M**2),) * (AXES - 3)
    return Choice(found, {name: params.source(name) for name in found})


CONTRIBUTION = Contribution(in_scene=(for_all_coordinates,), sampled_only=True)
