"""Simulated haptic devices (1), held by a simulated hand, integrated by the midpoint rule.

    M x'' = tau + f - b x',    f = K_h (x_d - x) + B_h (x_d' - x') - M_h x''

A tick is cut into substeps. With ``vhat = (v1 + v0)/2`` and every force taken at the midpoint, a substep obeys

    f . vhat h = change of (kinetic + potential) + |vhat|_B^2 h + |vhat|_b^2 h

exactly, so the account of the human's port has no error of integration. It stays exact where the spring saturates or
the actuators are at their limit: see `limited_coupling`.
"""

from __future__ import annotations

import math
from itertools import chain, pairwise
from operator import add, mul, sub
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hapnet import checks
from hapnet.checks import Array, Vector
from hapnet.errors import InvalidParameter
from hapnet.plant.limited_coupling import LimitedCoupling, rows
from hapnet.plant.operator import Operator

TickResult = tuple[float, Vector, Vector, Vector, Vector]
"""A tick: the hand's work [J]; the device's position [m] and velocity [m/s] at its end; the hand's force and the
actuators' on the device, mean over its last substep [N]."""


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

    def apply(self, force: Vector) -> Vector | None:
        """Hold this force [N] until the next call; the force that is really applied, None where that is not known.

        What is returned is what the energy account counts: the actuators' own limits, a reversed motor, a measured
        current. A driver that can tell should.
        """


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
        self._half_mass = 0.5 * self.mass
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
        self.references = [operator.reference(0.0)]
        """Where the hand wanted to be [m] at the end of each tick of the last `run`."""
        self.position: Vector = self.references[-1]
        self.velocity: Vector = (0.0,) * len(self.position)
        self.hand_force: Vector = self.velocity
        """The hand's force on the device, mean over the last substep [N]."""
        self.actuator_force: Vector = self.velocity
        """The actuators' force on the device, mean over the last substep [N]."""
        self._low = self._high = self.position
        self._dissipated = 0.0
        """By the coupling's damper since the extremes were last asked for [J]."""
        self._limited = False
        """Was that damper limited since then?"""
        self._read = self._count()
        self._read_time = 0.0
        self._torque: Vector = self.velocity
        self._set_position: Vector | None = None
        self._knee = math.inf
        self._largest = 0.0
        self._at_limit = False
        """Was the spring saturated or the damper limited at the end of the last tick? Which way to compute the next
        one, no more."""
        self._K = np.zeros((self.dof, self.dof))
        self._coupling_damping: Vector = self.velocity
        self._prepare()

    @property
    def dof(self) -> int:
        return len(self.position)

    @property
    def kinetic(self) -> float:
        """Of the device's own mass [J]."""
        return self.kinetic_at(self.velocity)

    def kinetic_at(self, velocity: Vector) -> float:
        """What `kinetic` is at this velocity [m/s]."""
        if len(velocity) == 1:
            return self._half_mass * (velocity[0] * velocity[0])
        square = 0.0
        for v in velocity:
            square += v * v
        return self._half_mass * square

    def read(self) -> tuple[Vector, Vector]:
        """Position and velocity; with encoders, whole counts and their backward difference since the last read."""
        if self.resolution == 0.0:
            return self.position, self.velocity
        before, self._read = self._read, self._count()
        span, self._read_time = self.time - self._read_time, self.time
        if span == 0.0:
            return self._read, (0.0,) * self.dof
        return self._read, tuple([(b - a) / span for a, b in zip(before, self._read, strict=True)])

    def apply(self, force: Vector) -> Vector:
        """Hold a force [N], cut to the actuators' limit; that one."""
        length = math.hypot(*force)
        if self.force_limit is not None and length > self.force_limit:
            force = tuple([component * self.force_limit / length for component in force])
        self._torque = force
        return force

    def couple(
        self, stiffness: ArrayLike, damping: ArrayLike, set_position: Vector, spring_limit: float | None = None
    ) -> None:
        """Let the coupling (2) act within the ticks from now on, in place of a held force.

        Spring and damper together keep to the device's own limit of the force; the damper gives way.

        Parameters
        ----------
        stiffness : K [N/m]. damping : B [Ns/m], diagonal. set_position : ybar [m].
        spring_limit : the spring saturates here [N], through its potential; None: never.

        Raises
        ------
        InvalidParameter : a value is not allowed, such as a spring that alone exceeds the device's limit.
        """
        if self.force_limit is not None and not 0.0 < (spring_limit or 0.0) <= self.force_limit:
            raise InvalidParameter("spring_limit", spring_limit, f"at most the device's own, {self.force_limit:g} N")
        self._K = checks.spd("stiffness", stiffness, self.dof)
        self._coupling_damping = checks.diagonal("damping", damping, self.dof, zero_allowed=True)
        self._largest = float(np.linalg.eigvalsh(self._K)[-1])
        self._knee = math.inf if spring_limit is None else spring_limit / math.sqrt(self._largest)
        self._set_position = set_position
        self._prepare()

    def move_set_position(self, set_position: Vector) -> None:
        """A new ybar [m] for the coupling that is in force."""
        self._set_position = set_position

    def passage(self) -> tuple[Vector, Vector, float | None]:
        """Smallest and largest position of each axis [m] since the last call, both ends included.

        And what the coupling's damper dissipated since then [J], if it was limited; None if it acted in full.
        """
        result = self._low, self._high, self._dissipated if self._limited else None
        self._low = self._high = self.position
        self._dissipated, self._limited = 0.0, False
        return result

    def advance(self) -> float:
        """One tick of the servo's period; the work done by the hand on the device [J]."""
        return self.run(1)[0][0]

    def run(self, ticks: int) -> list[TickResult]:
        """As many ticks, with nothing from outside in between; the device after each of them."""
        passed, period, follow = self._ticks, self.period, self._follow
        self._ticks = passed + ticks
        self.time = self._ticks * period
        start, path = self.references[-1], [follow(k * period) for k in range(passed + 1, passed + ticks + 1)]
        self.references = path
        if self._decoupled and not self._at_limit:
            lived = self._run_axes(start, path)
            if lived is not None:
                return lived
        return [self._tick(begin, end) for begin, end in pairwise([start, *path])]

    def _tick(self, begin: Vector, end: Vector) -> TickResult:
        """One tick, while the hand's reference goes from `begin` to `end`."""
        work = None
        if not self._at_limit:
            if self._decoupled:
                lived = self._run_axes(begin, [end])
                if lived is not None:
                    return lived[0]
            else:
                work = self._advance_linear(begin, end)
        if work is None:
            work = self._advance_limited(begin, end)
        return work, self.position, self.velocity, self.hand_force, self.actuator_force

    # -- axis by axis: K diagonal and within all limits --------------------------------------------------------------

    def _run_axes(self, start: Vector, path: list[Vector]) -> list[TickResult] | None:
        """The ticks at whose ends the reference is at the points of `path`, each axis on its own.

        None, and nothing changed, if the spring may have saturated or the damper been limited.
        """
        h, period, substeps, kh, rate_drive, rate_step, inertia, hand_mass, response = self._coefficients
        ybar = self._set_position or self.position
        stretch = drag = 0.0
        dissipated = self._dissipated
        lows, highs = [], []
        axes: list[list[TickResult]] = []
        for axis, (k, pull, inverse, b, middle_gain) in enumerate(self._decoupled):
            x, v, low, high, y = self.position[axis], self.velocity[axis], self._low[axis], self._high[axis], ybar[axis]
            torque = self._torque[axis]
            drive, loss, most = k * y + torque, b * h, 0.0
            begin = start[axis]
            ticks: list[TickResult] = []
            for reference in path:
                end = reference[axis]
                rate = (end - begin) / period
                hand = kh * begin + rate_drive * rate
                hand_step = rate_step * rate
                begin = end
                work = f = middle = squares = 0.0
                for _ in substeps:
                    hand += hand_step
                    middle = (inertia * v + drive + hand - pull * x) * inverse
                    f = hand - kh * x + hand_mass * v - response * middle
                    work += f * middle
                    squares += middle * middle
                    v = middle + middle - v
                    x += h * middle
                    if x < low:
                        low = x
                    elif x > high:
                        high = x
                if squares > most:
                    most = squares
                dissipated += loss * squares
                ticks.append((work * h, (x,), (v,), (f,), (k * (y - x) + middle_gain * middle + torque,)))
            drag += b * b * most
            farthest = high - y if high - y > y - low else y - low
            stretch += k * farthest * farthest
            axes.append(ticks)
            lows.append(low)
            highs.append(high)
        if stretch > self._knee_square or self._may_exceed(stretch, math.sqrt(drag)):
            return None
        lived = axes[0] if len(axes) == 1 else list(map(_joined, *axes))
        _, self.position, self.velocity, self.hand_force, self.actuator_force = lived[-1]
        self._low, self._high, self._dissipated = tuple(lows), tuple(highs), dissipated
        return lived

    def _may_exceed(self, stretch: float, drag: float) -> bool:
        """May the force exceed its limit, with ``|e|_K^2`` up to `stretch` [J] and the damper's force to `drag` [N]?"""
        return math.sqrt(self._largest * stretch) + drag > self._longest_force

    # -- any K, within all limits ------------------------------------------------------------------------------------

    def _advance_linear(self, begin: Vector, end: Vector) -> float | None:
        """The whole tick as one linear map: its work; None, and nothing changed, if a limit may have acted."""
        n, ybar = self.dof, self._set_position or self.position
        # BLAS on the whole tick costs a quarter of the same substeps on floats
        values = self._tick_map.dot(self.position + self.velocity + ybar + self._torque + begin + end).tolist()
        span = n * len(self._substeps)
        velocity, hand_force, path = values[:span], values[span : 2 * span], values[2 * span : 3 * span]
        drag = values[3 * span : 4 * span]
        low, high = [], []
        stretch = 0.0
        for axis, (least, most, y) in enumerate(zip(self._low, self._high, ybar, strict=True)):
            passed = path[axis::n]
            low.append(min(least, *passed))
            high.append(max(most, *passed))
            stretch += max(high[axis] - y, y - low[axis]) ** 2
        stretch *= self._largest
        if stretch > self._knee_square or self._may_exceed(stretch, math.hypot(*drag)):
            return None
        self.position, self.velocity = tuple(path[-n:]), tuple(values[4 * span : 4 * span + n])
        self._low, self._high, self.hand_force = tuple(low), tuple(high), tuple(hand_force[-n:])
        self.actuator_force = tuple(values[4 * span + n :])
        self._dissipated += sum(map(mul, drag, velocity)) * self._h
        work: float = sum(map(mul, hand_force, velocity))
        return work * self._h

    # -- any K, whatever limit acts ----------------------------------------------------------------------------------

    def _advance_limited(self, begin: Vector, end: Vector) -> float:
        """One tick, substep by substep; its work."""
        h, kh, bh = self._h, self._hand.stiffness, self._hand.damping
        inertia, hand_mass, response = self._inertia, self._hand_mass, self._response
        coupling, torque = self._coupling, self._torque
        x, v, low, high = self.position, self.velocity, self._low, self._high
        e: Vector = tuple(map(sub, x, self._set_position or x))
        pull: Vector = tuple([sum(map(mul, row, e)) for row in coupling.rows])
        rate = [(b - a) / self.period for a, b in zip(begin, end, strict=True)]
        hand = [kh * a + (bh - 0.5 * kh * h) * r for a, r in zip(begin, rate, strict=True)]
        hand_step = [kh * h * r for r in rate]
        work = dissipated = 0.0
        limited = False
        f = force = v
        for _ in self._substeps:
            hand = list(map(add, hand, hand_step))
            push = tuple([t + d + inertia * u - kh * p for t, d, u, p in zip(torque, hand, v, x, strict=True)])
            (middle, e, pull, force, drain), limited = coupling.substep(push, e, pull)
            self._limited |= limited
            dissipated += drain
            f = tuple(
                [d - kh * p + hand_mass * u - response * m for d, p, u, m in zip(hand, x, v, middle, strict=True)]
            )
            work += sum(map(mul, f, middle))
            v = tuple([m + m - u for m, u in zip(middle, v, strict=True)])
            x = tuple([p + h * m for p, m in zip(x, middle, strict=True)])
            low = tuple(map(min, low, x))
            high = tuple(map(max, high, x))
        self._at_limit = limited or sum(map(mul, e, pull)) > self._knee_square
        self.position, self.velocity, self._low, self._high, self.hand_force = x, v, low, high, f
        self.actuator_force = tuple(map(add, force, torque))
        self._dissipated += dissipated * h
        return work * h

    def _prepare(self) -> None:
        """All that depends on the coupling but not on the state."""
        h, hand = self._h, self._hand
        if self._set_position is not None:
            self._torque = (0.0,) * self.dof
        own = 2.0 * (self.mass + hand.mass) / h + self.damping + hand.damping + hand.stiffness * h / 2.0
        self._inertia = 2.0 * (self.mass + hand.mass) / h
        self._hand_mass = 2.0 * hand.mass / h
        self._response = hand.stiffness * h / 2.0 + hand.damping + self._hand_mass
        self._rate_drive = hand.damping - 0.5 * hand.stiffness * h
        self._rate_step = hand.stiffness * h
        self._knee_square = self._knee * self._knee
        self._longest_force = math.inf if self.force_limit is None else self.force_limit
        self._coefficients = (
            h, self.period, self._substeps, hand.stiffness, self._rate_drive, self._rate_step,
            self._inertia, self._hand_mass, self._response,
        )  # fmt: skip
        B = np.array(self._coupling_damping)
        self._coupling = LimitedCoupling(self._K, self._coupling_damping, own, h, self._knee, self._longest_force)
        self._decoupled: tuple[Vector, ...] = ()
        """(k, k + K_h, 1/A, B, k h/2 - B) of each axis, if they are independent."""
        if np.array_equal(self._K, np.diag(np.diagonal(self._K))):
            k = np.diagonal(self._K)
            a = own + B + k * h / 2.0
            self._decoupled = rows(np.array([k, k + hand.stiffness, 1.0 / a, B, k * h / 2.0 - B]).T)
        else:
            self._tick_map = self._map_of_a_tick(np.linalg.inv(np.diag(own + B) + self._K * (h / 2.0)))

    def _map_of_a_tick(self, inverse: NDArray[np.floating[Any]]) -> Array:
        """What a tick within all limits does, as a matrix; `inverse` is A^-1.

        It takes position, velocity, ybar, torque and the hand's reference at the tick's start and end to vhat, the
        hand's force, the position and the damper's force ``B vhat`` at each substep, then the velocity at the end and
        the actuators' force in the last substep.
        """
        h, kh = self._h, self._hand.stiffness
        B = np.diag(self._coupling_damping)
        x, v, ybar, torque, begin, end = np.vsplit(np.eye(6 * self.dof), 6)
        rate = (end - begin) / self.period
        hand = kh * begin + self._rate_drive * rate
        velocities, forces, path = [], [], []
        for _ in self._substeps:
            hand = hand + self._rate_step * rate
            middle = inverse @ (self._inertia * v + torque + hand + self._K @ (ybar - x) - kh * x)
            forces.append(hand - kh * x + self._hand_mass * v - self._response * middle)
            v = 2.0 * middle - v
            x = x + h * middle
            velocities.append(middle)
            path.append(x)
        drags = [B @ middle for middle in velocities]
        actuators = torque + self._K @ (ybar - x + h / 2.0 * velocities[-1]) - drags[-1]
        return np.vstack([*velocities, *forces, *path, *drags, v, actuators])

    def _count(self) -> Vector:
        r = self.resolution
        if r == 0.0:
            return self.position
        return tuple([r * round(x / r) for x in self.position])


def _joined(*axes: TickResult) -> TickResult:
    """One tick of all axes, from that of each."""
    works, x, v, f, actuators = zip(*axes, strict=True)
    return sum(works), tuple(chain(*x)), tuple(chain(*v)), tuple(chain(*f)), tuple(chain(*actuators))
