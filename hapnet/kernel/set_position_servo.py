"""The device's servo, held from tick to tick or continuous: `hapnet.control.set_position_servo`."""

from __future__ import annotations

import math

from hapnet.control import ledger as ledgers
from hapnet.control.ledger import Ledger
from hapnet.kernel.reserve import ForceGuard, admit, needed_after
from hapnet.kernel.set_position_coupling import Coupling, potential, update
from hapnet.kernel.smoothing import Stages
from hapnet.mechanics import spring as springs
from hapnet.mechanics.spring import Spring
from hapnet.records.equation import equation
from hapnet.records.record import Floats, OfAxes, Record
from hapnet.records.vectors import copy, distance


class SampledServo(Record):
    """The attributes of `SampledServo` and of its parts.

    period_due, sending_due : its `_due` and its sender's; sending_elapsed : the sender's time. work : of its
    `MeasuredHarvest`. trusts : is there trusted damping? sends : does the last tick send the position? In virtual time
    no tick is late, so nothing of overruns is here.
    """

    due: float
    sending_due: float
    sending_elapsed: float
    resolution: float
    rounding: float
    damping: OfAxes
    trusts: int
    trusted: OfAxes
    force: OfAxes
    commanded: OfAxes
    before: OfAxes
    velocity: OfAxes
    position: OfAxes
    potential: float
    elapsed: float
    torque_path: float
    boundary: float
    speed_max: float
    guarded: int
    work: float
    sends: int
    spring_force: OfAxes


@equation
def tick(
    servo: SampledServo,
    coupling: Coupling,
    spring: Spring,
    ledger: Ledger,
    stages: Stages,
    guard: ForceGuard,
    dt: float,
    x: Floats,
    v: Floats,
    updates: bool,
) -> None:
    """`SampledServo.tick`. `updates`: PSPM runs (see `due`), and the source's y is in `coupling.y`."""
    n = spring.dof
    travel = distance(n, x, servo.position)
    if dt > 0.0 and travel > servo.speed_max * dt:
        servo.speed_max = max(servo.speed_max, (travel - servo.rounding) / dt)
    if servo.resolution != 0.0:
        _blur(servo, coupling, spring, n)
    work = hold(servo.trusts != 0, servo.trusted, n, servo.force, servo.position, x, dt, servo.resolution)
    servo.work += work
    ledgers.put_in(ledger, work)
    copy(n, x, servo.position)
    stored = potential(coupling, spring, x)
    ledgers.observe(ledger, stored, coupling.account + (servo.work - (stored - servo.potential)))
    servo.elapsed += dt
    servo.sends = 0
    coupling.shuffled = 0.0
    if updates:
        keep = needed_after(guard, n, servo.commanded)
        dissipated = servo.work - (stored - servo.potential)
        servo.work = 0.0
        update(coupling, spring, ledger, stages, servo.elapsed, x, dissipated, keep)
        servo.sending_elapsed += servo.elapsed
        if servo.sending_elapsed >= servo.sending_due:
            servo.sending_elapsed = 0.0
            servo.sends = 1
        servo.potential = potential(coupling, spring, x)
        servo.elapsed = 0.0
        ledgers.observe(ledger, servo.potential, coupling.account)
    _render(servo, coupling, spring, guard, n, x, v)


@equation
def due(servo: SampledServo, coupling: Coupling, dt: float) -> bool:
    """Does PSPM run in the tick that comes `dt` seconds after the last?"""
    return coupling.has_sample != 0 or servo.elapsed + dt >= servo.due


@equation
def account(servo: SampledServo, coupling: Coupling, spring: Spring) -> float:
    """`SampledServo.account`."""
    stored = potential(coupling, spring, servo.position)
    return coupling.account + (servo.work - (stored - servo.potential))


@equation
def hold(
    trusts: bool, trusted: Floats, n: int, torque: Floats, start: Floats, end: Floats, period: float, resolution: float
) -> float:
    """`MeasuredHarvest.hold`: the work put in [J]."""
    total = 0.0
    for i in range(n):
        total += torque[i] * (end[i] - start[i])
    work = -total
    if trusts and period > 0.0:
        lost = 0.0
        for i in range(n):
            travel = max(start[i], end[i]) - min(start[i], end[i]) - resolution
            if travel > 0.0:
                lost += trusted[i] * travel * travel
        work += lost / period
    return work


@equation
def _stored(servo: SampledServo, coupling: Coupling) -> float:
    """`SampledServo._stored`."""
    return coupling.account + servo.work + servo.potential


@equation
def _render(
    servo: SampledServo, coupling: Coupling, spring: Spring, guard: ForceGuard, n: int, x: Floats, v: Floats
) -> None:
    """`SampledServo._render`."""
    copy(n, v, servo.velocity)
    springs.force(spring, x, coupling.set_position, servo.spring_force)
    for i in range(n):
        guard.wanted[i] = servo.spring_force[i] - servo.damping[i] * v[i]
    energy = _stored(servo, coupling) if guard.has_account else math.inf
    if admit(guard, n, servo.commanded, v, energy):
        servo.guarded += 1
    copy(n, guard.wanted, servo.force)
    copy(n, guard.wanted, servo.commanded)


@equation
def _blur(servo: SampledServo, coupling: Coupling, spring: Spring, n: int) -> None:
    """`SampledServo._blur`."""
    path = unsprung = 0.0
    springs.force(spring, servo.position, coupling.set_position, servo.spring_force)
    for i in range(n):
        path += abs(servo.force[i] - servo.before[i])
        unsprung += abs(servo.force[i] - servo.spring_force[i])
        servo.before[i] = servo.force[i]
    servo.torque_path += path
    servo.boundary = max(servo.boundary, unsprung)
