"""One tick of a simulated device, in substeps by the midpoint rule, computed in the cheapest exact way.

See `hapnet.plant.device` for the equations. Within all limits, a diagonal K lets each axis be computed alone; any other
K couples them. Where a limit acts, the coupling is solved in each substep (`limited_coupling`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.plant import limited_coupling
from hapnet.plant.limited_coupling import LimitedCoupling
from hapnet.plant.operator import Impedance
from hapnet.records.record import AXES, FloatRows, Floats, MatrixOfAxes, OfAxes, Reals, Record, equation
from hapnet.records.vectors import added, dot, times

TickResult = tuple[float, Vector, Vector, Vector, Vector]
"""The result of a tick: the hand's work [J]; the device's position [m] and velocity [m/s] at its end; the forces of
hand and actuators on the device, mean over its last substep [N]."""


class DeviceState(Record):
    """The state of a device that rests at `position` [m], as it changes from tick to tick.

    position [m], velocity [m/s]. hand_force, actuator_force : on the device, mean over the last substep [N].
    torque : the force, under zero-order hold [N]. coupled : whether there is a coupling. set_position : the
    coupling's [m].
    low, high : extremes of the position on each axis since the last `passage` [m]. dissipated : by the coupling's
    damper since then, in parts [J]. limited : whether that damper was limited since then.
    at_limit : whether the spring was saturated or the damper limited at the end of the last tick. It only decides
        how the next tick is computed.
    """

    position: OfAxes
    velocity: OfAxes
    hand_force: OfAxes
    actuator_force: OfAxes
    torque: OfAxes
    coupled: int
    set_position: OfAxes
    low: OfAxes
    high: OfAxes
    dissipated: OfAxes
    limited: int
    at_limit: int

    def __init__(self, position: Vector) -> None:
        n = len(position)
        self.position, self.low, self.high, self.set_position = (list(position) for _ in range(4))
        self.velocity, self.hand_force, self.actuator_force = ([0.0] * n for _ in range(3))
        self.torque, self.dissipated = [0.0] * n, [0.0] * n
        self.coupled = self.limited = self.at_limit = 0


class TickModel(Record):
    """The constants of a tick: device, hand and coupling.

    dof : n. mass [kg], own_damping [Ns/m] : of the device, on each axis. hand : the hand that holds it.
    period : length of a tick [s]. substeps : their number in a tick.
    stiffness : K [N/m] (n, n), damping : B's diagonal [Ns/m], of the coupling.
    knee : the ``|e|_K`` [sqrt J] at which its spring saturates. force_limit : of spring and damper together [N].

    Attributes
    ----------
    decoupled : whether the axes are independent. k, pull, inverse, b, middle_gain : if so, of each axis k, k + K_h,
        1/A, B and k h/2 - B. inverse_of_all : if not, A^-1.
    tried_... : the result of a tick if no limit acts. results : of one tick, as in `along_axes`. work : of a tick
        without an active limit.
    pushing, change, driving, middle : work arrays of a substep.
    """

    n: int
    substeps: int
    period: float
    h: float
    hand_stiffness: float
    rate_drive: float
    rate_step: float
    inertia: float
    hand_mass: float
    response: float
    mobility: float
    decoupled: int
    k: OfAxes
    pull: OfAxes
    inverse: OfAxes
    b: OfAxes
    middle_gain: OfAxes
    inverse_of_all: MatrixOfAxes
    largest: float
    knee_square: float
    force_limit: float
    coupling: LimitedCoupling
    tried_position: OfAxes
    tried_velocity: OfAxes
    tried_hand_force: OfAxes
    tried_low: OfAxes
    tried_high: OfAxes
    tried_dissipated: OfAxes
    results: Annotated[FloatRows, (AXES, 5)]
    work: float
    pushing: OfAxes
    change: OfAxes
    driving: OfAxes
    middle: OfAxes

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
        super().__init__()
        self.n, self.period, self.substeps = dof, period, substeps
        self.h = h = period / substeps
        self.largest = float(np.linalg.eigvalsh(stiffness)[-1])
        self.knee_square, self.force_limit = knee * knee, force_limit
        own = 2.0 * (mass + hand.mass) / h + own_damping + hand.damping + hand.stiffness * h / 2.0
        self.hand_stiffness = hand.stiffness
        self.inertia = 2.0 * (mass + hand.mass) / h
        self.hand_mass = 2.0 * hand.mass / h
        self.response = hand.stiffness * h / 2.0 + hand.damping + self.hand_mass
        self.rate_drive = hand.damping - 0.5 * hand.stiffness * h
        self.rate_step = hand.stiffness * h
        self.mobility = 1.0 / own
        self.coupling = LimitedCoupling(stiffness, damping, own, h, knee, force_limit)
        B, self.b = np.array(damping), list(damping)
        k = np.diagonal(stiffness)
        if np.array_equal(stiffness, np.diag(k)):
            self.decoupled, self.k = 1, k.tolist()
            self.pull, self.inverse = (k + hand.stiffness).tolist(), (1.0 / (own + B + k * h / 2.0)).tolist()
            self.middle_gain = (k * h / 2.0 - B).tolist()
        else:
            self.inverse_of_all = np.linalg.inv(np.diag(own + B) + stiffness * (h / 2.0)).tolist()
        self.tried_position, self.tried_velocity, self.tried_hand_force = ([0.0] * dof for _ in range(3))
        self.tried_low, self.tried_high, self.tried_dissipated = ([0.0] * dof for _ in range(3))
        self.pushing, self.change, self.driving, self.middle = ([0.0] * dof for _ in range(4))
        self.results = [[0.0] * 5 for _ in range(dof)]

    def run(self, state: DeviceState, path: Sequence[Vector]) -> list[TickResult]:
        """Run a tick from each point of the hand's reference on `path` [m] to the next. Returns each tick's result."""
        n, ticks = self.n, len(path) - 1
        rows: list[Floats] = [[0.0] * 5 for _ in range(ticks * n)]
        if self.decoupled and not state.at_limit and along_axes(self, state, path, 0, ticks, rows):
            if n == 1:
                return [(work, (x,), (v,), (f,), (actuators,)) for work, x, v, f, actuators in rows]
            return [_joined(*rows[k : k + n]) for k in range(0, ticks * n, n)]
        results = []
        for k in range(ticks):
            work = tick(self, state, path, k)
            vectors = state.position, state.velocity, state.hand_force, state.actuator_force
            x, v, f, actuator = (tuple(vector) for vector in vectors)
            results.append((work, x, v, f, actuator))
        return results


def _joined(*axes: Floats) -> TickResult:
    """The result of all axes, from the results of each."""
    works, x, v, f, actuators = zip(*axes, strict=True)
    return added(works), x, v, f, actuators


@equation
def tick(model: TickModel, state: DeviceState, path: Sequence[Reals], at: int) -> float:
    """Compute a tick; the hand's reference moves from path[at] to the next point [m]. Returns the hand's work [J]."""
    if not state.coupled:
        return held_tick(model, state, path, at)
    if not state.at_limit:
        if model.decoupled:
            if along_axes(model, state, path, at, 1, model.results):
                work = 0.0
                for axis in range(model.n):
                    work += model.results[axis][0]
                return work
        elif _together(model, state, path[at], path[at + 1]):
            return model.work
    return _limited(model, state, path[at], path[at + 1])


@equation
def held_tick(model: TickModel, state: DeviceState, path: Sequence[Reals], at: int) -> float:
    """Compute a tick without coupling and limits: only the held torque acts. Returns the hand's work [J].

    `along_axes` gives the same in twice the time, as it keeps extremes and the damper's dissipation.
    """
    h, period, substeps, kh = model.h, model.period, model.substeps, model.hand_stiffness
    rate_drive, rate_step, mobility = model.rate_drive, model.rate_step, model.mobility
    inertia, hand_mass, response = model.inertia, model.hand_mass, model.response
    begin, end, total = path[at], path[at + 1], 0.0
    for axis in range(model.n):
        x, v, torque, a = state.position[axis], state.velocity[axis], state.torque[axis], begin[axis]
        rate = (end[axis] - a) / period
        hand = kh * a + rate_drive * rate
        hand_step = rate_step * rate
        work = f = 0.0
        for _ in range(substeps):
            hand += hand_step
            pull = kh * x
            middle = (inertia * v + torque + hand - pull) * mobility
            f = hand - pull + hand_mass * v - response * middle
            work += f * middle
            v = middle + middle - v
            x += h * middle
        total += work * h
        state.position[axis], state.velocity[axis], state.hand_force[axis] = x, v, f
        state.actuator_force[axis] = torque
    return total


# -- axis by axis: K diagonal and within all limits ------------------------------------------------------------------


@equation
def along_axes(
    model: TickModel, state: DeviceState, path: Sequence[Reals], at: int, ticks: int, results: FloatRows
) -> bool:
    """Compute each axis alone, for `ticks` ticks from path[at] on.

    results : receives for each tick and axis the hand's work, and the components of the vectors of `TickResult`.
    Returns false, with the state unchanged, if the spring may have saturated or the damper may have been
    limited.
    """
    n, h, period, substeps, kh = model.n, model.h, model.period, model.substeps, model.hand_stiffness
    rate_drive, rate_step = model.rate_drive, model.rate_step
    inertia, hand_mass, response = model.inertia, model.hand_mass, model.response
    tried_low, tried_high, tried_dissipated = model.tried_low, model.tried_high, model.tried_dissipated
    stretch = drag = 0.0
    for axis in range(n):
        k, pull, inverse, b = model.k[axis], model.pull[axis], model.inverse[axis], model.b[axis]
        x, v, y, torque = state.position[axis], state.velocity[axis], state.set_position[axis], state.torque[axis]
        low, high, dissipated, middle_gain = (
            state.low[axis],
            state.high[axis],
            state.dissipated[axis],
            model.middle_gain[axis],
        )
        drive, loss, most = k * y + torque, b * h, 0.0
        begin = path[at][axis]
        for done in range(ticks):
            end = path[at + done + 1][axis]
            rate = (end - begin) / period
            hand = kh * begin + rate_drive * rate
            hand_step = rate_step * rate
            begin = end
            work = f = middle = squares = 0.0
            for _ in range(substeps):
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
            row = results[done * n + axis]
            row[0], row[1], row[2], row[3] = work * h, x, v, f
            row[4] = k * (y - x) + middle_gain * middle + torque
        drag += b * b * most
        farthest = high - y if high - y > y - low else y - low
        stretch += k * farthest * farthest
        tried_low[axis], tried_high[axis], tried_dissipated[axis] = low, high, dissipated
    if stretch > model.knee_square or _may_exceed(model, stretch, math.sqrt(drag)):
        return False
    for axis in range(n):
        row = results[(ticks - 1) * n + axis]
        state.position[axis], state.velocity[axis] = row[1], row[2]
        state.hand_force[axis], state.actuator_force[axis] = row[3], row[4]
        state.low[axis], state.high[axis], state.dissipated[axis] = (
            tried_low[axis],
            tried_high[axis],
            tried_dissipated[axis],
        )
    return True


@equation
def _may_exceed(model: TickModel, stretch: float, drag: float) -> bool:
    """Whether the force may exceed its limit, with ``|e|_K^2`` up to `stretch` [J] and a damper force up to `drag`
    [N].
    """
    return math.sqrt(model.largest * stretch) + drag > model.force_limit


# -- any K -----------------------------------------------------------------------------------------------------------


@equation
def _set_out(model: TickModel, begin: Reals, end: Reals) -> None:
    """Compute the hand's force at the tick's start for a device at 0, and its change in a substep."""
    for i in range(model.n):
        rate = (end[i] - begin[i]) / model.period
        model.pushing[i] = model.hand_stiffness * begin[i] + model.rate_drive * rate
        model.change[i] = model.rate_step * rate


@equation
def _together(model: TickModel, state: DeviceState, begin: Reals, end: Reals) -> bool:
    """Compute a tick within all limits; `work` is then the hand's. Returns as `along_axes`."""
    n, h, kh, K, b = model.n, model.h, model.hand_stiffness, model.coupling.K, model.b
    inertia, hand_mass, response = model.inertia, model.hand_mass, model.response
    x, v, f = model.tried_position, model.tried_velocity, model.tried_hand_force
    low, high, pushing, driving = model.tried_low, model.tried_high, model.pushing, model.driving
    middle = model.middle
    ybar, torque = state.set_position, state.torque
    for i in range(n):
        x[i], v[i] = state.position[i], state.velocity[i]
        low[i], high[i] = state.low[i], state.high[i]
    _set_out(model, begin, end)
    work = squares = lost = 0.0
    for _ in range(model.substeps):
        for i in range(n):
            pushing[i] += model.change[i]
            pull = 0.0
            for j in range(n):
                pull += K[i][j] * (ybar[j] - x[j])
            driving[i] = inertia * v[i] + torque[i] + pushing[i] + pull - kh * x[i]
        times(n, model.inverse_of_all, driving, middle)
        for i in range(n):
            u = middle[i]
            f[i] = pushing[i] - kh * x[i] + hand_mass * v[i] - response * u
            work += f[i] * u
            v[i] = 2.0 * u - v[i]
            x[i] += h * u
            if x[i] < low[i]:
                low[i] = x[i]
            elif x[i] > high[i]:
                high[i] = x[i]
            drag = b[i] * u
            squares += drag * drag
            lost += drag * u
    stretch = 0.0
    for i in range(n):
        farthest = high[i] - ybar[i] if high[i] - ybar[i] > ybar[i] - low[i] else ybar[i] - low[i]
        stretch += farthest * farthest
    stretch *= model.largest
    if stretch > model.knee_square or _may_exceed(model, stretch, math.sqrt(squares)):
        return False
    for i in range(n):
        spring = 0.0
        for j in range(n):
            spring += K[i][j] * (ybar[j] - x[j] + h / 2.0 * middle[j])
        state.actuator_force[i] = torque[i] + spring - b[i] * middle[i]
        state.position[i], state.velocity[i], state.hand_force[i] = x[i], v[i], f[i]
        state.low[i], state.high[i] = low[i], high[i]
    state.dissipated[0] += lost * h
    model.work = work * h
    return True


