"""Frames of links and joints, as a URDF gives them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hapnet.checks import Array, Vector


class JointFrame(NamedTuple):
    """A frame in another frame: rotation (3, 3) and place (3,) [m]."""

    turned: Array
    place: Array

    def then(self, inner: JointFrame) -> JointFrame:
        """The frame `inner`, given in this frame, in the outer one."""
        return JointFrame(self.turned @ inner.turned, self.place + self.turned @ inner.place)


SAME = JointFrame(np.eye(3), np.zeros(3))


def moved(axis: Vector, value: float, *, slides: bool) -> JointFrame:
    """The frame of a joint's link in the joint's frame: turned by a value [rad], or shifted by it [m], along an axis of
    any length (Rodrigues' formula)."""
    direction = np.array(axis) / (np.linalg.norm(axis) or 1.0)
    if slides:
        return JointFrame(np.eye(3), value * direction)
    x, y, z = direction
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return JointFrame(np.eye(3) + math.sin(value) * K + (1.0 - math.cos(value)) * K @ K, np.zeros(3))


def angles_of(R: Array) -> Vector:
    """Roll, pitch and yaw of a rotation; if the pitch is a quarter turn, yaw is 0."""
    across = math.hypot(R[0, 0], R[1, 0])
    if across < 1e-9:
        return math.copysign(1.0, -R[2, 0]) * math.atan2(R[0, 1], R[1, 1]), math.atan2(-R[2, 0], across), 0.0
    return math.atan2(R[2, 1], R[2, 2]), math.atan2(-R[2, 0], across), math.atan2(R[1, 0], R[0, 0])
