"""Simulated haptic devices (1), held by a simulated hand, integrated by the midpoint rule.

    M x'' = tau + f - b x',    f = K_h (x_d - x) + B_h (x_d' - x') - M_h x''

A tick is cut into substeps. With ``vhat = (v1 + v0)/2`` and every force taken at the midpoint, a substep obeys

    f . vhat h = change of (kinetic + potential) + |vhat|_B^2 h + |vhat|_b^2 h

exactly, so the account of the human's port has no error of integration. Where the spring saturates, the midpoint spring
is replaced by the discrete gradient of its potential, ``-c K e_mid``, with the same effect.
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


class Device(Protocol):
    """What a servo needs of a device, simulated or real."""

    @property
    def dof(self) -> int: ...

    @property
    def force_limit(self) -> float | None:
        """Longest force the actuators give [N]; None: no limit."""

    @property
    def resolution(self) -> float:
        """Of the encoders [m]; 0: none."""

    def read(self) -> tuple[Vector, Vector]:
        """Position [m] and velocity [m/s] now, shape (n,) each."""

    def apply(self, force: Vector) -> None:
        """Hold this force [N] until the next call."""


class SimulatedDevice:
    """An n-axis device with constant mass, in a simulated hand.

    Parameters
    ----------
    operator : the hand; the device starts at rest at its reference at t = 0.
    mass : apparent mass [kg] an axis. damping : own damping b [Ns/m] an axis, 0 or above.
    period : length of a tick [s]; substeps : of the integration a tick.
    resolution : encoder resolution [m], 0: exact positions and velocities.
    force_limit : longest force the actuators give [N].

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
        self.mass = checks.positive("device.mass", mass)
        self.damping = checks.non_negative("device.own_damping", damping)
        self.period = checks.positive("device period", period)
        if substeps < 1:
            raise InvalidParameter("device.substeps", substeps, "1 or more")
        self._substeps = range(substeps)
        self._h = self.period / substeps
        self._hand = operator.impedance
        self.resolution = checks.non_negative("device.resolution", resolution)
        self.force_limit = None if force_limit is None else checks.positive("device.force_limit", force_limit)
        self.time = 0.0
        self._ticks = 0
        self._follow = operator.reference
        self._reference = operator.reference(0.0)
        self.position: Vector = self._reference
        self.velocity: Vector = (0.0,) * len(self.position)
        self.hand_force: Vector = self.velocity
        """The hand's force on the device, mean over the last substep [N]."""
        self._low = self._high = self.position
        self._read = self._count()
        self._read_time = 0.0
        self._torque: Vector = self.velocity
        self._set_position: Vector | None = None
        self._knee = math.inf
        self._K = self._coupling_damping = np.zeros((self.dof, self.dof))
        self._prepare()

    @property
    def dof(self) -> int:
        return len(self.position)

    @property
    def kinetic(self) -> float:
        """Of the device's own mass [J]."""
        square = 0.0
        for v in self.velocity:
            square += v * v
        return 0.5 * self.mass * square

    def read(self) -> tuple[Vector, Vector]:
        """Position and velocity; with encoders, whole counts and their backward difference since the last read."""
        if self.resolution == 0.0:
            return self.position, self.velocity
        before, self._read = self._read, self._count()
        span, self._read_time = self.time - self._read_time, self.time
        if span == 0.0:
            return self._read, (0.0,) * self.dof
        return self._read, tuple([(b - a) / span for a, b in zip(before, self._read, strict=True)])

    def apply(self, force: Vector) -> None:
        """Hold a force [N], cut to the actuators' limit."""
        length = math.hypot(*force)
        if self.force_limit is not None and length > self.force_limit:
            force = tuple([component * self.force_limit / length for component in force])
        self._torque = force

    def couple(
        self, stiffness: ArrayLike, damping: ArrayLike, set_position: Vector, force_limit: float | None = None
    ) -> None:
        """Let the coupling (2) act within the ticks from now on, in place of a held force.

        Parameters
        ----------
        stiffness : K [N/m]. damping : B [Ns/m], diagonal. set_position : ybar [m].
        force_limit : the spring saturates here [N], through its potential; None: never.
        """
        self._K = checks.spd("stiffness", stiffness, self.dof)
        self._coupling_damping = np.diag(checks.diagonal("damping", damping, self.dof, zero_allowed=True))
        largest = float(np.linalg.eigvalsh(self._K)[-1])
        self._knee = math.inf if force_limit is None else force_limit / math.sqrt(largest)
        self._set_position = set_position
        self._prepare()

    def move_set_position(self, set_position: Vector) -> None:
        """A new ybar [m] for the coupling that is in force."""
        self._set_position = set_position

    def extremes(self) -> tuple[Vector, Vector]:
        """Smallest and largest position of each axis [m] since the last call, both ends included."""
        result = self._low, self._high
        self._low = self._high = self.position
        return result

    def advance(self) -> float:
        """One tick of the servo's period; the work done by the hand on the device [J]."""
        self._ticks += 1
        self.time = self._ticks * self.period
        start = self._reference
        self._reference = self._follow(self.time)
        if self._decoupled:
            work = self._advance_axes(start)
            if work is not None:
                return work
        return self._advance_coupled(start)

    # -- axis by axis: K diagonal and not saturated ------------------------------------------------------------------

    def _advance_axes(self, reference: Vector) -> float | None:
        """The tick with each axis on its own: its work; None, and nothing changed, if the spring may have saturated."""
        kh, bh, h = self._hand.stiffness, self._hand.damping, self._h
        ybar = self._set_position or self.position
        work = stretch = 0.0
        moved = []
        for axis, (k, constants) in enumerate(self._decoupled):
            rate = (self._reference[axis] - reference[axis]) / self.period
            y = ybar[axis]
            after = _advance_axis(
                self.position[axis],
                self.velocity[axis],
                k * y + self._torque[axis],
                kh * reference[axis] + (bh - 0.5 * kh * h) * rate,
                kh * h * rate,
                self._low[axis],
                self._high[axis],
                constants,
                self._substeps,
            )
            work += after[0]
            farthest = max(after[4] - y, y - after[3])
            stretch += k * farthest * farthest
            moved.append(after)
        if stretch > self._knee_square:
            return None
        if len(moved) == 1:
            _, x, v, low, high, f = moved[0]
            self.position, self.velocity, self._low, self._high, self.hand_force = (x,), (v,), (low,), (high,), (f,)
        else:
            _, self.position, self.velocity, self._low, self._high, self.hand_force = zip(*moved, strict=True)
        return work * h

    # -- any K, saturated or not -------------------------------------------------------------------------------------

    def _advance_coupled(self, reference: Vector) -> float:
        h, kh, bh = self._h, self._hand.stiffness, self._hand.damping
        K, knee = self._K, self._knee
        x, v = np.array(self.position), np.array(self.velocity)
        ybar = np.array(self._set_position or self.position)
        rate = (np.array(self._reference) - np.array(reference)) / self.period
        hand_drive = kh * np.array(reference) + (bh - 0.5 * kh * h) * rate
        low, high = np.array(self._low), np.array(self._high)
        work = 0.0
        f = np.zeros(self.dof)
        for _ in self._substeps:
            hand_drive = hand_drive + kh * h * rate
            push = self._inertia * v + self._torque + hand_drive - kh * x
            e = x - ybar
            pull = K @ e
            middle: Array = self._inverse @ (push - pull)
            if knee != math.inf:
                middle = self._saturate(middle, push, e, pull, h)
            f = hand_drive - kh * x + self._hand_mass * v - self._response * middle
            work += float(f @ middle) * h
            v = 2.0 * middle - v
            x = x + h * middle
            low = np.minimum(low, x)
            high = np.maximum(high, x)
        self.position = tuple(x.tolist())
        self.velocity = tuple(v.tolist())
        self._low, self._high = tuple(low.tolist()), tuple(high.tolist())
        self.hand_force = tuple(f.tolist())
        return work

    def _saturate(self, middle: Array, push: Array, e: Array, pull: Array, h: float) -> Array:
        """The substep's vhat with the saturated spring: c of the discrete gradient by fixed point, 1 unsaturated.

        The change of force with c is at most K h/2 against 2M/h: the iteration contracts by about K h^2 / 4M, to
        rounding in a few rounds. At the fixed point the spring's work is exactly the change of its potential.
        """
        K = self._K
        start = math.sqrt(max(0.0, float(e @ pull)))
        c = 1.0
        for _ in range(50):
            e1 = e + h * middle
            end = math.sqrt(max(0.0, float(e1 @ K @ e1)))
            before, c = c, _discrete_gradient(start, end, self._knee)
            if abs(c - before) <= 1e-15:
                break
            A = self._bare + (c * h / 2.0) * K
            middle = np.asarray(np.linalg.solve(A, push - c * pull), dtype=np.float64)
        return middle

    def _prepare(self) -> None:
        """All that depends on the coupling but not on the state."""
        h, hand = self._h, self._hand
        if self._set_position is not None:
            self._torque = (0.0,) * self.dof
        own = 2.0 * (self.mass + hand.mass) / h + self.damping + hand.damping + hand.stiffness * h / 2.0
        self._inertia = 2.0 * (self.mass + hand.mass) / h
        self._hand_mass = 2.0 * hand.mass / h
        self._response = hand.stiffness * h / 2.0 + hand.damping + self._hand_mass
        self._knee_square = self._knee * self._knee
        self._bare = own * np.eye(self.dof) + self._coupling_damping
        self._inverse = np.linalg.inv(self._bare + self._K * (h / 2.0))
        self._decoupled: tuple[tuple[float, tuple[float, ...]], ...] = ()
        """(k, constants of `_advance_axis`) of each axis, if they are independent."""
        if np.array_equal(self._K, np.diag(np.diagonal(self._K))):
            kh, mass, response = hand.stiffness, self._hand_mass, self._response
            self._decoupled = tuple(
                (k, (k + kh, self._inertia, 1.0 / (own + b + k * h / 2.0), kh, mass, response, h))
                for k, b in zip(
                    np.diagonal(self._K).tolist(), np.diagonal(self._coupling_damping).tolist(), strict=True
                )
            )

    def _count(self) -> Vector:
        r = self.resolution
        if r == 0.0:
            return self.position
        return tuple([r * round(x / r) for x in self.position])


