"""Simulated haptic devices (1), held by a simulated hand, integrated by the midpoint rule.

    M x'' = tau + f - b x',    f = K_h (x_d - x) + B_h (x_d' - x') - M_h x''

A tick is cut into substeps. With ``vhat = (v1 + v0)/2`` and every force taken at the midpoint, a substep obeys

    f . vhat h = change of (kinetic + potential) + |vhat|_B^2 h + |vhat|_b^2 h

exactly, so the account of the human's port has no error of integration. Where the spring saturates, the midpoint spring
is replaced by the discrete gradient of its potential, ``-c K e_mid``, with the same effect.
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
from hapnet.plant.operator import Operator

Lived = tuple[float, Vector, Vector, Vector]
"""A tick: the hand's work [J]; the device's position [m] and velocity [m/s], and the hand's force [N], at its end."""


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
        self._low = self._high = self.position
        self._read = self._count()
        self._read_time = 0.0
        self._torque: Vector = self.velocity
        self._set_position: Vector | None = None
        self._knee = math.inf
        self._largest = 0.0
        self._saturated = False
        """Was the spring beyond its knee at the end of the last tick? Which way to compute the next one, no more."""
        self._K = self._coupling_damping = np.zeros((self.dof, self.dof))
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
        self._largest = float(np.linalg.eigvalsh(self._K)[-1])
        self._knee = math.inf if force_limit is None else force_limit / math.sqrt(self._largest)
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
        return self.run(1)[0][0]

    def run(self, ticks: int) -> list[Lived]:
        """As many ticks, with nothing from outside in between; the device after each of them."""
        passed, period, follow = self._ticks, self.period, self._follow
        self._ticks = passed + ticks
        self.time = self._ticks * period
        start, path = self.references[-1], [follow(k * period) for k in range(passed + 1, passed + ticks + 1)]
        self.references = path
        if self._decoupled and not self._saturated:
            lived = self._run_axes(start, path)
            if lived is not None:
                return lived
        return [self._tick(begin, end) for begin, end in pairwise([start, *path])]

    def _tick(self, begin: Vector, end: Vector) -> Lived:
        """One tick, while the hand's reference goes from `begin` to `end`."""
        work = None
        if not self._saturated:
            if self._decoupled:
                lived = self._run_axes(begin, [end])
                if lived is not None:
                    return lived[0]
            else:
                work = self._advance_linear(begin, end)
        if work is None:
            work = self._advance_saturated(begin, end)
        return work, self.position, self.velocity, self.hand_force

    # -- axis by axis: K diagonal and not saturated ------------------------------------------------------------------

    def _run_axes(self, start: Vector, path: list[Vector]) -> list[Lived] | None:
        """The ticks at whose ends the reference is at the points of `path`, each axis on its own.

        None, and nothing changed, if the spring may have saturated.
        """
        h, period, substeps, kh, rate_drive, rate_step, inertia, hand_mass, response = self._coefficients
        ybar = self._set_position or self.position
        stretch = 0.0
        lows, highs = [], []
        axes: list[list[Lived]] = []
        for axis, (k, pull, inverse) in enumerate(self._decoupled):
            x, v, low, high, y = self.position[axis], self.velocity[axis], self._low[axis], self._high[axis], ybar[axis]
            drive = k * y + self._torque[axis]
            begin = start[axis]
            ticks: list[Lived] = []
            for reference in path:
                end = reference[axis]
                rate = (end - begin) / period
                hand = kh * begin + rate_drive * rate
                hand_step = rate_step * rate
                begin = end
                work = f = 0.0
                for _ in substeps:
                    hand += hand_step
                    middle = (inertia * v + drive + hand - pull * x) * inverse
                    f = hand - kh * x + hand_mass * v - response * middle
                    work += f * middle
                    v = middle + middle - v
                    x += h * middle
                    if x < low:
                        low = x
                    elif x > high:
                        high = x
                ticks.append((work * h, (x,), (v,), (f,)))
            farthest = high - y if high - y > y - low else y - low
            stretch += k * farthest * farthest
            axes.append(ticks)
            lows.append(low)
            highs.append(high)
        if stretch > self._knee_square:
            return None
        lived = axes[0] if len(axes) == 1 else list(map(_joined, *axes))
        _, self.position, self.velocity, self.hand_force = lived[-1]
        self._low, self._high = tuple(lows), tuple(highs)
        return lived

    # -- any K, not saturated ----------------------------------------------------------------------------------------

    def _advance_linear(self, begin: Vector, end: Vector) -> float | None:
        """The whole tick as one linear map: its work; None, and nothing changed, if the spring may have saturated."""
        n, ybar = self.dof, self._set_position or self.position
        # BLAS on the whole tick costs a quarter of the same substeps on floats
        values = self._tick_map.dot(self.position + self.velocity + ybar + self._torque + begin + end).tolist()
        span = n * len(self._substeps)
        velocity, hand_force, path = values[:span], values[span : 2 * span], values[2 * span : 3 * span]
        low, high = [], []
        stretch = 0.0
        for axis, (least, most, y) in enumerate(zip(self._low, self._high, ybar, strict=True)):
            passed = path[axis::n]
            low.append(min(least, *passed))
            high.append(max(most, *passed))
            stretch += max(high[axis] - y, y - low[axis]) ** 2
        if self._largest * stretch > self._knee_square:
            return None
        self.position, self.velocity = tuple(path[-n:]), tuple(values[3 * span :])
        self._low, self._high, self.hand_force = tuple(low), tuple(high), tuple(hand_force[-n:])
        work: float = sum(map(mul, hand_force, velocity))
        return work * self._h

    # -- any K, saturated or not -------------------------------------------------------------------------------------

    def _advance_saturated(self, begin: Vector, end: Vector) -> float:
        h, kh, bh = self._h, self._hand.stiffness, self._hand.damping
        inertia, hand_mass, response = self._inertia, self._hand_mass, self._response
        K, torque = self._K_rows, self._torque
        x, v, low, high = self.position, self.velocity, self._low, self._high
        e: Vector = tuple(map(sub, x, self._set_position or x))
        pull = [sum(map(mul, row, e)) for row in K]
        square: float = sum(map(mul, e, pull))
        rate = [(b - a) / self.period for a, b in zip(begin, end, strict=True)]
        hand = [kh * a + (bh - 0.5 * kh * h) * r for a, r in zip(begin, rate, strict=True)]
        hand_step = [kh * h * r for r in rate]
        work = 0.0
        f: Vector = v
        for _ in self._substeps:
            hand = list(map(add, hand, hand_step))
            push = [t + d + inertia * u - kh * p for t, d, u, p in zip(torque, hand, v, x, strict=True)]
            middle = self._saturate(push, pull, square)
            f = tuple(
                [d - kh * p + hand_mass * u - response * m for d, p, u, m in zip(hand, x, v, middle, strict=True)]
            )
            work += sum(map(mul, f, middle))
            v = tuple([m + m - u for m, u in zip(middle, v, strict=True)])
            x = tuple([p + h * m for p, m in zip(x, middle, strict=True)])
            e = tuple([a + h * m for a, m in zip(e, middle, strict=True)])
            pull = [sum(map(mul, row, e)) for row in K]
            square = sum(map(mul, e, pull))
            low = tuple(map(min, low, x))
            high = tuple(map(max, high, x))
        self._saturated = square > self._knee_square
        self.position, self.velocity, self._low, self._high, self.hand_force = x, v, low, high, f
        return work * h

    def _saturate(self, push: list[float], pull: list[float], square: float) -> list[float]:
        """The substep's vhat with the saturated spring: c of the discrete gradient by fixed point, 1 unsaturated.

        In the modes of K against the rest of A, ``w = (push - c pull)/(1 + c h/2 lambda)``, ``vhat = modes' w`` and
        ``|e1|_K^2 = |e|_K^2 + 2 h w . pull + h^2 sum lambda w^2``. The change of force with c is at most K h/2 against
        2M/h: the iteration contracts by about K h^2 / 4M, to rounding in a few rounds. At the fixed point the spring's
        work is exactly the change of its potential.
        """
        h, values, modes = self._h, self._mode_values, self._modes
        pushes = [sum(map(mul, mode, push)) for mode in modes]
        pulls = [sum(map(mul, mode, pull)) for mode in modes]
        start = math.sqrt(max(0.0, square))
        c = 1.0 if start <= self._knee else self._knee / start
        terms = list(zip(pushes, pulls, values, strict=True))
        for _ in range(50):
            gain = 0.0
            for a, b, k in terms:
                u = (a - c * b) / (1.0 + 0.5 * c * h * k)
                gain += u * (2.0 * b + h * k * u)
            before, c = c, _discrete_gradient(start, math.sqrt(max(0.0, square + h * gain)), self._knee)
            if abs(c - before) <= 1e-15:
                break
        w = [(a - c * b) / (1.0 + 0.5 * c * h * k) for a, b, k in terms]
        return [sum(map(mul, column, w)) for column in zip(*modes, strict=True)]

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
        self._coefficients = (
            h, self.period, self._substeps, hand.stiffness, self._rate_drive, self._rate_step,
            self._inertia, self._hand_mass, self._response,
        )  # fmt: skip
        bare = own + np.diagonal(self._coupling_damping)
        self._K_rows = _rows(self._K)
        # Modes of K x = lambda bare x, so that (bare + c h/2 K)^-1 = modes' diag(1 / (1 + c h/2 lambda)) modes.
        root = 1.0 / np.sqrt(bare)
        values, vectors = np.linalg.eigh(self._K * np.outer(root, root))
        self._mode_values: Vector = tuple(values.tolist())
        self._modes = _rows(vectors.T * root)
        self._decoupled: tuple[tuple[float, float, float], ...] = ()
        """(k, k + K_h, 1/A) of each axis, if they are independent."""
        if np.array_equal(self._K, np.diag(np.diagonal(self._K))):
            k = np.diagonal(self._K)
            a = own + np.diagonal(self._coupling_damping) + k * h / 2.0
            axes = zip(k.tolist(), (k + hand.stiffness).tolist(), (1.0 / a).tolist(), strict=True)
            self._decoupled = tuple(axes)
        else:
            self._tick_map = self._map_of_a_tick(np.linalg.inv(np.diag(bare) + self._K * (h / 2.0)))

    def _map_of_a_tick(self, inverse: NDArray[np.floating[Any]]) -> Array:
        """What an unsaturated tick does, as a matrix; `inverse` is A^-1.

        It takes position, velocity, ybar, torque and the hand's reference at the tick's start and end to vhat, the
        hand's force and the position at each substep, and the velocity at the end.
        """
        h, kh = self._h, self._hand.stiffness
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
        return np.vstack([*velocities, *forces, *path, v])

    def _count(self) -> Vector:
        r = self.resolution
        if r == 0.0:
            return self.position
        return tuple([r * round(x / r) for x in self.position])


def _joined(*axes: Lived) -> Lived:
    """One tick of all axes, from that of each."""
    works, x, v, f = zip(*axes, strict=True)
    return sum(works), tuple(chain(*x)), tuple(chain(*v)), tuple(chain(*f))


def _rows(matrix: ArrayLike) -> tuple[Vector, ...]:
    return tuple(tuple(row) for row in np.asarray(matrix).tolist())


def _discrete_gradient(start: float, end: float, knee: float) -> float:
    """c with ``h(end) - h(start) = c (end^2 - start^2) / 2`` for the potential h of a spring saturated at the knee."""
    if start <= knee and end <= knee:
        return 1.0
    if start >= knee and end >= knee:
        return 2.0 * knee / (start + end)
    inner, outer = min(start, end), max(start, end)
    return (2.0 * knee * outer - knee * knee - inner * inner) / ((outer - inner) * (outer + inner))
