"""Damping that is added by moving the set-position, most of it only during oscillations.

    y' = y - b K^-1 v,      b = the largest of b_0, b_age(age), b_swing(envelope)

* b_0 acts in free motion, where half of it is felt: without any drag a hand departs from its prediction. In contact it
  would only falsify the wall. (A larger damper B would not do: B's force is held, so the reserve must cover B v for as
  long as the watchdog allows, but a spring's force is covered by its stored energy, control/reserve.py.)
* b_age: with an old answer the proxy's position is uncertain. From an age of 1 s on, drag grows to 1.5 Ns/m. The user
  notices that the world is late, but does not mistake 0.1 N at 67 mm/s for a contact.
* b_swing acts only if the world cannot send planes. It follows the envelope of the force's changes above about 2 Hz,
  which rises at once and falls in two seconds. It is zero in contact and at rest, and small in free motion, because the
  force is small. So it damps a limit cycle, but hardly a voluntary motion.

Added damping only removes energy, which PSPM harvests. `most` is the damping that a sampled servo renders stably.
"""

from __future__ import annotations

from collections.abc import Sequence

from hapnet.control.smoothing import FilteredVelocity, filter_velocity, low_pass
from hapnet.records.record import Floats, MatrixOfAxes, OfAxes, Reals, Record, equation
from hapnet.records.vectors import distance, times

VELOCITY_S = 0.005
"""Time constant of the velocity [s]: it smooths encoder counts, and delays an oscillation of 6 Hz by 0.2 radians."""

AGED_S, OLD_S = 1.0, 2.0
"""Between these ages of the answer, b_age grows from 0 to `OLD_NS_M` [s]."""

OLD_NS_M = 1.5
"""The largest b_age [Ns/m]."""

SLOW_S = 0.2
"""Time constant of the force's slow part, which does not count as oscillation [s]."""

CALM_S = 2.0
"""Time constant with which an oscillation's envelope falls [s]."""

MIN_N, SWING_N = 0.03, 0.1
"""Between these amplitudes of the force, b_swing grows from 0 to its maximum [N]; the first is barely felt."""


class AddedDamping(Record):
    """Computes y' from y.

    stiffness : K, (n, n) [N/m]. compliance : K^-1 [m/N]. minimum : b_0 [Ns/m]. most : the maximum of b [Ns/m].

    Attributes
    ----------
    envelope : of the force's changes [N]. slow_force : the force's slow part [N]. offset, force : temporary memory.
    """

    minimum: float
    most: float
    stiffness: MatrixOfAxes
    compliance: MatrixOfAxes
    velocity: FilteredVelocity
    offset: OfAxes
    force: OfAxes
    slow_force: OfAxes
    envelope: float

    def __init__(
        self, stiffness: Sequence[Sequence[float]], compliance: Sequence[Sequence[float]], minimum: float, most: float
    ) -> None:
        n = len(stiffness)
        self.minimum, self.most = minimum, most
        self.compliance = [list(row) for row in compliance]
        self.velocity = FilteredVelocity(VELOCITY_S, n)
        self.stiffness = [list(row) for row in stiffness]
        self.offset, self.force, self.slow_force = [0.0] * n, [0.0] * n, [0.0] * n
        self.envelope = 0.0


@equation
def damp_swings(added: AddedDamping, n: int, dt: float, x: Reals, y: Floats, age: float) -> None:
    """Replace y by y' for a world that cannot send planes: b_swing acts too, and motion counts as free.

    age : of the world's answer [s].
    """
    filter_velocity(added.velocity, n, dt, x)
    for i in range(n):
        added.offset[i] = y[i] - x[i]
    times(n, added.stiffness, added.offset, added.force)
    low_pass(n, dt, SLOW_S, added.slow_force, added.force)
    added.envelope = max(distance(n, added.force, added.slow_force), added.envelope * CALM_S / (CALM_S + dt))
    swinging = min(1.0, max(0.0, (added.envelope - MIN_N) / (SWING_N - MIN_N)))
    damp(added, n, max(wanted(added, age, 1.0), swinging * added.most), y)


@equation
def wanted(added: AddedDamping, age: float, freedom: float) -> float:
    """The larger of b_0 and b_age [Ns/m]."""
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
