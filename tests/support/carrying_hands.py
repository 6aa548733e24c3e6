"""Hands that squeeze a block from two sides and carry it to and fro, and others that push it from all sides."""

from math import pi, sin

from hapnet.checks import Vector
from hapnet.plant.operator import Impedance

HALF_M = 0.03
"""Half of the block's size [m]."""


def smooth(t: float) -> float:
    """From 0 to 1 without a step of the acceleration."""
    t = min(max(t, 0.0), 1.0)
    return t * t * t * (10.0 - 15.0 * t + 6.0 * t * t)


class Carrier:
    """Begins 30 mm in front of a face of a block at the origin, comes to it, presses it, and carries it along x.

    The origin of its device is where it begins. axis, side : of the face. deep_m : how far behind the face it aims.
    """

    def __init__(self, axis: int, side: float, deep_m: float = 0.012) -> None:
        self.impedance = Impedance()
        self.axis, self.side, self.deep_m = axis, side, deep_m

    @property
    def at(self) -> list[float]:
        """Where its device's origin is in the world (3,) [m]."""
        return [self.side * (HALF_M + 0.03) if axis == self.axis else 0.0 for axis in range(3)]

    def reference(self, t: float) -> Vector:
        """x_d [m] at `t` [s]."""
        x = [0.0, 0.0, 0.0]
        x[self.axis] = -self.side * (0.03 + self.deep_m) * smooth((t - 0.5) / 1.5)
        x[0] += 0.03 * sin(2.0 * pi * 0.25 * (t - 3.0)) * smooth((t - 3.0) / 2.0) if t > 3.0 else 0.0
        return tuple(x)
