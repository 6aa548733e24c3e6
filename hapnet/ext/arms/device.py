"""An arm in a simulated hand, as a device: its tip's position in three axes, or its joints' angles, from home."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.arms import motion
from hapnet.ext.arms.chain import Chain, difference, gravity
from hapnet.ext.arms.made import arm_of
from hapnet.ext.arms.table import ArmTable
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.operator import Operator
from hapnet.records.vectors import added, copy

TIP_AXES = 3

_NEAR_M = 1e-9
_DAMPED, _MOST_STEPS = 1e-6, 200


class SimulatedArm(SimulatedDevice):
    """An arm that a simulated hand holds, at its tip or joint by joint; it begins at rest at the hand's reference.

    A force is held at the tip through the Jacobian, along the world's axes, or as a torque of each joint. If a motor's
    limit, less its part of the arm's weight, does not suffice, the largest multiple within all limits is rendered:
    `state.torque` after a tick.

    table : the arm. operator : the hand. period : length of a tick [s]. substeps : integration steps in a tick.
    resolution : of the joints' encoders [rad], or the largest that they cause on an axis of the tip [m]; 0: exact.
    force_limit : maximum force [N], or torque of all joints together [Nm]. compensated : whether the motors carry the
    arm's weight. by_joints : whether axes and hand are those of the joints, in rad and Nm.

    Raises InvalidParameter: a value is not allowed, or the hand's start is out of reach.
    """

    cuts_force = True

    def __init__(
        self,
        table: ArmTable,
        operator: Operator,
        *,
        period: float = 1e-3,
        substeps: int = 4,
        resolution: float = 0.0,
        force_limit: float | None = None,
        compensated: bool = True,
        by_joints: bool = False,
    ) -> None:
        super().__init__(
            operator, damping=0.0, period=period, substeps=substeps, resolution=resolution, force_limit=force_limit
        )
        if self.dof != (axes := len(table.free) if by_joints else TIP_AXES):
            raise InvalidParameter("dof", self.dof, f"{axes}, the {'joints of' if by_joints else 'axes of the tip of'} "
                                   f"{table.name}")  # fmt: skip
        if by_joints:
            require_hinges(table)
        self.table = table
        self.arm = arm_of(table, operator.impedance, period, substeps, compensated=compensated, by_joints=by_joints)
        # at the tip no axis errs by more than half a resolution
        self._per_count = resolution if by_joints else resolution / (added(table.levers) or 1.0)
        self._require_strength()
        self.compiled: Callable[[Vector, Vector], float] | None = None
        """A compiled tick of `arm`, for the hand's reference at its begin and end; None: Python runs the ticks."""
        self.place(self.position)

    def _require_strength(self) -> None:
        """Raise InvalidParameter if a motor cannot carry its part of the arm's weight, as it could render nothing."""
        arm = self.arm
        gravity(arm.chain, arm.q, arm.q, arm.load)
        for joint, load in zip(self.table.free, arm.load, strict=False):
            if arm.compensated and joint.effort <= abs(load):
                unit = "N" if joint.slides else "Nm"
                allowed = f"above {abs(load):.3g} {unit}, which the arm's weight needs at home"
                raise InvalidParameter(f"the effort of {self.table.name}'s joint {joint.name}", joint.effort, allowed)

    @property
    def kinetic(self) -> float:
        return motion.kinetic(self.arm)

    @property
    def potential(self) -> float:
        """Energy in the joints' stops, and of the weight if it is not compensated [J]."""
        return motion.potential(self.arm)

    @property
    def angles(self) -> Vector:
        """The free joints' angles q [rad]."""
        return tuple(self.arm.q[: self.arm.n])

    @property
    def posture(self) -> Vector:
        return () if self.arm.port.by_joints else self.angles

    def place(self, position: Vector) -> None:
        arm = self.arm
        arm.q[: arm.n] = (
            turned(self.table, position) if arm.port.by_joints else inverse(arm.chain, self.table, position)
        )
        for i in range(arm.n):
            arm.z[i] = arm.rates[i] = 0.0
        motion.look(arm)
        super().place(position)
        copy(self.dof, arm.x, self.state.position)
        self.position = tuple(self.state.position)
        self.read_position[:] = self._counted()

    def read(self) -> tuple[Vector, Vector]:
        if self.resolution == 0.0:
            return self.position, tuple(self.state.velocity)
        x, span = self._counted(), self.time - self.read_time
        if span > 0.0:
            self.read_velocity[:] = [(new - old) / span for new, old in zip(x, self.read_position, strict=True)]
        self.read_position[:], self.read_time = x, self.time
        return x, tuple(self.read_velocity)

    def _counted(self) -> Vector:
        """The port's position as the encoders measure it [m] or [rad]."""
        arm, unit = self.arm, self._per_count
        q = [unit * round(angle / unit) if unit else angle for angle in arm.q]
        motion.look_at_port(arm, q, q)
        return tuple(arm.port.begin[: self.dof])

    def apply(self, force: Vector) -> Vector:
        held = super().apply(force)
        self.arm.commanded[: self.dof] = held
        return held

    def couple(
        self, stiffness: ArrayLike, damping: ArrayLike, set_position: Vector, spring_limit: float | None = None
    ) -> None:
        """Refuse: an arm's force is held from tick to tick."""
        raise InvalidParameter("device.servo", "continuous", "sampled with an arm")

    def _tick(self, begin: Vector, end: Vector) -> float:
        arm, state = self.arm, self.state
        work = self._run(begin, end)
        for mine, ours in (
            (arm.x, state.position), (arm.v, state.velocity), (arm.hand_force, state.hand_force),
            (arm.force, state.torque), (arm.force, state.actuator_force),
        ):  # fmt: skip
            copy(self.dof, mine, ours)
        return work

    def _run(self, begin: Vector, end: Vector) -> float:
        """Do a tick of the arm's record. Returns the hand's work in it [J]."""
        return motion.tick(self.arm, (begin, end), 0) if self.compiled is None else self.compiled(begin, end)


