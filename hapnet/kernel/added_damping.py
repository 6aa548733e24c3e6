"""Damping that is added through the set-position: `hapnet.control.added_damping`, where planes are told."""

from __future__ import annotations

from hapnet.control import added_damping as reference
from hapnet.control.smoothing import FilteredVelocity, filter_velocity
from hapnet.records.equation import equation
from hapnet.records.record import Floats, MatrixOfAxes, Record

_VELOCITY_S = reference.VELOCITY_S
_AGED_S, _OLD_S, _OLD_NS_M = reference.AGED_S, reference.OLD_S, reference.OLD_NS_M


class AddedDamping(Record):
    """The attributes of `AddedDamping`, but for those that only swings use."""

    least: float
    most: float
    compliance: MatrixOfAxes


@equation
def damp(
    added: AddedDamping, velocity: FilteredVelocity, n: int, dt: float, x: Floats, y: Floats, age: float, freedom: float
) -> None:
    """`AddedDamping.step` without swings: replaces y by y'."""
    filter_velocity(velocity, n, dt, x)
    old = min(1.0, max(0.0, (age - _AGED_S) / (_OLD_S - _AGED_S)))
    damping = max(freedom * added.least, old * min(_OLD_NS_M, added.most))
    if damping == 0.0:
        return
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += added.compliance[i][j] * (damping * velocity.velocity[j])
        y[i] = y[i] - total
