"""A simulated hand that is led while it runs, by a mouse for instance."""

from __future__ import annotations

from math import exp

from hapnet import checks
from hapnet.checks import Vector
from hapnet.plant.operator import Impedance


class LiveHand:
    """Follows the positions that `lead` gives, which come now and then and jump; a hand does neither.

    Between them stands a critically damped filter of second order, ``tau^2 x_d'' + 2 tau x_d' + x_d = goal``, solved
    exactly for a goal that stands still from tick to tick: steps at 20 Hz come out as a motion without steps, 2 `tau`
    later.

    Parameters
    ----------
    start : where the hand begins [m], shape (n,). tau : the filter's time constant [s].
    """

    def __init__(self, start: Vector, impedance: Impedance, tau: float = 0.03) -> None:
        self.impedance = impedance
        self._tau = checks.positive("tau", tau)
        self._goal = self._position = start
        self._velocity: Vector = (0.0,) * len(start)
        self._t = 0.0

    def lead(self, position: Vector) -> None:
        """Go to `position` [m] from now on; from any thread. InvalidParameter if it is not n finite numbers."""
        self._goal = checks.vector("position", position, len(self._goal))

    def reference(self, t: float) -> Vector:
        """x_d [m] at `t` [s]; called with t that never decreases."""
        h, self._t = t - self._t, t
        if h <= 0.0:
            return self._position
        goal, rate = self._goal, 1.0 / self._tau
        decay = exp(-h * rate)
        position, velocity = [], []
        for x, v, g in zip(self._position, self._velocity, goal, strict=True):
            away = x - g
            slope = v + away * rate
            position.append(g + (away + slope * h) * decay)
            velocity.append((v - slope * h * rate) * decay)
        self._position, self._velocity = tuple(position), tuple(velocity)
        return self._position
