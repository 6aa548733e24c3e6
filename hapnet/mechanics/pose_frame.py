"""The frame of a device that turns: moved and turned, scaled in motion and in force; no angle is scaled.

A rotation Q mixes the pose's arms P_j (`hapnet.mechanics.pose`): the device's are ``P_d,j = a sum_i Q_ij P_i``, so its
orientation is R_d = R Q. A turn about an axis of the world is the same turn about the same axis of the device, however
differently both were held when they met. The map of the coordinates is linear, and orthogonal but for the factor a.

Its motion is scaled by a, and no angle is, so of two devices with arms of the same length l the arms are not scaled:

    x_d = S Q x + o,   F = (b/a) Q' S F_d,   S = diag(a, a, a, 1, ... 1)

Work has the factor b/a along all coordinates, so the point's force has the factor b, and torque b/a; a stiffness K_d
of the device is ``a b K_d`` at the point and ``b/a K_d`` in turning. That is the frame of one factor a, if the coupling
has arms of the length l/a: then all that a servo limits by a length (force, step, speed, reserve) keeps its meaning. So
that is how the coupling has it at the device, and `Arms` stands between these coordinates and those of the link.
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
    """A pose with arms `times` as long. So are the coordinates of their ends, and forces there so many times smaller:
    work, torque, and all angles are the same."""

    times: float

    @property
    def back(self) -> Arms:
        """The inverse."""
        return Arms(1.0 / self.times)

    def place(self, x: Vector) -> Vector:
        """A pose's coordinates (12,) [m], or their rates."""
        return (*x[:3], *[self.times * one for one in x[3:]])

    def force(self, f: Vector) -> Vector:
        """A force (12,) [N] along the coordinates."""
        return (*f[:3], *[one / self.times for one in f[3:]])

    def plane(self, plane: Plane) -> Plane:
        """A flat plane; its normal is of unit length in these coordinates too, so its numbers are others."""
        normal = self.force(plane.normal)
        size = math.hypot(*normal)
        return Plane(
            tuple([one / size for one in normal]),
            plane.offset_m / size,
            plane.stiffness * size * size,
            plane.damping * size * size,
            plane.velocity_mps / size,
            friction=plane.friction,
        )


class PoseFrame(Frame):
    """As `Frame` in the twelve coordinates of a pose, with the rotation Q.

    motion, force : a, b. arm_m : the length of the device's arms; the coupling's are l/a [m].
    """

    def __init__(self, motion: float, force: float, arm_m: float = ARM_M) -> None:
        super().__init__(motion, force, (0.0,) * AXES)
        self._arm_m = arm_m
        self._turn: Array | None = None  # Q; None: the identity, in which numbers keep their bits

    @property
    def is_one(self) -> bool:
        return self._turn is None and super().is_one

    def own(self, x: Sequence[float]) -> Vector:
        return super().own(self._turned(x))

    def coupled(self, own: Sequence[float]) -> Vector:
        return self._turned(super().coupled(own), back=True)

    def meet(self, own: Sequence[float], x: Sequence[float]) -> None:
        """Choose o and Q so that `own` is x [m], as far as x is a pose."""
        super().meet(own, x)
        Q = rotation(x, self._arm_m / self.motion).T @ rotation(own, self._arm_m)
        self._turn = None if np.abs(Q - np.eye(3)).max() < 1e-12 else Q
        arms = np.zeros((3, 3)) if self._turn is None else self._arm_m * (Q.T - np.eye(3))
        self.offset = (*self.offset[:3], *arms.ravel().tolist())

    def reach(self, reach_m: float) -> float:
        """No angle is scaled: a turn brings the device as near as it brings its leader."""
        return max(1.0, self.motion) * reach_m

    def velocity(self, own: Sequence[float]) -> Vector:
        return self._turned(super().velocity(own), back=True)

    def own_force(self, force: Vector) -> Vector:
        return super().own_force(self._turned(force))

    def coupled_force(self, own: Vector) -> Vector:
        return self._turned(super().coupled_force(own), back=True)

    def plane(self, plane: Plane) -> Plane:
        """Its normal turns with the coordinates, once its distance is that of the device's own."""
        found = super().plane(plane)
        return found if self._turn is None else found._replace(normal=self._turned(found.normal, back=True))

    def _turned(self, x: Sequence[float], *, back: bool = False) -> Vector:
        """Return the values of the arms, mixed by Q, or by its inverse."""
        if self._turn is None:
            return tuple(x)
        arms = np.asarray(x[3:]).reshape(3, 3)  # a row is an arm
        return (*x[:3], *((self._turn if back else self._turn.T) @ arms).ravel().tolist())