@equation
def _limited(model: TickModel, state: DeviceState, begin: Reals, end: Reals) -> float:
    """Compute a tick with any limits active. Returns the hand's work [J]."""
    n, h, kh, coupling, pushing = model.n, model.h, model.hand_stiffness, model.coupling, model.pushing
    x, v, f, middle = state.position, state.velocity, state.hand_force, coupling.middle
    for i in range(n):
        coupling.offset[i] = x[i] - state.set_position[i]
    times(n, coupling.K, coupling.offset, coupling.pull)
    _set_out(model, begin, end)
    work = dissipated = 0.0
    for _ in range(model.substeps):
        for i in range(n):
            pushing[i] += model.change[i]
            coupling.push[i] = state.torque[i] + pushing[i] + model.inertia * v[i] - kh * x[i]
        limited_coupling.substep(coupling)
        if coupling.limited:
            state.limited = 1
        dissipated += coupling.power
        for i in range(n):
            f[i] = pushing[i] - kh * x[i] + model.hand_mass * v[i] - model.response * middle[i]
            v[i] = middle[i] + middle[i] - v[i]
            x[i] += h * middle[i]
            state.low[i], state.high[i] = min(state.low[i], x[i]), max(state.high[i], x[i])
        work += dot(n, f, middle)
    beyond = dot(n, coupling.offset, coupling.pull) > model.knee_square
    state.at_limit = 1 if coupling.limited or beyond else 0
    for i in range(n):
        state.actuator_force[i] = coupling.force[i] + state.torque[i]
    state.dissipated[0] += dissipated * h
    return work * h
