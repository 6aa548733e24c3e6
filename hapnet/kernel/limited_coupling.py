"""The coupling in one midpoint substep, within the actuators' limits: `hapnet.plant.limited_coupling`."""

from __future__ import annotations

import math

from hapnet.plant.limited_coupling import ROUNDS, discrete_gradient
from hapnet.records.equation import equation
from hapnet.records.record import MatrixOfAxes, OfAxes, Record
from hapnet.records.vectors import copy, distance, dot, length, times

_ROUNDS = ROUNDS


class LimitedCoupling(Record):
    """`LimitedCoupling` with its state within a tick, and the result of a substep.

    values, vectors : its modes. offset, pull : e and K e. push : the driving force. limited : is the damper limited?
    unsolved : no force of the right length was found, which only the reference can handle.
    """

    n: int
    K: MatrixOfAxes
    damping: OfAxes
    resistance: float
    h: float
    knee: float
    force_limit: float
    values: OfAxes
    vectors: MatrixOfAxes
    push: OfAxes
    offset: OfAxes
    pull: OfAxes
    pushes: OfAxes
    pulls: OfAxes
    middle: OfAxes
    end: OfAxes
    after: OfAxes
    force: OfAxes
    before: OfAxes
    spring: OfAxes
    drag: OfAxes
    power: float
    limited: int
    unsolved: int


@equation
def substep(coupling: LimitedCoupling) -> None:
    """`LimitedCoupling.substep`; `offset` and `pull` are then those at its end."""
    n = coupling.n
    _damp(coupling)
    coupling.limited = 0
    if length(n, coupling.force) > coupling.force_limit:
        coupling.limited = 1
        if not _find_at_limit(coupling):
            coupling.unsolved = 1
    copy(n, coupling.end, coupling.offset)
    copy(n, coupling.after, coupling.pull)


@equation
def _damp(coupling: LimitedCoupling) -> None:
    """`LimitedCoupling._damped` with the whole damper."""
    n, h = coupling.n, coupling.h
    c = _saturate(coupling)
    for i in range(n):
        coupling.end[i] = coupling.offset[i] + h * coupling.middle[i]
    times(n, coupling.K, coupling.end, coupling.after)
    power = 0.0
    for i in range(n):
        drag = coupling.damping[i] * coupling.middle[i]
        coupling.force[i] = -0.5 * c * (coupling.pull[i] + coupling.after[i]) - drag
        power += drag * coupling.middle[i]
    coupling.power = power


@equation
def _saturate(coupling: LimitedCoupling) -> float:
    """`LimitedCoupling._saturated`: c, and vhat into `middle`."""
    n, h = coupling.n, coupling.h
    square = dot(n, coupling.offset, coupling.pull)
    for k in range(n):
        coupling.pushes[k] = dot(n, coupling.vectors[k], coupling.push)
        coupling.pulls[k] = dot(n, coupling.vectors[k], coupling.pull)
    start = math.sqrt(max(0.0, square))
    c = _fixed_point(coupling, start, square, 1.0 if start <= coupling.knee else coupling.knee / start)
    for i in range(n):
        coupling.middle[i] = 0.0
    for k in range(n):
        w = (coupling.pushes[k] - c * coupling.pulls[k]) / (1.0 + 0.5 * c * h * coupling.values[k])
        for i in range(n):
            coupling.middle[i] += coupling.vectors[k][i] * w
    return c


@equation
def _gradient(coupling: LimitedCoupling, start: float, square: float, c: float) -> float:
    """The discrete gradient of the substep that a given c leads to."""
    h, gain = coupling.h, 0.0
    for k in range(coupling.n):
        value = coupling.values[k]
        u = (coupling.pushes[k] - c * coupling.pulls[k]) / (1.0 + 0.5 * c * h * value)
        gain += u * (2.0 * coupling.pulls[k] + h * value * u)
    found: float = discrete_gradient(start, math.sqrt(max(0.0, square + h * gain)), coupling.knee)
    return found


@equation
def _fixed_point(coupling: LimitedCoupling, start: float, square: float, c: float) -> float:
    """`hapnet.plant.limited_coupling._fixed_point`."""
    for _ in range(_ROUNDS):
        before = c
        c = _gradient(coupling, start, square, c)
        if abs(c - before) <= 1e-15:
            return c
    low, high = 0.0, 1.0
    c = 0.5
    while low < c < high:
        if _gradient(coupling, start, square, c) > c:
            low = c
        else:
            high = c
        c = 0.5 * (low + high)
    return c


@equation
def _find_at_limit(coupling: LimitedCoupling) -> bool:
    """`LimitedCoupling._at_limit`: is there such a force? It is then in `force`."""
    n, h, limit = coupling.n, coupling.h, coupling.force_limit
    start = math.sqrt(max(0.0, dot(n, coupling.offset, coupling.pull)))
    shorter = limit / length(n, coupling.force)
    for i in range(n):
        coupling.force[i] = shorter * coupling.force[i]
    for _ in range(_ROUNDS):
        for i in range(n):
            coupling.middle[i] = (coupling.push[i] + coupling.force[i]) / coupling.resistance
            coupling.end[i] = coupling.offset[i] + h * coupling.middle[i]
        times(n, coupling.K, coupling.end, coupling.after)
        end = math.sqrt(max(0.0, dot(n, coupling.end, coupling.after)))
        c: float = discrete_gradient(start, end, coupling.knee)
        for i in range(n):
            coupling.spring[i] = -0.5 * c * (coupling.pull[i] + coupling.after[i])
            coupling.drag[i] = coupling.damping[i] * coupling.middle[i]
        along, square = dot(n, coupling.spring, coupling.drag), dot(n, coupling.drag, coupling.drag)
        if square == 0.0:
            return False
        room = limit * limit - dot(n, coupling.spring, coupling.spring)
        share = (along + math.sqrt(max(0.0, along * along + square * room))) / square
        for i in range(n):
            coupling.before[i] = coupling.force[i]
            coupling.force[i] = coupling.spring[i] - share * coupling.drag[i]
        if distance(n, coupling.before, coupling.force) <= 1e-14 * limit:
            lost = 0.0
            for i in range(n):
                lost += (coupling.spring[i] - coupling.before[i]) * coupling.middle[i]
            copy(n, coupling.before, coupling.force)
            coupling.power = max(0.0, lost)
            return True
    return False
