"""A pose as twelve coordinates in metres: a point of a rigid body, and the ends of three arms that are fixed to it.

With the arms' length l, the point c and the rotation R, whose columns are the arms' directions,

    x = (c, l (R - I) e_1, l (R - I) e_2, l (R - I) e_3)

The origin is the pose at home. A spring of the same stiffness K along all twelve coordinates has the energy

    phi = K/2 |c - cbar|^2 + K l^2/2 |R - Rbar|^2 = K/2 |c - cbar|^2 + 2 K l^2 (1 - cos angle)

so it turns with ``2 K l^2`` Nm/rad, a damper B with ``2 B l^2`` Nms/rad. A force f along the coordinates is the force
f_c at the point, and the torque ``sum l R e_j x f_j``. So a set-position of a pose is a set-position as any other:
PSPM, its reservoir, all laws, filters and messages stay as they are. As all coordinates have the same stiffness, the
nearest set-position that the energy allows lies on the straight line to the received one: the projection in the energy
metric, with one share for position and orientation. A modulated set-position is no pose; it need not be one. No angle
has a jump or a singularity: at 180 degrees the torque is 0, and it leads back on both sides.

The arms' ends are the natural coordinates, or directors, of a rigid body (Betsch, Steinmann, Int. J. Numer. Meth. Engng
51, 2001).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np

from hapnet import checks
from hapnet.checks import Array, Vector
from hapnet.records.equation import equation
from hapnet.records.record import FloatRows, Floats, Reals

AXES = 12
"""So many coordinates has a pose."""

DOF = 6
"""So many degrees of freedom has a rigid body."""

ARM_M = 0.04
"""The length l of the arms: of a hand's size, so that a hand that follows a motion with K_h turns as it does."""

OfPose = Annotated[Floats, (AXES,)]
Of3 = Annotated[Floats, (3,)]
Matrix3 = Annotated[FloatRows, (3, 3)]

Quaternion = tuple[float, float, float, float]
"""w, x, y, z."""


class Pose(NamedTuple):
    """A place (3,) [m] and an orientation (w, x, y, z)."""

    position: Vector
    quaternion: Quaternion


def is_pose(dof: int) -> bool:
    """Are so many coordinates those of a pose?"""
    return dof == AXES


def coordinates(position: Sequence[float], quaternion: Sequence[float], arm_m: float = ARM_M) -> Vector:
    """The twelve coordinates [m] of a pose; the quaternion (w, x, y, z) need not be of unit length.

    Raises InvalidParameter: a number is not finite, or the quaternion is 0.
    """
    c = checks.vector("position", position, 3)
    q = np.array(checks.vector("quaternion", quaternion, 4))
    w, x, y, z = (q / checks.positive("the quaternion's length", float(np.linalg.norm(q)))).tolist()
    columns = (
        (-2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        (2.0 * (x * y - w * z), -2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), -2.0 * (x * x + y * y)),
    )
    return (*c, *[arm_m * part for column in columns for part in column])


def rotation(x: Sequence[float], arm_m: float = ARM_M) -> Array:
    """The rotation (3, 3) nearest to the arms at x (12,) [m]: their polar decomposition."""
    matrix = np.eye(3) + np.reshape(np.asarray(x, dtype=float)[3:], (3, 3)).T / arm_m
    left, _, right = np.linalg.svd(matrix)
    turn: Array = left @ np.diag([1.0, 1.0, math.copysign(1.0, float(np.linalg.det(left @ right)))]) @ right
    return turn


def pose(x: Sequence[float], arm_m: float = ARM_M) -> Pose:
    """The pose at x (12,) [m], or the one whose orientation is nearest to it."""
    return Pose(tuple([float(part) for part in x[:3]]), quaternion_of(rotation(x, arm_m)))


def quaternion_of(R: Array) -> Quaternion:
    """The quaternion of a rotation (3, 3), with w >= 0 (Shepperd, J. Guidance and Control 1, 1978)."""
    squares = np.array([np.trace(R), R[0, 0], R[1, 1], R[2, 2]])
    i = int(np.argmax(squares))
    if i == 0:
        q = np.array([1.0 + squares[0], R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    else:
        a, b, c = i - 1, i % 3, (i + 1) % 3
        q = np.zeros(4)
        q[0] = R[c, b] - R[b, c]
        q[1 + a] = 1.0 + R[a, a] - R[b, b] - R[c, c]
        q[1 + b], q[1 + c] = R[b, a] + R[a, b], R[c, a] + R[a, c]
    q = q / np.linalg.norm(q)
    if q[0] < 0.0:
        q = -q
    w, x, y, z = q.tolist()
    return w, x, y, z


def angle_between(one: Sequence[float], other: Sequence[float], arm_m: float = ARM_M) -> float:
    """The angle between the orientations of two poses (12,) [m]; 0 to pi [rad]."""
    turn = rotation(one, arm_m).T @ rotation(other, arm_m)
    off = math.hypot(turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1])
    return math.atan2(off, float(np.trace(turn)) - 1.0)


def wrench(x: Sequence[float], f: Sequence[float], arm_m: float = ARM_M) -> tuple[Vector, Vector]:
    """Force (3,) [N] and torque (3,) [Nm] about the point, of a force f (12,) [N] along the coordinates at x (12,)."""
    out = [0.0] * 3
    turning(x, f, arm_m, out)
    return tuple([float(part) for part in f[:3]]), tuple(out)


def along_coordinates(x: Sequence[float], force: Sequence[float], torque: Sequence[float], arm_m: float) -> Vector:
    """The smallest force (12,) [N] along the coordinates at x (12,) that is this force [N] and torque [Nm]."""
    arms = arm_m * np.eye(3) + np.reshape(np.asarray(x, dtype=float)[3:], (3, 3))
    turned = np.cross(np.asarray(torque, dtype=float), arms) / (2.0 * arm_m * arm_m)
    return (*[float(part) for part in force], *turned.ravel().tolist())


@equation
def turning(x: Reals, f: Reals, arm_m: float, out: Floats) -> None:
    """The torque [Nm] of f (12,) [N] at x (12,) [m]: ``sum P_j x f_j`` over the arms P_j."""
    out[0] = out[1] = out[2] = 0.0
    for j in range(3):
        i = 3 + 3 * j
        a, b, c = x[i], x[i + 1], x[i + 2]
        if j == 0:
            a += arm_m
        elif j == 1:
            b += arm_m
        else:
            c += arm_m
        out[0] = out[0] + (b * f[i + 2] - c * f[i + 1])
        out[1] = out[1] + (c * f[i] - a * f[i + 2])
        out[2] = out[2] + (a * f[i + 1] - b * f[i])
