"""The guard of a held force: `hapnet.control.reserve`; `ramp` and `longest` are its own functions, compiled."""

from __future__ import annotations

import math

from hapnet.control.reserve import longest, ramp
from hapnet.kernel.set_position_coupling import step_towards
from hapnet.records.equation import equation
from hapnet.records.record import Floats, OfAxes, Record
from hapnet.records.vectors import copy, distance, dot, length

_SHARE = 1.0 - 1e-9
_ROUNDING_J = 1e-12


class ForceGuard(Record):
    """The attributes of `hapnet.control.reserve.ForceGuard`."""

    limit: float
    step: float
    reach: float
    speed: float
    inertia: float
    square: float
    linear: float
    constant: float
    has_account: int
    wanted: OfAxes
    shortest: OfAxes
    way: OfAxes


@equation
def needed_after(guard: ForceGuard, n: int, force: Floats) -> float:
    """`ForceGuard.needed_after`."""
    size = length(n, force) - guard.step
    if size > 0.0 and guard.reach > 0.0:
        cost: float = guard.reach * ramp(size, guard.step)
        return (cost + _ROUNDING_J) / _SHARE
    return 0.0


@equation
def admit(guard: ForceGuard, n: int, held: Floats, v: Floats, energy: float) -> bool:
    """`ForceGuard.admit`, of the force in `guard.wanted`, which is then the force to hold. Returns if it changed."""
    wanted = guard.wanted
    size = length(n, wanted)
    ramped = size * (size * guard.square + guard.linear) + guard.constant
    if (
        size <= guard.limit
        and ramped * guard.reach + _ROUNDING_J <= energy * _SHARE
        and distance(n, wanted, held) <= guard.step
        and ramped <= guard.inertia * (guard.speed - length(n, v))
    ):
        return False
    return _limit(guard, n, size, held, v, energy)


@equation
def _limit(guard: ForceGuard, n: int, size: float, held: Floats, v: Floats, energy: float) -> bool:
    """`ForceGuard._limited`."""
    wanted, step = guard.wanted, guard.step
    most = guard.limit
    changed = False
    if guard.reach > 0.0:
        spendable = energy * _SHARE - _ROUNDING_J
        most = min(most, longest(spendable / guard.reach, step)) if spendable > 0.0 else 0.0
    if guard.inertia < math.inf and size > 0.0:
        along = dot(n, wanted, v) / size
        room = math.sqrt(along * along + max(0.0, guard.speed * guard.speed - dot(n, v, v))) - along
        most_for_speed = longest(guard.inertia * room, step)
        if size > most_for_speed:
            for i in range(n):
                wanted[i] = wanted[i] * (most_for_speed / size)
            size = most_for_speed
            changed = True
    if step != math.inf:
        changed = changed or distance(n, wanted, held) > step
        step_towards(n, held, wanted, step)
        size = length(n, wanted)
    if size <= most:
        return changed
    _shorten(guard, n, size, held, most)
    return True


@equation
def _shorten(guard: ForceGuard, n: int, size: float, held: Floats, most: float) -> None:
    """`ForceGuard._shortened`."""
    force, shortest, way = guard.wanted, guard.shortest, guard.way
    if guard.step == math.inf:
        share = most / size
        for i in range(n):
            force[i] = share * force[i]
        return
    before = length(n, held)
    for i in range(n):
        shortest[i] = 0.0 if before <= guard.step else (1.0 - guard.step / before) * held[i]
        way[i] = force[i] - shortest[i]
    a, b = dot(n, way, way), dot(n, shortest, way)
    c = dot(n, shortest, shortest) - most * most
    if c >= 0.0 or a == 0.0:
        copy(n, shortest, force)
        return
    share = (math.sqrt(b * b - a * c) - b) / a
    for i in range(n):
        force[i] = shortest[i] + share * way[i]
