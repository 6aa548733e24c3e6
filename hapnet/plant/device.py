"""A simulated haptic device (1), held by a simulated hand and integrated by the midpoint rule.

    M x'' = tau + f - b x',    f = K_h (x_d - x) + B_h (x_d' - x') - M_h x''

A tick is divided into substeps. With ``vhat = (v1 + v0)/2`` and every force taken at the midpoint, a substep obeys

    f . vhat h = change of (kinetic + potential) + |vhat|_B^2 h + |vhat|_b^2 h

exactly, so the human port's account has no integration error. This also holds while the spring saturates or the
actuators are at their limit (see `limited_coupling`). `tick` computes a tick.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from hapnet import checks
from hapnet.checks import Array, Vector
from hapnet.errors import InvalidParameter
from hapnet.plant.operator import Operator
from hapnet.plant.tick import DeviceState, TickModel
from hapnet.plant.tick import TickResult as TickResult


class Device(Protocol):
    """What a servo needs from a device, simulated or real."""

    @property
    def dof(self) -> int: ...

    @property
    def force_limit(self) -> float | None:
        """Greatest force of the actuators [N]; None: no limit."""

    @property
    def resolution(self) -> float:
        """Resolution of the encoders [m]; 0: exact positions."""

    def read(self) -> tuple[Vector, Vector]:
        """Present position [m] and velocity [m/s], shape (n,) each."""

    def apply(self, force: Vector) -> Vector | None:
        """Hold this force [N] until the next call. Returns the force really applied; None if it is unknown.

        The energy account counts the returned force. So a driver that knows it (from a limit of the actuators, a
        reversed motor, a measured current) should return it.
        """


class SimulatedDevice:
    """An n-axis device with constant mass, in a simulated hand.

    Parameters
    ----------
    operator : the hand; the device starts at rest at the hand's reference at t = 0.
    mass : apparent mass on each axis [kg]. damping : own damping b on each axis [Ns/m], 0 or above.
    period : length of a tick [s]. substeps : integration substeps in a tick.
    resolution : encoder resolution [m], 0: exact positions and velocities.
    force_limit : greatest force of the actuators [N].

    Raises
    ------
    InvalidParameter : a value is not allowed.
    """

    def __init__(
        self,
        operator: Operator,
        *,
        mass: float = 0.045,
        damping: float = 0.3,
        period: float = 1e-3,
        substeps: int = 4,
        resolution: float = 0.0,
        force_limit: float | None = None,
    ) -> None:
        self.mass: float = checks.positive("device.mass", mass)
        self._half_mass = 0.5 * self.mass
        self.damping: float = checks.non_negative("device.own_damping", damping)
        self.period: float = checks.positive("device period", period)
        if substeps < 1:
            raise InvalidParameter("device.substeps", substeps, "1 or more")
        self._substeps = substeps
        self.operator = operator
        self.resolution: float = checks.non_negative("device.resolution", resolution)
        self.force_limit: float | None = (
            None if force_limit is None else checks.positive("device.force_limit", force_limit)
        )
        self.time: float = 0.0
        self.ticks: int = 0
        self.references: list[Vector] = [operator.reference(0.0)]
        """The hand's reference at the end of each tick of the last `run` [m]."""
        x = self.references[-1]
        zero = (0.0,) * len(x)
        self.state: DeviceState = DeviceState(x, zero, zero, zero, zero, x, x)
        self.model: TickModel = self._model(np.zeros((len(x), len(x))), zero, math.inf)
        self._read, self._read_time = self._count(), 0.0

    @property
    def dof(self) -> int:
        return len(self.state.position)

    @property
    def position(self) -> Vector:
        """x [m]."""
        return self.state.position

    @property
    def velocity(self) -> Vector:
        """x' [m/s]."""
        return self.state.velocity

    @property
    def hand_force(self) -> Vector:
        """The hand's force on the device, mean over the last substep [N]."""
        return self.state.hand_force

    @property
    def actuator_force(self) -> Vector:
        """The actuators' force on the device, mean over the last substep [N]."""
        return self.state.actuator_force

    @property
    def kinetic(self) -> float:
        """Kinetic energy of the device's own mass [J]."""
        return self.kinetic_at(self.state.velocity)

    def kinetic_at(self, velocity: Vector) -> float:
        """Kinetic energy at this velocity [m/s] [J]."""
        if len(velocity) == 1:
            return self._half_mass * (velocity[0] * velocity[0])
        square = 0.0
        for v in velocity:
            square += v * v
        return self._half_mass * square

    def read(self) -> tuple[Vector, Vector]:
        """Position and velocity; with encoders, whole counts and their difference quotient since the last read."""
        if self.resolution == 0.0:
            return self.state.position, self.state.velocity
        before, self._read = self._read, self._count()
        span, self._read_time = self.time - self._read_time, self.time
        if span == 0.0:
            return self._read, (0.0,) * self.dof
        return self._read, tuple([(b - a) / span for a, b in zip(before, self._read, strict=True)])

    def apply(self, force: Vector) -> Vector:
        """Hold a force [N], cut to the actuators' limit. Returns the force held."""
        length = math.hypot(*force)
        if self.force_limit is not None and length > self.force_limit:
            force = tuple([component * self.force_limit / length for component in force])
        self.state.torque = force
        return force

    def couple(
        self, stiffness: ArrayLike, damping: ArrayLike, set_position: Vector, spring_limit: float | None = None
    ) -> None:
        """From now on let the coupling (2) act within the ticks, in place of a held force.

        Spring and damper together stay within the device's force limit; the damper is reduced.

        Parameters
        ----------
        stiffness : K [N/m]. damping : B [Ns/m], diagonal. set_position : ybar [m].
        spring_limit : force at which the spring saturates, through its potential [N]; None: never.

        Raises
        ------
        InvalidParameter : a value is not allowed, for example a spring that alone exceeds the device's limit.
        """
        if self.force_limit is not None and not 0.0 < (spring_limit or 0.0) <= self.force_limit:
            raise InvalidParameter("spring_limit", spring_limit, f"at most the device's own, {self.force_limit:g} N")
        K = checks.spd("stiffness", stiffness, self.dof)
        B = checks.diagonal("damping", damping, self.dof, zero_allowed=True)
        largest = float(np.linalg.eigvalsh(K)[-1])
        self.model = self._model(K, B, math.inf if spring_limit is None else spring_limit / math.sqrt(largest))
        self.state.set_position = set_position
        self.state.torque = (0.0,) * self.dof

    def move_set_position(self, set_position: Vector) -> None:
        """Set a new ybar [m] for the active coupling."""
        self.state.set_position = set_position

    def passage(self) -> tuple[Vector, Vector, float | None]:
        """Smallest and largest position on each axis since the last call [m], both ends included; with a coupling.

        The third value is what the coupling's damper dissipated since then [J] if it was limited, else None.
        """
        state = self.state
        result = state.low, state.high, state.dissipated if state.limited else None
        state.low = state.high = state.position
        state.dissipated, state.limited = 0.0, False
        return result

    def place(self, position: Vector) -> None:
        """Rest at `position` [m], where the hand already is; before the first tick."""
        self.references = [position]
        self.state.position = self.state.low = self.state.high = position
        self._read = self._count()

    def advance(self) -> float:
        """Run one tick of the servo's period. Returns the work done by the hand on the device [J]."""
        if self.state.set_position is not None:
            return self.run(1)[0][0]
        self.ticks += 1
        self.time = self.ticks * self.period
        begin, end = self.references[-1], self.operator.reference(self.time)
        self.references = [end]
        return self.model.held(self.state, begin, end)

    def run(self, ticks: int) -> list[TickResult]:
        """Run `ticks` ticks, with no input in between. Returns the result of each."""
        passed, period, follow = self.ticks, self.period, self.operator.reference
        self.ticks = passed + ticks
        self.time = self.ticks * period
        path = [self.references[-1], *[follow(k * period) for k in range(passed + 1, passed + ticks + 1)]]
        self.references = path[1:]
        return self.model.run(self.state, path)

    def _model(self, stiffness: Array, damping: Vector, knee: float) -> TickModel:
        limit = math.inf if self.force_limit is None else self.force_limit
        hand = self.operator.impedance
        return TickModel(
            self.dof, self.mass, self.damping, hand, self.period, self._substeps, stiffness, damping, knee, limit
        )

    def _count(self) -> Vector:
        r, position = self.resolution, self.state.position
        return position if r == 0.0 else tuple([r * round(x / r) for x in position])
