"""Damping that is added through the set-position, most of it only where something oscillates.

    y' = y - b K^-1 v,      b = the largest of b_0, b_age(age), b_swing(envelope)

* b_0 acts in free motion, where half of it is felt: a hand without any drag runs away from its prediction. In contact
  it would only falsify the wall. The damper B itself is held, so the reserve must cover B v for as long as the watchdog
  allows; a spring's force is covered by the energy that it stores (control/reserve.py).
* b_age: an old answer says little about where the proxy is. From a second of age on, drag grows to 1.5 Ns/m. The hand
  feels that its world is late, but nobody takes 0.1 N at 67 mm/s for a contact.
* b_swing acts only if the world cannot send planes. It follows the envelope of the force's changes above some 2 Hz,
  which rises at once and falls in two seconds. It is zero in contact and at rest, and small while a hand moves freely,
  because the force is small. So it damps a limit cycle, and hardly a motion that the hand leads.

It only removes energy, which PSPM harvests. `most` is the damping that a sampled servo renders stably.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import sub

from hapnet.checks import Vector
from hapnet.control.smoothing import FilteredVelocity, low_passed
from hapnet.records.record import Floats, MatrixOfAxes, Record, equation
from hapnet.records.vectors import inner

VELOCITY_S = 0.005
"""Time constant of the velocity [s]: encoder counts are smoothed, and an oscillation of 6 Hz is delayed by a fifth of a
radian."""

AGED_S, OLD_S = 1.0, 2.0
"""Between these ages drag grows from none to all of it [s]."""

OLD_NS_M = 1.5
"""All of it [Ns/m]."""

SLOW_S = 0.2
"""Slower changes of the force are not part of an oscillation [s]."""

CALM_S = 2.0
"""Time constant with which an oscillation's envelope falls [s]."""

MIN_N, SWING_N = 0.03, 0.1
"""Between these amplitudes of the force, damping grows from none to all of it [N]; below the first it is not felt."""


class AddedDamping(Record):
    """Computes what is added to y.

    stiffness : K, (n, n) [N/m]. compliance : K^-1 [m/N]. least : b_0 [Ns/m]. most : the maximum of b [Ns/m].
    """

    minimum: float
    most: float
    compliance: MatrixOfAxes
    velocity: FilteredVelocity

    def __init__(
        self, stiffness: Sequence[Sequence[float]], compliance: Sequence[Sequence[float]], minimum: float, most: float
    ) -> None:
        self.minimum, self.most = minimum, most
        self.compliance = [list(row) for row in compliance]
        self.velocity = FilteredVelocity(VELOCITY_S, len(stiffness))
        self._stiffness = [tuple(row) for row in stiffness]
        self._slow_force: Vector = (0.0,) * len(self._stiffness)
        self._envelope = 0.0

    def step(self, dt: float, x: Vector, y: Vector, age: float, freedom: float, *, swings: bool) -> Vector:
        """y' [m].

        age : of the world's answer [s]. freedom : 1 in free motion, 0 in contact.
        swings : whether b_swing acts, as there is no contact model.
        """
        self.velocity.step(dt, x)
        damping = wanted(self, age, freedom)
        if swings:
            damping = max(damping, self._swinging(dt, tuple(map(sub, y, x))) * self.most)
        damp(self, len(y), damping, damped := list(y))
        return tuple(damped)

    def _swinging(self, dt: float, offset: Vector) -> float:
        force = tuple([inner(row, offset) for row in self._stiffness])
        self._slow_force = low_passed(dt, SLOW_S, self._slow_force, force)
        self._envelope = max(math.dist(force, self._slow_force), self._envelope * CALM_S / (CALM_S + dt))
        return min(1.0, max(0.0, (self._envelope - MIN_N) / (SWING_N - MIN_N)))


@equation
def wanted(added: AddedDamping, age: float, freedom: float) -> float:
    """The largest of b_0 and b_age [Ns/m]."""
    old = min(1.0, max(0.0, (age - AGED_S) / (OLD_S - AGED_S)))
    return max(freedom * added.minimum, old * min(OLD_NS_M, added.most))


@equation
def damp(added: AddedDamping, n: int, damping: float, y: Floats) -> None:
    """Replace y by y', for the velocity of the last step."""
    if damping == 0.0:
        return
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += added.compliance[i][j] * (damping * added.velocity.velocity[j])
        y[i] = y[i] - total
