"""A simulated device whose coupling acts within the tick: `hapnet.plant.tick`."""

from __future__ import annotations

import math

from hapnet.kernel import limited_coupling
from hapnet.kernel.device import Device, Hand
from hapnet.kernel.limited_coupling import LimitedCoupling
from hapnet.records.equation import equation
from hapnet.records.record import FloatRows, Floats, MatrixOfAxes, OfAxes, Record
from hapnet.records.vectors import copy, dot, times


class TickModel(Record):
    """`TickModel` for an active coupling, and the part of `DeviceState` that belongs to it.

    decoupled : are the axes independent? Then k, pull, inverse, b and middle_gain are those of each axis; otherwise
    `inverse_of_all` is A^-1. tried_... : the state at the end of a tick that may have to be computed again.
    """

    in_use: int
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
    low: OfAxes
    high: OfAxes
    dissipated: float
    limited: int
    at_limit: int
    tried_low: OfAxes
    tried_high: OfAxes
    tried_position: OfAxes
    tried_velocity: OfAxes
    tried_hand_force: OfAxes
    tried_actuator_force: OfAxes
    tried_dissipated: float
    stretch: float
    drag: float
    hand: OfAxes
    hand_step: OfAxes
    driving: OfAxes
    middle: OfAxes


@equation
def advance(device: Device, model: TickModel, coupling: LimitedCoupling, going: Hand, ybar: Floats) -> float:
    """`TickModel._tick`, while the hand goes to the next point of its path. Returns the hand's work [J]."""
    work = 0.0
    done = False
    if not model.at_limit:
        if model.decoupled:
            work = _try_axes(device, model, going, ybar)
        else:
            work = _try_all(device, model, coupling.K, going, ybar)
        done = not (model.stretch > model.knee_square or _may_exceed(model))
        if done:
            _keep(device, model)
    if not done:
        work = _limited(device, model, coupling, going, ybar)
    going.at += 1
    device.ticks += 1
    device.time = (device.before + device.ticks) * device.period
    return work


@equation
def dissipated(device: Device, model: TickModel, interval: float) -> float:
    """What the coupling's damper dissipated since the last call, or its bound (10), as after `SimulatedDevice.passage`.

    The extremes of the position begin anew.
    """
    total = 0.0
    for i in range(device.n):
        travel = model.high[i] - model.low[i] - 0.0
        if travel > 0.0:
            total += model.b[i] * travel * travel
    lost = model.dissipated if model.limited else total / interval
    copy(device.n, device.position, model.low)
    copy(device.n, device.position, model.high)
    model.dissipated, model.limited = 0.0, 0
    return lost


@equation
def _may_exceed(model: TickModel) -> bool:
    """`TickModel._may_exceed`."""
    return math.sqrt(model.largest * model.stretch) + model.drag > model.force_limit


@equation
def _keep(device: Device, model: TickModel) -> None:
    """The tick was computed within all limits: its end is the device's state."""
    n = device.n
    copy(n, model.tried_position, device.position)
    copy(n, model.tried_velocity, device.velocity)
    copy(n, model.tried_hand_force, device.hand_force)
    copy(n, model.tried_actuator_force, device.actuator_force)
    copy(n, model.tried_low, model.low)
    copy(n, model.tried_high, model.high)
    model.dissipated = model.tried_dissipated


@equation
def _try_axes(device: Device, model: TickModel, going: Hand, ybar: Floats) -> float:
    """`TickModel._axes` of one tick."""
    h, kh = device.h, device.hand_stiffness
    inertia, hand_mass, response = device.inertia, device.hand_mass, device.response
    total = stretch = drag = 0.0
    dissipated = model.dissipated
    for axis in range(device.n):
        k, pull, inverse, b = model.k[axis], model.pull[axis], model.inverse[axis], model.b[axis]
        x, v, y, torque = device.position[axis], device.velocity[axis], ybar[axis], device.torque[axis]
        low, high = model.low[axis], model.high[axis]
        drive, loss = k * y + torque, b * h
        begin = going.path[going.at][axis]
        rate = (going.path[going.at + 1][axis] - begin) / device.period
        hand = kh * begin + device.rate_drive * rate
        hand_step = device.rate_step * rate
        work = f = middle = squares = 0.0
        for _ in range(device.substeps):
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
        dissipated += loss * squares
        drag += b * b * squares
        farthest = high - y if high - y > y - low else y - low
        stretch += k * farthest * farthest
        total += work * h
        model.tried_position[axis], model.tried_velocity[axis], model.tried_hand_force[axis] = x, v, f
        model.tried_actuator_force[axis] = k * (y - x) + model.middle_gain[axis] * middle + torque
        model.tried_low[axis], model.tried_high[axis] = low, high
    model.tried_dissipated, model.stretch, model.drag = dissipated, stretch, math.sqrt(drag)
    return total


