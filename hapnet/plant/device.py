"""A simulated haptic device (1), held by a simulated hand and integrated by the midpoint rule.

    M x'' = tau + f - b x',    f = K_h (x_d - x) + B_h (x_d' - x') - M_h x''

A tick is divided into substeps. With ``vhat = (v1 + v0)/2`` and every force taken at the midpoint, a substep obeys

    f . vhat h = change of (kinetic + potential) + |vhat|_B^2 h + |vhat|_b^2 h

exactly, so the human port's account has no integration error. This also holds while the spring saturates or the
actuators are at their limit (see `limited_coupling`). `tick` computes a tick.
"""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike

from hapnet import checks
from hapnet.checks import Array, Vector
from hapnet.errors import InvalidParameter
from hapnet.plant.operator import Operator
from hapnet.plant.tick import DeviceState, TickModel, TickResult, tick
from hapnet.records.record import AXES, FloatRows, OfAxes, Reals, Record, compiled_as, equation
from hapnet.records.vectors import added, copy, length

TICKS = 1024
"""Number of ticks of the hand's path that are computed at once."""


class Hand(Record):
    """The hand's reference for compiled code: now, and at the end of each of the next ticks [m]. at : the present index
    on the path; known : the number of ticks on the path."""

    at: int
    known: int
    path: Annotated[FloatRows, (TICKS + 1, AXES)]


class Device(Protocol):
    """The interface that a servo needs from a device, simulated or real."""

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

        The energy account counts the returned force. So a driver that can determine it (from a limit of the actuators,
        a reversed motor, a measured current) should return it.
        """


class SimulatedDevice(Record):
    """An n-axis device with constant mass, in a simulated hand.

    operator : the hand; the device starts at rest at the hand's reference at t = 0.
    mass : apparent mass on each axis [kg]. damping : own damping b on each axis [Ns/m], 0 or above.
    period : length of a tick [s]. substeps : integration substeps in a tick.
    resolution : encoder resolution [m], 0: exact positions and velocities.
    force_limit : maximum force of the actuators [N].

    Attributes
    ----------
    limit : the force limit, infinite if there is none. time : at the end of the last tick [s]; ticks : their number.
    read_position, read_velocity, read_time : of the last `read`.

    Raises InvalidParameter: a value is not allowed.
    """

    may_wait: ClassVar[bool] = True
    """Whether ticks without news may be computed later, several at once."""
    cuts_force: ClassVar[bool] = False
    """Whether the actuators may hold less than `apply` returns; after a tick `state.torque` is the force they held."""

    dof: int
    mass: float
    period: float
    resolution: float
    limit: float
    time: float
    ticks: int
    state: DeviceState
    model: TickModel
    read_position: OfAxes
    read_velocity: OfAxes
    read_time: float

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
        self.mass = checks.positive("device.mass", mass)
        self.damping: float = checks.non_negative("device.own_damping", damping)
        self.period = checks.positive("device period", period)
        if substeps < 1:
            raise InvalidParameter("device.substeps", substeps, "1 or more")
        self._substeps = substeps
        self.operator = operator
        self.resolution = checks.non_negative("device.resolution", resolution)
        self.force_limit: float | None = (
            None if force_limit is None else checks.positive("device.force_limit", force_limit)
        )
        self.limit = math.inf if self.force_limit is None else self.force_limit
        self.time, self.ticks = 0.0, 0
        self.references: list[Vector] = [operator.reference(0.0)]
        """The hand's reference at the end of each tick of the last `run` [m]."""
        x = self.references[-1]
        self.dof = n = len(x)
        self.state = DeviceState(x)
        self.model = self._model(np.zeros((n, n)), (0.0,) * n, math.inf)
        self.read_position, self.read_velocity, self.read_time = [0.0] * n, [0.0] * n, 0.0
        _count(self)
        self.position: Vector = x
        """x [m]."""

    @property
    def velocity(self) -> Vector:
        """x' [m/s]."""
        return tuple(self.state.velocity)

    @property
    def hand_force(self) -> Vector:
        """The hand's force on the device, mean over the last substep [N]."""
        return tuple(self.state.hand_force)

    @property
    def actuator_force(self) -> Vector:
        """The actuators' force on the device, mean over the last substep [N]."""
        return tuple(self.state.actuator_force)

    @property
    def posture(self) -> Vector:
        """The joints' angles of an arm that is held at its tip [rad]; empty: there are none."""
        return ()

    @property
    def kinetic(self) -> float:
        """Kinetic energy of the device's own mass [J]."""
        return self.kinetic_at(self.state.velocity)

    @equation
    def kinetic_at(self, velocity: Reals) -> float:
        """Kinetic energy at this velocity [m/s] [J]."""
        square = 0.0
        for i in range(self.dof):
            square += velocity[i] * velocity[i]
        return 0.5 * self.mass * square

    def shared_periods(self, now_ns: int) -> int | None:
        """The periods by which a body with several sides moves in the tick at `now_ns`; None: it has one side."""
        return None

    def read(self) -> tuple[Vector, Vector]:
        """Position and velocity; with encoders, whole counts and their difference quotient since the last read."""
        if self.resolution == 0.0:
            return self.position, tuple(self.state.velocity)
        read(self)
        return tuple(self.read_position), tuple(self.read_velocity)

    def apply(self, force: Vector) -> Vector:
        """Hold a force [N], cut to the actuators' limit. Returns the force held."""
        hold(self, force)
        return tuple(self.state.torque)

    def couple(
        self, stiffness: ArrayLike, damping: ArrayLike, set_position: Vector, spring_limit: float | None = None
    ) -> None:
        """From now on the coupling (2) acts continuously within the ticks, in place of a zero-order hold.

        Spring and damper together stay within the device's force limit; the damper is reduced.

        stiffness : K [N/m]. damping : B [Ns/m], diagonal. set_position : ybar [m].
        spring_limit : force at which the spring saturates, through its potential [N]; None: never.

        Raises InvalidParameter: a value is not allowed, for example a spring that alone exceeds the device's limit.
        """
        if self.force_limit is not None and not 0.0 < (spring_limit or 0.0) <= self.force_limit:
            raise InvalidParameter("spring_limit", spring_limit, f"at most the device's own, {self.force_limit:g} N")
        K = checks.spd("stiffness", stiffness, self.dof)
        B = checks.diagonal("damping", damping, self.dof, zero_allowed=True)
        largest = float(np.linalg.eigvalsh(K)[-1])
        self.model = self._model(K, B, math.inf if spring_limit is None else spring_limit / math.sqrt(largest))
        self.state.coupled, self.state.set_position = 1, list(set_position)
        self.state.torque = [0.0] * self.dof

    def move_set_position(self, set_position: Vector) -> None:
        """Set a new ybar [m] for the active coupling."""
        self.state.set_position[:] = set_position

    def passage(self) -> tuple[Vector, Vector, float | None]:
        """Smallest and largest position on each axis since the last call [m], both ends included; with a coupling.

        The third value is the energy that the coupling's damper dissipated since then [J] if it was limited, else None.
        """
        state = self.state
        result = tuple(state.low), tuple(state.high), added(state.dissipated) if state.limited else None
        begin_passage(state, self.dof)
        return result

    def place(self, position: Vector) -> None:
        """Put the device at rest at `position` [m], where the hand already is; before the first tick."""
        self.references = [position]
        self.state.position[:] = position
        self.position = position
        begin_passage(self.state, self.dof)
        _count(self)

    def advance(self) -> float:
        """Run one tick of the servo's period. Returns the work done by the hand on the device [J]."""
        self.ticks += 1
        self.time = self.ticks * self.period
        begin, end = self.references[-1], self.operator.reference(self.time)
        self.references = [end]
        work = self._tick(begin, end)
        self.position = tuple(self.state.position)
        return work

    def _tick(self, begin: Vector, end: Vector) -> float:
        """Compute a tick into `state`; the reference moves from `begin` to `end` [m]. Returns the hand's work [J]."""
        return tick(self.model, self.state, (begin, end), 0)

    def run(self, ticks: int) -> list[TickResult]:
        """Run `ticks` ticks, with no input in between. Returns the result of each."""
        passed, period, follow = self.ticks, self.period, self.operator.reference
        self.ticks = passed + ticks
        self.time = self.ticks * period
        path = [self.references[-1], *[follow(k * period) for k in range(passed + 1, passed + ticks + 1)]]
        self.references = path[1:]
        results = self.model.run(self.state, path)
        self.position = tuple(self.state.position)
        return results

    def _model(self, stiffness: Array, damping: Vector, knee: float) -> TickModel:
        limit = math.inf if self.force_limit is None else self.force_limit
        hand = self.operator.impedance
        return TickModel(
            self.dof, self.mass, self.damping, hand, self.period, self._substeps, stiffness, damping, knee, limit
        )