def _advance_axis(
    x: float,
    v: float,
    drive: float,
    hand_drive: float,
    hand_step: float,
    low: float,
    high: float,
    constants: tuple[float, ...],
    substeps: range,
) -> tuple[float, float, float, float, float, float]:
    """The substeps of one axis that is independent of the others: (sum of f vhat, x, v, low, high, f).

    `drive` is what the coupling pushes with at x = 0; `hand_drive` likewise the hand, growing by `hand_step` a substep.
    """
    stiffness, inertia, inverse, hand_stiffness, hand_mass, response, h = constants
    work = f = 0.0
    for _ in substeps:
        hand_drive += hand_step
        middle = (inertia * v + drive + hand_drive - stiffness * x) * inverse
        f = hand_drive - hand_stiffness * x + hand_mass * v - response * middle
        work += f * middle
        v = middle + middle - v
        x += h * middle
        if x < low:
            low = x
        elif x > high:
            high = x
    return work, x, v, low, high, f


def _discrete_gradient(start: float, end: float, knee: float) -> float:
    """c with ``h(end) - h(start) = c (end^2 - start^2) / 2`` for the potential h of a spring saturated at the knee."""
    if start <= knee and end <= knee:
        return 1.0
    if start >= knee and end >= knee:
        return 2.0 * knee / (start + end)
    inner, outer = min(start, end), max(start, end)
    return (2.0 * knee * outer - knee * knee - inner * inner) / ((outer - inner) * (outer + inner))