@equation
def _set_out(device: Device, model: TickModel, going: Hand) -> None:
    """The hand's force at the tick's start, and its change in a substep."""
    kh, h = device.hand_stiffness, device.h
    for i in range(device.n):
        begin = going.path[going.at][i]
        rate = (going.path[going.at + 1][i] - begin) / device.period
        model.hand[i] = kh * begin + device.rate_drive * rate
        model.hand_step[i] = kh * h * rate


@equation
def _try_all(device: Device, model: TickModel, K: FloatRows, going: Hand, ybar: Floats) -> float:
    """`TickModel._linear`, substep by substep."""
    n, h, kh = device.n, device.h, device.hand_stiffness
    x, v, middle, f = model.tried_position, model.tried_velocity, model.middle, model.tried_hand_force
    copy(n, device.position, x)
    copy(n, device.velocity, v)
    copy(n, model.low, model.tried_low)
    copy(n, model.high, model.tried_high)
    _set_out(device, model, going)
    work = squares = lost = 0.0
    for _ in range(device.substeps):
        for i in range(n):
            model.hand[i] += model.hand_step[i]
            pull = 0.0
            for j in range(n):
                pull += K[i][j] * (ybar[j] - x[j])
            model.driving[i] = device.inertia * v[i] + device.torque[i] + model.hand[i] + pull - kh * x[i]
        times(n, model.inverse_of_all, model.driving, middle)
        for i in range(n):
            f[i] = model.hand[i] - kh * x[i] + device.hand_mass * v[i] - device.response * middle[i]
            work += f[i] * middle[i]
            v[i] = 2.0 * middle[i] - v[i]
            x[i] = x[i] + h * middle[i]
            model.tried_low[i], model.tried_high[i] = min(model.tried_low[i], x[i]), max(model.tried_high[i], x[i])
            drag = model.b[i] * middle[i]
            squares += drag * drag
            lost += drag * middle[i]
    stretch = 0.0
    for i in range(n):
        spring = 0.0
        for j in range(n):
            spring += K[i][j] * (ybar[j] - x[j] + h / 2.0 * middle[j])
        model.tried_actuator_force[i] = device.torque[i] + spring - model.b[i] * middle[i]
        far = max(model.tried_high[i] - ybar[i], ybar[i] - model.tried_low[i])
        stretch += far * far
    model.tried_dissipated = model.dissipated + lost * h
    model.stretch, model.drag = stretch * model.largest, math.sqrt(squares)
    return work * h


@equation
def _limited(device: Device, model: TickModel, coupling: LimitedCoupling, going: Hand, ybar: Floats) -> float:
    """`TickModel.limited`."""
    n, h, kh = device.n, device.h, device.hand_stiffness
    x, v, middle = device.position, device.velocity, coupling.middle
    for i in range(n):
        coupling.offset[i] = x[i] - ybar[i]
    times(n, coupling.K, coupling.offset, coupling.pull)
    _set_out(device, model, going)
    work = dissipated = 0.0
    for _ in range(device.substeps):
        for i in range(n):
            model.hand[i] = model.hand[i] + model.hand_step[i]
            coupling.push[i] = device.torque[i] + model.hand[i] + device.inertia * v[i] - kh * x[i]
        limited_coupling.substep(coupling)
        if coupling.limited:
            model.limited = 1
        dissipated += coupling.power
        for i in range(n):
            f = model.hand[i] - kh * x[i] + device.hand_mass * v[i] - device.response * middle[i]
            device.hand_force[i] = f
            v[i] = middle[i] + middle[i] - v[i]
            x[i] = x[i] + h * middle[i]
            model.low[i], model.high[i] = min(model.low[i], x[i]), max(model.high[i], x[i])
        work += dot(n, device.hand_force, middle)
    beyond = dot(n, coupling.offset, coupling.pull) > model.knee_square
    model.at_limit = 1 if coupling.limited or beyond else 0
    for i in range(n):
        device.actuator_force[i] = coupling.force[i] + device.torque[i]
    model.dissipated += dissipated * h
    return work * h
