"""A hand that turns what it holds: another hand's motion, with an orientation beside it."""

from __future__ import annotations

from math import cos, pi, sin, sqrt

from hapnet import checks
from hapnet.checks import Vector
from hapnet.mechanics.pose import ARM_M, coordinates
from hapnet.plant.live_hand import LiveHand, WrappedHand
from hapnet.plant.operator import Impedance, Operator, minimum_jerk

RATES = (1.0, 0.73, 0.59)
"""Of the three components of the rotation, in units of the frequency: no multiples of each other."""

_START_S = 1.0
"""The hand begins to turn over so long a time."""


class TurningHand(WrappedHand):
    """An operator of poses: its point follows `hand`, and it turns about all three axes.

    Its impedance along the pose's coordinates is that of `hand`, so K_h turns with ``2 K_h l^2`` Nm/rad.

    hand : of three axes; one that a mouse leads does not turn. turn_rad : amplitude of each component of the rotation
        vector [rad]. turn_hz : the frequency of the first. arm_m : l [m].
    """

    def __init__(self, hand: Operator, turn_rad: float, turn_hz: float, arm_m: float = ARM_M) -> None:
        self.impedance: Impedance = hand.impedance
        self.hand, self._arm_m = hand, arm_m
        self._turn = 0.0 if isinstance(hand, LiveHand) else checks.non_negative("operator_hand.turn_rad", turn_rad)
        self._omega = 2.0 * pi * checks.non_negative("operator_hand.turn_hz", turn_hz)

    def reference(self, t: float) -> Vector:
        """The pose (12,) [m] at t [s]."""
        share = self._turn * minimum_jerk(t / _START_S)
        return turned(
            self.hand.reference(t), tuple([share * sin(self._omega * rate * t) for rate in RATES]), self._arm_m
        )


def turned(position: Vector, rotation: Vector, arm_m: float = ARM_M) -> Vector:
    """The coordinates (12,) [m] of the pose at `position` (3,) [m], turned by a rotation vector (3,) [rad]."""
    angle = sqrt(rotation[0] ** 2 + rotation[1] ** 2 + rotation[2] ** 2)
    share = 0.5 if angle < 1e-9 else sin(0.5 * angle) / angle
    return coordinates(position, (cos(0.5 * angle), *[share * part for part in rotation]), arm_m)
