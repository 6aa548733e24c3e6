"""One tick of a simulated device, in substeps by the midpoint rule, computed in the cheapest exact way.

See `hapnet.plant.device` for the equations. Within all limits, a diagonal K lets each axis be computed alone, and any
other K makes the tick one linear map. Where a limit acts, the tick is computed by substeps (`limited_coupling`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import chain, pairwise
from operator import add, mul, sub
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array, Vector
from hapnet.plant.limited_coupling import LimitedCoupling, rows
from hapnet.plant.operator import Impedance

TickResult = tuple[float, Vector, Vector, Vector, Vector]
"""The result of a tick: the hand's work [J]; the device's position [m] and velocity [m/s] at its end; the forces of
hand and actuators on the device, mean over its last substep [N]."""


@dataclass(slots=True)
class DeviceState:
    """The state that changes from tick to tick; vectors are (n,) tuples.

    position [m], velocity [m/s]. hand_force, actuator_force : on the device, mean over the last substep [N].
    torque : the held force [N]. set_position : of the coupling [m]; None: no coupling.
    low, high : extremes of the position on each axis since the last `passage` [m]. dissipated : by the coupling's
    damper since then [J]. limited : was that damper limited since then?
    at_limit : was the spring saturated or the damper limited at the end of the last tick? It only decides how the next
    tick is computed.
    """

    position: Vector
    velocity: Vector
    hand_force: Vector
    actuator_force: Vector
    torque: Vector
    low: Vector
    high: Vector
    set_position: Vector | None = None
    dissipated: float = 0.0
    limited: bool = False
    at_limit: bool = False


class TickModel:
    """What a tick depends on besides the state: device, hand and coupling.

    Parameters
    ----------
    dof : n. mass [kg], own_damping [Ns/m] : of the device, on each axis. hand : the hand that holds it.
    period : length of a tick [s]. substeps : their number in a tick.
    stiffness : K [N/m] (n, n), damping : B's diagonal [Ns/m], of the coupling.
    knee : the ``|e|_K`` [sqrt J] at which its spring saturates. force_limit : of spring and damper together [N].
    """

    def __init__(
        self,
        dof: int,
        mass: float,
        own_damping: float,
        hand: Impedance,
        period: float,
        substeps: int,
        stiffness: Array,
        damping: Vector,
        knee: float = math.inf,
        force_limit: float = math.inf,
    ) -> None:
        self.dof: int = dof
        self.period: float = period
        self.substeps: range = range(substeps)
        self.h: float = period / substeps
        h = self.h
        self.hand = hand
        self.stiffness: Array = stiffness
        self.damping: Vector = damping
        self.largest: float = float(np.linalg.eigvalsh(stiffness)[-1])
        self.knee: float = knee
        self.force_limit: float = force_limit
        own = 2.0 * (mass + hand.mass) / h + own_damping + hand.damping + hand.stiffness * h / 2.0
        self.inertia: float = 2.0 * (mass + hand.mass) / h
        self.hand_mass: float = 2.0 * hand.mass / h
        self.response: float = hand.stiffness * h / 2.0 + hand.damping + self.hand_mass
        self.rate_drive: float = hand.damping - 0.5 * hand.stiffness * h
        self.rate_step: float = hand.stiffness * h
        self.knee_square: float = knee * knee
        self._coefficients = (  # unpacked at once: one axis's tick takes only two microseconds
            h, period, self.substeps, hand.stiffness, self.rate_drive, self.rate_step,
            self.inertia, self.hand_mass, self.response, 1.0 / own,
        )  # fmt: skip
        B = np.array(damping)
        self.coupling: LimitedCoupling = LimitedCoupling(stiffness, damping, own, h, knee, force_limit)
        self.decoupled: tuple[Vector, ...] = ()
        """(k, k + K_h, 1/A, B, k h/2 - B) of each axis, if the axes are independent; else empty."""
        if np.array_equal(stiffness, np.diag(np.diagonal(stiffness))):
            k = np.diagonal(stiffness)
            a = own + B + k * h / 2.0
            self.decoupled = rows(np.array([k, k + hand.stiffness, 1.0 / a, B, k * h / 2.0 - B]).T)
        else:
            self.tick_map: Array = self._map_of_a_tick(np.linalg.inv(np.diag(own + B) + stiffness * (h / 2.0)))

    def run(self, state: DeviceState, path: list[Vector]) -> list[TickResult]:
        """Run a tick from each point of the hand's reference on `path` [m] to the next. Returns each tick's result."""
        if self.decoupled and not state.at_limit:
            results = self._axes(state, path[0], path[1:])
            if results is not None:
                return results
        return [self._tick(state, begin, end) for begin, end in pairwise(path)]

    def held(self, state: DeviceState, begin: Vector, end: Vector) -> float:
        """One tick without a coupling, so that only the held torque acts, and no limit. Returns the hand's work [J].

        The same numbers as `run` gives, but neither extremes nor the damper's dissipation are kept.
        """
        h, period, substeps, kh, rate_drive, rate_step, inertia, hand_mass, response, mobility = self._coefficients
        total = 0.0
        positions, velocities, forces = [], [], []
        for x, v, torque, a, b in zip(state.position, state.velocity, state.torque, begin, end, strict=True):
            rate = (b - a) / period
            hand = kh * a + rate_drive * rate
            hand_step = rate_step * rate
            work = f = 0.0
            for _ in substeps:
                hand += hand_step
                pull = kh * x
                middle = (inertia * v + torque + hand - pull) * mobility
                f = hand - pull + hand_mass * v - response * middle
                work += f * middle
                v = middle + middle - v
                x += h * middle
            total += work * h
            positions.append(x)
            velocities.append(v)
            forces.append(f)
        state.position, state.velocity, state.hand_force = tuple(positions), tuple(velocities), tuple(forces)
        state.actuator_force = state.torque
        return total

    def _tick(self, state: DeviceState, begin: Vector, end: Vector) -> TickResult:
        """One tick, while the hand's reference goes from `begin` to `end`."""
        work = None
        if not state.at_limit:
            if self.decoupled:
                results = self._axes(state, begin, [end])
                if results is not None:
                    return results[0]
            else:
                work = self._linear(state, begin, end)
        if work is None:
            work = self.limited(state, begin, end)
        return work, state.position, state.velocity, state.hand_force, state.actuator_force

    # -- axis by axis: K diagonal and within all limits --------------------------------------------------------------

    def _axes(self, state: DeviceState, start: Vector, path: list[Vector]) -> list[TickResult] | None:
        """Compute each axis alone, one tick per point of `path`, where the hand's reference is at the tick's end.

        Returns None and changes nothing if the spring may have saturated or the damper may have been limited.
        """
        h, period, substeps, kh, rate_drive, rate_step, inertia, hand_mass, response, _ = self._coefficients
        ybar = state.set_position or state.position
        stretch = drag = 0.0
        dissipated = state.dissipated
        lows, highs = [], []
        axes: list[list[TickResult]] = []
        for axis, (k, pull, inverse, b, middle_gain) in enumerate(self.decoupled):
            x, v, low, high, y = (
                state.position[axis],
                state.velocity[axis],
                state.low[axis],
                state.high[axis],
                ybar[axis],
            )
            torque = state.torque[axis]
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
        if stretch > self.knee_square or self._may_exceed(stretch, math.sqrt(drag)):
            return None
        results = axes[0] if len(axes) == 1 else list(map(_joined, *axes))
        _, state.position, state.velocity, state.hand_force, state.actuator_force = results[-1]
        state.low, state.high, state.dissipated = tuple(lows), tuple(highs), dissipated
        return results

    def _may_exceed(self, stretch: float, drag: float) -> bool:
        """May the force exceed its limit, with ``|e|_K^2`` up to `stretch` [J] and a damper force up to `drag` [N]?"""
        return math.sqrt(self.largest * stretch) + drag > self.force_limit

    # -- any K, within all limits ------------------------------------------------------------------------------------

    def _linear(self, state: DeviceState, begin: Vector, end: Vector) -> float | None:
        """Compute the whole tick as one linear map. Returns its work [J].

        Returns None and changes nothing if a limit may have acted.
        """
        n, ybar = self.dof, state.set_position or state.position
        # BLAS on the whole tick costs a quarter of the substeps in floats
        values = self.tick_map.dot(state.position + state.velocity + ybar + state.torque + begin + end).tolist()
        span = n * len(self.substeps)
        velocity, hand_force, path = values[:span], values[span : 2 * span], values[2 * span : 3 * span]
        drag = values[3 * span : 4 * span]
        low, high = [], []
        stretch = 0.0
        for axis, (least, most, y) in enumerate(zip(state.low, state.high, ybar, strict=True)):
            passed = path[axis::n]
            low.append(min(least, *passed))
            high.append(max(most, *passed))
            stretch += max(high[axis] - y, y - low[axis]) ** 2
        stretch *= self.largest
        if stretch > self.knee_square or self._may_exceed(stretch, math.hypot(*drag)):
            return None
        state.position, state.velocity = tuple(path[-n:]), tuple(values[4 * span : 4 * span + n])
        state.low, state.high, state.hand_force = tuple(low), tuple(high), tuple(hand_force[-n:])
        state.actuator_force = tuple(values[4 * span + n :])
        state.dissipated += sum(map(mul, drag, velocity)) * self.h
        work: float = sum(map(mul, hand_force, velocity))
        return work * self.h

    # -- any K, whatever limit acts ----------------------------------------------------------------------------------

    def limited(self, state: DeviceState, begin: Vector, end: Vector) -> float:
        """Compute one tick substep by substep. Returns its work [J]."""
        h, kh, bh = self.h, self.hand.stiffness, self.hand.damping
        inertia, hand_mass, response = self.inertia, self.hand_mass, self.response
        coupling, torque = self.coupling, state.torque
        x, v, low, high = state.position, state.velocity, state.low, state.high
        e: Vector = tuple(map(sub, x, state.set_position or x))
        pull: Vector = tuple([sum(map(mul, row, e)) for row in coupling.rows])
        rate = [(b - a) / self.period for a, b in zip(begin, end, strict=True)]
        hand = [kh * a + (bh - 0.5 * kh * h) * r for a, r in zip(begin, rate, strict=True)]
        hand_step = [kh * h * r for r in rate]
        work = dissipated = 0.0
        limited = False
        f = force = v
        for _ in self.substeps:
            hand = list(map(add, hand, hand_step))
            push = tuple([t + d + inertia * u - kh * p for t, d, u, p in zip(torque, hand, v, x, strict=True)])
            (middle, e, pull, force, drain), limited = coupling.substep(push, e, pull)
            state.limited |= limited
            dissipated += drain
            f = tuple(
                [d - kh * p + hand_mass * u - response * m for d, p, u, m in zip(hand, x, v, middle, strict=True)]
            )
            work += sum(map(mul, f, middle))
            v = tuple([m + m - u for m, u in zip(middle, v, strict=True)])
            x = tuple([p + h * m for p, m in zip(x, middle, strict=True)])
            low = tuple(map(min, low, x))
            high = tuple(map(max, high, x))
        state.at_limit = limited or sum(map(mul, e, pull)) > self.knee_square
        state.position, state.velocity, state.low, state.high, state.hand_force = x, v, low, high, f
        state.actuator_force = tuple(map(add, force, torque))
        state.dissipated += dissipated * h
        return work * h

    def _map_of_a_tick(self, inverse: NDArray[np.floating[Any]]) -> Array:
        """The matrix of a tick within all limits; `inverse` is A^-1.

        Its input is position, velocity, ybar, torque and the hand's reference at the tick's start and end. Its output
        is vhat, the hand's force, the position and the damper's force ``B vhat`` of every substep, then the velocity at
        the tick's end and the actuators' force in the last substep.
        """
        h, kh = self.h, self.hand.stiffness
        B = np.diag(self.damping)
        x, v, ybar, torque, begin, end = np.vsplit(np.eye(6 * self.dof), 6)
        rate = (end - begin) / self.period
        hand = kh * begin + self.rate_drive * rate
        velocities, forces, path = [], [], []
        for _ in self.substeps:
            hand = hand + self.rate_step * rate
            middle = inverse @ (self.inertia * v + torque + hand + self.stiffness @ (ybar - x) - kh * x)
            forces.append(hand - kh * x + self.hand_mass * v - self.response * middle)
            v = 2.0 * middle - v
            x = x + h * middle
            velocities.append(middle)
            path.append(x)
        drags = [B @ middle for middle in velocities]
        actuators = torque + self.stiffness @ (ybar - x + h / 2.0 * velocities[-1]) - drags[-1]
        return np.vstack([*velocities, *forces, *path, *drags, v, actuators])


def _joined(*axes: TickResult) -> TickResult:
    """The result of all axes, from the results of each."""
    works, x, v, f, actuators = zip(*axes, strict=True)
    return sum(works), tuple(chain(*x)), tuple(chain(*v)), tuple(chain(*f)), tuple(chain(*actuators))