def require_hinges(table: ArmTable) -> None:
    """Raise InvalidParameter if a joint slides: coupled joint by joint, all axes have one unit."""
    for joint in table.free:
        if joint.slides:
            why = f"its joint {joint.name} slides; axes=joints needs joints that turn, as all axes have one unit"
            raise InvalidParameter("the arm", table.name, "", why=why)


def turned(table: ArmTable, position: Vector) -> list[float]:
    """The posture at `position` from home, joint by joint [rad]. Raises InvalidParameter: beyond a stop."""
    q = [home + angle for home, angle in zip(table.home, position, strict=True)]
    for joint, angle in zip(table.free, q, strict=True):
        if not joint.lower <= angle <= joint.upper:
            allowed = f"within its stops, {joint.lower:g} to {joint.upper:g} rad"
            raise InvalidParameter(f"the hand's start at {table.name}'s joint {joint.name} [rad]", angle, allowed)
    return q


def inverse(chain: Chain, table: ArmTable, position: Vector) -> list[float]:
    """A posture with the tip at `position` [m], by damped least squares from home, within the stops [rad].

    Raises InvalidParameter: none was found.
    """
    n, tip = chain.n, chain.tip
    q, target, reach = np.array(table.home), np.array(position), max(table.reaches) or 1.0
    lower, upper = (np.array(ends) for ends in zip(*((joint.lower, joint.upper) for joint in table.free), strict=True))
    for _ in range(_MOST_STEPS):
        difference(chain, tip, q.tolist(), q.tolist())
        error = target - np.array(tip.begin)
        if float(np.linalg.norm(error)) <= _NEAR_M * reach:
            return [float(angle) for angle in q]
        J = np.array(tip.columns)[:n].T
        q = np.clip(q + J.T @ np.linalg.solve(J @ J.T + _DAMPED * reach**2 * np.eye(3), error), lower, upper)
    shown = tuple(round(value, 6) for value in position)
    allowed = f"within the reach of {table.name}, counted from the tip at home"
    raise InvalidParameter("the hand's start [m]", shown, allowed)
