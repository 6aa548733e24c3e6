"""A hand's tremor: 8 to 12 Hz (Deuschl, Bain, Brin 1998), a few tenths of a millimetre."""

from __future__ import annotations

from math import pi, sin

from hapnet.checks import Vector
from hapnet.plant.operator import Impedance, Operator
from hapnet.records.vectors import added

HERTZ = (8.3, 9.4, 10.7, 11.9)
"""No multiples of each other, so that the tremor waxes and wanes."""


class Tremor:
    """An operator whose reference trembles along every axis.

    hand : the operator. amplitude : maximum distance from its reference, on each axis [m].
    """

    def __init__(self, hand: Operator, amplitude: float) -> None:
        self.impedance: Impedance = hand.impedance
        self._hand = hand
        self._each = amplitude / len(HERTZ)

    def reference(self, t: float) -> Vector:
        """Where the hand aims at time t [s], (n,) [m]."""
        intended = self._hand.reference(t)
        return tuple(
            [
                x + self._each * added([sin(2.0 * pi * f * t + axis + f) for f in HERTZ])
                for axis, x in enumerate(intended)
            ]
        )
