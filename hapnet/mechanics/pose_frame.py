"""The frame of a device with orientation: offset and rotated, scaled in motion and in force; angles are not scaled.

A rotation Q mixes the pose's arms P_j (`hapnet.mechanics.pose`): the device's arms are ``P_d,j = a sum_i Q_ij P_i``, so
its orientation is R_d = R Q. A turn about an axis of the world is the same turn about the same axis of the device,
however both were held when they were paired. The map of the coordinates is linear, and orthogonal up to the factor a.

Motion is scaled by a, but angles are not. So if both devices have arms of the same length l, the arms are not scaled:

    x_d = S Q x + o,   F = (b/a) Q' S F_d,   S = diag(a, a, a, 1, ... 1)

Work has the factor b/a along all coordinates, so the point's force has the factor b, and torque b/a; a stiffness K_d
of the device is ``a b K_d`` at the point and ``b/a K_d`` in rotation. With arms of the length l/a in the coupling, a is
a factor of all coordinates, and a servo's limits (force, step, speed, reserve) keep their meaning. So the coupling at
the device uses arms of the length l/a, and `Arms` converts between these coordinates and those of the link.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.mechanics.frame import Frame
from hapnet.mechanics.plane import Plane
from hapnet.mechanics.pose import ARM_M, AXES, rotation


class Arms(NamedTuple):
    """Conversion to arms that are `times` as long: the coordinates of their ends are multiplied by `times`, and forces
    there divided by it. Work, torque, and all angles stay the same."""

    times: float

    @property
    def back(self) -> Arms:
        """The inverse."""
        return Arms(1.0 / self.times)

    def place(self, x: Vector) -> Vector:
        """Convert a pose's coordinates (12,) [m], or their rates."""
        return (*x[:3], *[self.times * part for part in x[3:]])

    def force(self, f: Vector) -> Vector:
        """Convert a force (12,) [N] along the coordinates."""
        return (*f[:3], *[part / self.times for part in f[3:]])

    def plane(self, plane: Plane) -> Plane:
        """Convert a flat plane; its normal is scaled to unit length again, and its other numbers accordingly."""
        normal = self.force(plane.normal)
        size = math.hypot(*normal)
        return Plane(
            tuple([part / size for part in normal]),
            plane.offset_m / size,
            plane.stiffness * size * size,
            plane.damping * size * size,
            plane.velocity_mps / size,
            friction=plane.friction,
        )


class PoseFrame(Frame):
    """A `Frame` in the twelve coordinates of a pose, with the rotation Q.

    motion, force : a, b. arm_m : the length of the device's arms; the coupling's are l/a [m].
    """

    def __init__(self, motion: float, force: float, arm_m: float = ARM_M) -> None:
        super().__init__(motion, force, (0.0,) * AXES)
        self._arm_m = arm_m
        self._turn: Array | None = None  # Q; None: the identity, which leaves every bit unchanged

    @property
    def is_one(self) -> bool:
        return self._turn is None and super().is_one

    def own(self, x: Sequence[float]) -> Vector:
        return super().own(self._turned(x))

    def coupled(self, own: Sequence[float]) -> Vector:
        return self._turned(super().coupled(own), back=True)

    def meet(self, own: Sequence[float], x: Sequence[float]) -> None:
        """Choose o and Q so that the device's own pose `own` is x [m]; x is a pose, or is treated as the nearest."""
        super().meet(own, x)
        Q = rotation(x, self._arm_m / self.motion).T @ rotation(own, self._arm_m)
        self._turn = None if np.abs(Q - np.eye(3)).max() < 1e-12 else Q
        arms = np.zeros((3, 3)) if self._turn is None else self._arm_m * (Q.T - np.eye(3))
        self.offset = (*self.offset[:3], *arms.ravel().tolist())

    def reach(self, reach_m: float) -> float:
        """Convert a distance [m] for translation or rotation, whichever is larger: angles are not scaled."""
        return max(1.0, self.motion) * reach_m

    def velocity(self, own: Sequence[float]) -> Vector:
        return self._turned(super().velocity(own), back=True)

    def own_force(self, force: Vector) -> Vector:
        return super().own_force(self._turned(force))

    def coupled_force(self, own: Vector) -> Vector:
        return self._turned(super().coupled_force(own), back=True)

    def plane(self, plane: Plane) -> Plane:
        """Convert a plane as `Frame` does, and rotate its normal."""
        scaled = super().plane(plane)
        return scaled if self._turn is None else scaled._replace(normal=self._turned(scaled.normal, back=True))

    def _turned(self, x: Sequence[float], *, back: bool = False) -> Vector:
        """Return the coordinates with the arms mixed by Q, or by its inverse."""
        if self._turn is None:
            return tuple(x)
        arms = np.asarray(x[3:]).reshape(3, 3)  # a row is an arm
        return (*x[:3], *((self._turn if back else self._turn.T) @ arms).ravel().tolist())
