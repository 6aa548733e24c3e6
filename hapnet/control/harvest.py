"""The energy that the coupling's damper dissipated since the last update: D in (9).

The paper's bound (10) uses only the extremes of the position, and holds for a continuous servo. A real servo computes
the torque once per tick and holds it; then (10) is not a lower bound. But the work of a held torque follows exactly
from positions. So a sampled servo measures the dissipation, which includes the energy that the hold leaks.
"""

from __future__ import annotations

from hapnet.checks import Vector
from hapnet.records.record import OfAxes, Reals, Record, equation


def dissipated_by_range(damping: Vector, low: Vector, high: Vector, interval: float, resolution: float = 0.0) -> float:
    """D_min of (10) [J]: ``sum_i b_ii (x_i^max - x_i^min)^2 / interval``.

    damping : b_ii [Ns/m].
    low, high : extremes of the position over the interval [m], both ends included.
    interval : its length or an upper bound of it [s]; an interval of 0 dissipates nothing.
    resolution : of the encoder [m]: chatter of one count is not motion, so one count is subtracted from the range.
    """
    return by_range(len(damping), damping, low, high, interval, resolution)


@equation
def by_range(n: int, damping: Reals, low: Reals, high: Reals, interval: float, resolution: float) -> float:
    """D_min of (10) [J], from the lowest and highest positions: `dissipated_by_range`."""
    if interval <= 0.0:
        return 0.0
    total = 0.0
    for i in range(n):
        total += _lost(damping[i], high[i] - low[i] - resolution)
    return total / interval


@equation
def _lost(damping: float, travel: float) -> float:
    """``b travel^2``; 0 if there is no travel."""
    return damping * travel * travel if travel > 0.0 else 0.0


class MeasuredHarvest(Record):
    """Energy that a sampled, held torque took out of the device since the last update, less the change of phi.

    ``D_s = sum_j -tau_j . (x_{j+1} - x_j) - (phi at the end - phi at the start)``, both phi with the ybar held then.
    It is exact for any device if the torque is really applied, and needs no force sensor.

    Parameters
    ----------
    trusted_damping : a lower bound of the device's own damping on each axis [Ns/m], harvested too; 0 if unknown.
    resolution : of the encoder [m]: chatter of one count is not motion, and a damper dissipates nothing in it.

    Attributes
    ----------
    work : energy put in at the actuator's port since the last `take` [J]. trusts : whether any damping is above 0.
    """

    n: int
    work: float
    resolution: float
    trusts: int
    trusted: OfAxes

    def __init__(self, trusted_damping: Vector, resolution: float = 0.0) -> None:
        super().__init__()
        self.n, self.resolution = len(trusted_damping), resolution
        self.trusts, self.trusted = int(any(trusted_damping)), list(trusted_damping)

    def hold(self, torque: Vector, start: Vector, end: Vector, period: float) -> float:
        """Count a torque [N] that was held for `period` [s] while the device moved from `start` to `end` [m].

        Returns the work put in at the actuator's port, ``-tau . dx``, plus that put into the trusted damping [J].
        """
        return hold(self, torque, start, end, period)

    def take(self, potential_change: float) -> float:
        """D_s [J] since the last call, given the change of the spring's potential [J] over the same time."""
        return take(self, potential_change)


@equation
def hold(harvest: MeasuredHarvest, torque: Reals, start: Reals, end: Reals, period: float) -> float:
    """Count the work of a held torque [J]: `MeasuredHarvest.hold`."""
    work = 0.0
    for i in range(harvest.n):
        work += torque[i] * (end[i] - start[i])
    work = -work
    if harvest.trusts and period > 0.0:
        lost = 0.0
        for i in range(harvest.n):
            travel = max(start[i], end[i]) - min(start[i], end[i]) - harvest.resolution
            lost += _lost(harvest.trusted[i], travel)
        work += lost / period
    harvest.work += work
    return work


@equation
def take(harvest: MeasuredHarvest, potential_change: float) -> float:
    """D_s since the last call [J]: `MeasuredHarvest.take`."""
    harvested = harvest.work - potential_change
    harvest.work = 0.0
    return harvested


def damping_conditions(own_damping: Vector, K_diagonal: Vector, B: Vector, period: float) -> tuple[bool, bool]:
    """Whether a sampled servo with the range harvest meets the (necessary, sufficient) condition to be passive.

    Necessary on each axis: ``b > K T/2``. Sufficient for any motion: ``b > K T/2 + 2 B``. b: the device's own damping.
    """
    triples = list(zip(own_damping, K_diagonal, B, strict=True))
    necessary = all(b > k * period / 2.0 for b, k, _ in triples)
    return necessary, all(b > k * period / 2.0 + 2.0 * damper for b, k, damper in triples)
