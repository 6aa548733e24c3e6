"""The energy that the coupling's damper dissipated since the last update: D in (9).

The paper's bound (10) uses only the extremes of the position, and holds for a continuous servo. A real servo computes
the torque once a tick and holds it; then (10) is no lower bound. But the work of a held torque is known exactly from
positions. So a sampled servo measures the dissipation, and the energy that the hold leaks is included.
"""

from __future__ import annotations

from operator import mul, sub

from hapnet.checks import Vector


def dissipated_by_range(damping: Vector, low: Vector, high: Vector, interval: float, resolution: float = 0.0) -> float:
    """D_min of (10) [J]: ``sum_i b_ii (x_i^max - x_i^min)^2 / interval``.

    Parameters
    ----------
    damping : b_ii [Ns/m].
    low, high : extremes of the position over the interval [m], both ends included.
    interval : its length or an upper bound of it [s]; over an interval of 0 nothing was dissipated.
    resolution : of the encoder [m]: chatter of one count is not motion, so one count is subtracted from the range.
    """
    if interval <= 0.0:
        return 0.0
    total = 0.0
    for b, least, most in zip(damping, low, high, strict=True):
        travel = most - least - resolution
        if travel > 0.0:
            total += b * travel * travel
    return total / interval


class MeasuredHarvest:
    """Energy that a sampled, held torque took out of the device since the last update, less the change of phi.

    ``D_s = sum_j -tau_j . (x_{j+1} - x_j) - (phi at the end - phi at the start)``, both phi with the ybar held then.
    It is exact for any device and any torque really applied, and needs no force sensor.

    Parameters
    ----------
    trusted_damping : a lower bound of the device's own damping on each axis [Ns/m], harvested too; 0 if unknown.
    resolution : of the encoder [m]: chatter of one count is not motion that a damper dissipates.
    """

    __slots__ = ("_resolution", "_trusted", "work")

    def __init__(self, trusted_damping: Vector, resolution: float = 0.0) -> None:
        self._resolution = resolution
        self._trusted = trusted_damping if any(trusted_damping) else None
        self.work: float = 0.0
        """Energy put in at the actuator's port since the last `take` [J]."""

    def hold(self, torque: Vector, start: Vector, end: Vector, period: float) -> float:
        """Count a torque [N] that was held for `period` [s] while the device moved from `start` to `end` [m].

        Returns the work put in at the actuator's port, ``-tau . dx``, plus that put into the trusted damping [J].
        """
        work: float = -sum(map(mul, torque, map(sub, end, start)))
        if self._trusted is not None and period > 0.0:
            low, high = tuple(map(min, start, end)), tuple(map(max, start, end))
            work += dissipated_by_range(self._trusted, low, high, period, self._resolution)
        self.work += work
        return work

    def take(self, potential_change: float) -> float:
        """D_s [J] since the last call, given the change of the spring's potential [J] over the same time."""
        harvested = self.work - potential_change
        self.work = 0.0
        return harvested


def damping_conditions(own_damping: Vector, K_diagonal: Vector, B: Vector, period: float) -> tuple[bool, bool]:
    """Does a sampled servo with the range harvest meet the (necessary, sufficient) condition to be passive?

    Necessary on each axis: ``b > K T/2``. Sufficient for any motion: ``b > K T/2 + 2 B``. b: the device's own damping.
    """
    triples = list(zip(own_damping, K_diagonal, B, strict=True))
    necessary = all(b > k * period / 2.0 for b, k, _ in triples)
    return necessary, all(b > k * period / 2.0 + 2.0 * damper for b, k, damper in triples)