def _compiled_advance(device: SimulatedDevice, hand: Hand) -> float:
    work = tick(device.model, device.state, hand.path, hand.at)
    hand.at += 1
    device.ticks += 1
    device.time = device.ticks * device.period
    return work


@compiled_as(_compiled_advance)
def advance(device: SimulatedDevice, hand: Hand | None) -> float:
    """Run a tick, and return the hand's work [J]; plain Python gets the hand's reference from the operator."""
    return device.advance()


@equation
def _count(device: SimulatedDevice) -> None:
    """Round the position to whole counts of the encoders."""
    r, x = device.resolution, device.state.position
    for i in range(device.dof):
        device.read_position[i] = x[i] if r == 0.0 else r * round(x[i] / r)


@equation
def read(device: SimulatedDevice) -> None:
    """Read position and velocity: `SimulatedDevice.read`."""
    n, x, v, span = device.dof, device.read_position, device.read_velocity, device.time - device.read_time
    device.read_time = device.time
    copy(n, device.state.velocity if device.resolution == 0.0 else x, v)
    _count(device)
    if device.resolution != 0.0:
        for i in range(n):
            v[i] = (x[i] - v[i]) / span if span != 0.0 else 0.0


@equation
def hold(device: SimulatedDevice, force: Reals) -> None:
    """Hold a force [N] in `torque`, cut to the actuators' limit."""
    torque, size = device.state.torque, length(device.dof, force)
    if size > device.limit:
        for i in range(device.dof):
            torque[i] = force[i] * device.limit / size
    else:
        copy(device.dof, force, torque)


@compiled_as(hold)
def apply(device: SimulatedDevice, force: Reals) -> None:
    """Hold a force [N], as `Device.apply`."""
    device.apply(tuple(force))


@equation
def begin_passage(state: DeviceState, n: int) -> None:
    """Reset the values that `passage` returns."""
    for i in range(n):
        state.low[i] = state.high[i] = state.position[i]
        state.dissipated[i] = 0.0
    state.limited = 0


kinetic_at = SimulatedDevice.kinetic_at
"""The name in equations."""
