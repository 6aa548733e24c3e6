"""The frame of a device that turns: moved and turned, and scaled in force.

With the pose's arms P_j (`hapnet.mechanics.pose`) and a rotation Q, the device's arms are
``P_d,j = sum_i Q_ij P_i``: its orientation is R_d = R Q. So a turn about an axis of the world is a turn about the same
axis of the device, however differently both were held when they met. The map of the coordinates is linear and
orthogonal, so it leaves work as it is. Angles are not scaled.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.mechanics.frame import Frame
from hapnet.mechanics.plane import Plane
from hapnet.mechanics.pose import ARM_M, AXES, rotation


class PoseFrame(Frame):
    """As `Frame` in the twelve coordinates of a pose, with the rotation Q; its motion is 1.

    force : b. arm_m : the length of the pose's arms [m].
    """

    def __init__(self, force: float, arm_m: float = ARM_M) -> None:
        super().__init__(1.0, force, (0.0,) * AXES)
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
        Q = rotation(x, self._arm_m).T @ rotation(own, self._arm_m)
        self._turn = None if np.abs(Q - np.eye(3)).max() < 1e-12 else Q
        point = [one - two for one, two in zip(own[:3], x[:3], strict=True)]
        arms = np.zeros((3, 3)) if self._turn is None else self._arm_m * (Q.T - np.eye(3))
        self.offset = (*point, *arms.ravel().tolist())

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
        """What the arms have, mixed by Q, or by its inverse."""
        if self._turn is None:
            return tuple(x)
        arms = np.asarray(x[3:]).reshape(3, 3)  # a row is an arm
        return (*x[:3], *((self._turn if back else self._turn.T) @ arms).ravel().tolist())
