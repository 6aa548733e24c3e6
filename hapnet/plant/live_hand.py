"""A simulated hand that the user guides during the run, for example with a mouse."""

from __future__ import annotations

from math import exp

from hapnet import checks
from hapnet.checks import Vector
from hapnet.plant.operator import Impedance, Operator
from hapnet.units import POSE_AXES


class LiveHand:
    """Follows the positions given to `lead` smoothly, although they are irregular and jump.

    A critically damped filter of second order, ``tau^2 x_d'' + 2 tau x_d' + x_d = goal``, smooths them. It is solved
    exactly for a goal that is constant within each tick. Steps at 20 Hz become a motion without steps, 2 `tau` later.

    start : where the hand begins [m], shape (n,). tau : the filter's time constant [s].
    """

    def __init__(self, start: Vector, impedance: Impedance, tau: float = 0.03) -> None:
        self.impedance = impedance
        self._tau = checks.positive("tau", tau)
        self._goal = self._position = start
        self._velocity: Vector = (0.0,) * len(start)
        self._t = 0.0

    def lead(self, position: Vector) -> None:
        """Move towards `position` [m] from now on; may be called on any thread.

        Raises InvalidParameter if it is not n finite numbers.
        """
        self._goal = checks.vector("position", position, len(self._goal))

    def place(self, position: Vector) -> None:
        """Be at rest at `position` [m], of a pose at its point, at once; before the first tick.

        Raises InvalidParameter as `lead` does.
        """
        self.lead(position[: len(self._goal)] if len(position) == POSE_AXES else position)
        self._position = self._goal

    def reference(self, t: float) -> Vector:
        """x_d [m] at `t` [s]; t never decreases from call to call."""
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


class WrappedHand:
    """A hand that follows another one, `hand`, and adds something to its motion."""

    hand: Operator


def live_hand_of(hand: Operator) -> LiveHand | None:
    """The hand that the user guides: `hand` itself, or the hand that it wraps; None: the user guides neither."""
    moving = hand.hand if isinstance(hand, WrappedHand) else hand
    return moving if isinstance(moving, LiveHand) else None
