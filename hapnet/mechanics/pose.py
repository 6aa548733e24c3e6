"""A pose as twelve coordinates in metres: a point of a rigid body, and the ends of three arms that are fixed to it.

With the arms' length l, the point c and the rotation R, whose columns are the arms' directions,

    x = (c, l (R - I) e_1, l (R - I) e_2, l (R - I) e_3)

The origin is the pose at home. A spring of the same stiffness K along all twelve coordinates has the energy

    phi = K/2 |c - cbar|^2 + K l^2/2 |R - Rbar|^2 = K/2 |c - cbar|^2 + 2 K l^2 (1 - cos angle)

so its rotational stiffness is ``2 K l^2`` Nm/rad, and a damper B has ``2 B l^2`` Nms/rad. A force f along the
coordinates is the force f_c at the point, and the torque ``sum l R e_j x f_j``. So a set-position of a pose is an
ordinary set-position: PSPM, its reservoir, all laws, filters and messages are unchanged. As all coordinates have the
same stiffness, the nearest set-position that the energy allows lies on the straight line to the received one: the
projection in the energy metric, with one share for position and orientation. A modulated set-position need not be a
pose. No angle has a jump or a singularity: at 180 degrees the torque is 0, and on either side it turns back.

The arms' ends are the natural coordinates, or directors, of a rigid body (Betsch, Steinmann, Int. J. Numer. Meth. Engng
51, 2001).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hapnet import checks
from hapnet.checks import Array, Vector
from hapnet.records.record import Floats, Reals, equation
from hapnet.units import POSE_AXES

AXES = POSE_AXES
"""The number of coordinates of a pose."""

DOF = 6
"""The degrees of freedom of a rigid body."""

ARM_M = 0.04
"""The length l of the arms: a hand's size, so that a hand's stiffness K_h suits rotations as well."""

OfPose = Annotated[Floats, (AXES,)]
Of3 = Annotated[Floats, (3,)]

Quaternion = tuple[float, float, float, float]
"""w, x, y, z."""


class Pose(NamedTuple):
    """A place (3,) [m] and an orientation (w, x, y, z)."""

    position: Vector
    quaternion: Quaternion


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


def rotation(x: ArrayLike, arm_m: float = ARM_M) -> Array:
    """The rotations (..., 3, 3) nearest to the arms at x (..., 12) [m]: their polar decomposition; NaN where x is."""
    arms = np.asarray(x, dtype=float)[..., 3:] / arm_m
    known = np.asarray(np.isfinite(arms).all(axis=-1))
    arms = np.where(known[..., None], arms, 0.0).reshape(*arms.shape[:-1], 3, 3)
    left, _, right = np.linalg.svd(np.eye(3) + np.swapaxes(arms, -1, -2))
    left[..., 2] *= np.sign(np.linalg.det(left @ right))[..., None]
    turn: Array = np.where(known[..., None, None], left @ right, np.nan)
    return turn


def nearest(x: ArrayLike, arm_m: float = ARM_M) -> Vector:
    """The coordinates (12,) [m] of the pose nearest to x (12,) [m]; a modulated set-position is not a pose."""
    position: Vector = tuple(np.asarray(x, dtype=float)[:3].tolist())
    return (*position, *(arm_m * (rotation(x, arm_m).T - np.eye(3))).ravel().tolist())


def pose(x: ArrayLike, arm_m: float = ARM_M) -> Pose:
    """The pose at x (12,) [m], or the nearest pose if x is not a pose."""
    w, i, j, k = quaternions(rotation(x, arm_m)).tolist()
    return Pose(tuple(np.asarray(x, dtype=float)[:3].tolist()), (w, i, j, k))


def of_rotation_vector(rotation: Sequence[float]) -> tuple[float, float, float, float]:
    """The unit quaternion w, x, y, z of a rotation vector (3,) [rad]: axis times angle."""
    angle = math.sqrt(rotation[0] ** 2 + rotation[1] ** 2 + rotation[2] ** 2)
    share = 0.5 if angle < 1e-9 else math.sin(0.5 * angle) / angle
    return math.cos(0.5 * angle), share * rotation[0], share * rotation[1], share * rotation[2]


def quaternions(R: Array) -> Array:
    """The quaternions (..., 4) of rotations (..., 3, 3), with w >= 0 (Shepperd, J. Guidance and Control 1, 1978)."""
    xx, yy, zz = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    wx, wy, wz = R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]
    yz, zx, xy = R[..., 2, 1] + R[..., 1, 2], R[..., 0, 2] + R[..., 2, 0], R[..., 1, 0] + R[..., 0, 1]
    products = np.array([  # 4 q q^T: each row is q times a number, best known where that is largest
        [1.0 + xx + yy + zz, wx, wy, wz],
        [wx, 1.0 + xx - yy - zz, xy, zx],
        [wy, xy, 1.0 - xx + yy - zz, yz],
        [wz, zx, yz, 1.0 - xx - yy + zz],
    ])  # fmt: skip
    largest = np.argmax(np.einsum("ii...->i...", products), axis=0)
    q = np.take_along_axis(np.moveaxis(products, (0, 1), (-2, -1)), largest[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.asarray(np.where(q[..., :1] < 0.0, -q, q))


def rotation_vectors(x: ArrayLike, arm_m: float = ARM_M) -> Array:
    """The rotation vectors (..., 3) [rad] of poses x (..., 12) [m]: axis times angle, 0 to pi."""
    q = quaternions(rotation(x, arm_m))
    size = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    ratio = np.where(size > 0.0, 2.0 * np.arctan2(size, q[..., :1]) / np.where(size, size, 1.0), 2.0)
    return np.asarray(q[..., 1:] * ratio)


def angles_between(one: ArrayLike, other: ArrayLike, arm_m: float = ARM_M) -> Array:
    """The angles (...) between the orientations of poses (..., 12) [m]; 0 to pi [rad]."""
    turn = np.swapaxes(rotation(one, arm_m), -1, -2) @ rotation(other, arm_m)
    off = [turn[..., i, j] - turn[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0))]
    return np.asarray(np.arctan2(np.linalg.norm(off, axis=0), np.trace(turn, axis1=-2, axis2=-1) - 1.0))


def angle_between(one: ArrayLike, other: ArrayLike, arm_m: float = ARM_M) -> float:
    """The angle between the orientations of two poses (12,) [rad]."""
    return float(angles_between(one, other, arm_m))


def arms(x: ArrayLike, arm_m: float = ARM_M) -> Array:
    """The arms P_j at x (..., 12) [m], a row each (..., 3, 3)."""
    ends = np.asarray(x, dtype=float)[..., 3:]
    rods: Array = arm_m * np.eye(3) + ends.reshape(*ends.shape[:-1], 3, 3)
    return rods


def torques(x: ArrayLike, f: ArrayLike, arm_m: float = ARM_M) -> Array:
    """The torques (..., 3) [Nm] of forces f (..., 12) [N] along the coordinates at x (..., 12) [m], as by `turning`."""
    rods = arms(x, arm_m)
    torque: Array = np.cross(rods, np.asarray(f, dtype=float)[..., 3:].reshape(rods.shape)).sum(axis=-2)
    return torque


def wrench(x: Sequence[float], f: Sequence[float], arm_m: float = ARM_M) -> tuple[Vector, Vector]:
    """Force (3,) [N] and torque (3,) [Nm] about the point, of a force f (12,) [N] along the coordinates at x (12,)."""
    out = [0.0] * 3
    turning(x, f, arm_m, out)
    return tuple([float(part) for part in f[:3]]), tuple(out)


def along_coordinates(x: Sequence[float], force: Sequence[float], torque: Sequence[float], arm_m: float) -> Vector:
    """The smallest force (12,) [N] along the coordinates at x (12,) with this force [N] and torque [Nm]."""
    turned = np.cross(np.asarray(torque, dtype=float), arms(x, arm_m)) / (2.0 * arm_m * arm_m)
    return (*[float(part) for part in force], *turned.ravel().tolist())


def along_motion(
    x0: Sequence[float], x1: Sequence[float], force: Sequence[float], torque: Sequence[float], arm_m: float
) -> Vector:
    """The smallest force (12,) [N] along the coordinates that does the work of this force [N] on the point's motion
    from x0 to x1 (12,), and of this torque [Nm] on `turned`."""
    rods = 0.5 * (arms(x0, arm_m) + arms(x1, arm_m))
    inverse = np.linalg.inv(np.sum(rods * rods) * np.eye(3) - rods.T @ rods)
    pushes = np.cross(inverse @ np.asarray(torque, dtype=float), rods)
    return (*[float(part) for part in force], *pushes.ravel().tolist())


def turned(R0: Array, R1: Array) -> Array:
    """The turn from R0 to R1 (3, 3) as Cayley's vector (3,) [rad], ``2 tan(angle/2)`` long: ``R1 = cay(turned) R0``.

    The ends of the arms move by ``turned x Pm``, Pm their mean from R0 to R1, exactly.
    """
    turn = R1 @ R0.T
    skew = turn - turn.T
    found: Array = np.array([skew[2, 1], skew[0, 2], skew[1, 0]]) * (2.0 / (1.0 + np.trace(turn)))
    return found


@equation
def arm(x: Reals, arm_m: float, j: int) -> tuple[float, float, float]:
    """The arm P_j at x (12,) [m]."""
    i = 3 + 3 * j
    return (
        x[i] + (arm_m if j == 0 else 0.0),
        x[i + 1] + (arm_m if j == 1 else 0.0),
        x[i + 2] + (arm_m if j == 2 else 0.0),
    )


@equation
def in_world(x: Reals, arm_m: float, a: Reals) -> tuple[float, float, float]:
    """R a: a vector (3,) given in the body's axes, converted to the world's, ``sum a_j P_j/l``."""
    p, q, r = 0.0, 0.0, 0.0
    for j in range(3):
        share = a[j] / arm_m
        rod = arm(x, arm_m, j)
        p, q, r = p + share * rod[0], q + share * rod[1], r + share * rod[2]
    return p, q, r


@equation
def cross(a: Reals, b: Reals) -> tuple[float, float, float]:
    """``a x b``."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@equation
def turning(x: Reals, f: Reals, arm_m: float, out: Floats) -> None:
    """The torque [Nm] of f (12,) [N] at x (12,) [m]: ``sum P_j x f_j`` over the arms P_j."""
    out[0] = out[1] = out[2] = 0.0
    for j in range(3):
        i, (a, b, c) = 3 + 3 * j, arm(x, arm_m, j)
        out[0] = out[0] + (b * f[i + 2] - c * f[i + 1])
        out[1] = out[1] + (c * f[i] - a * f[i + 2])
        out[2] = out[2] + (a * f[i + 1] - b * f[i])


def quaternion(rows: Sequence[Sequence[float]]) -> Vector:
    """The unit quaternion w, x, y, z of a rotation matrix, from its largest component, so that no digits cancel."""
    (a, b, c), (d, e, f), (g, h, i) = rows
    squares = (1.0 + a + e + i, 1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i)
    table = (
        (squares[0], h - f, c - g, d - b),
        (h - f, squares[1], b + d, c + g),
        (c - g, b + d, squares[2], f + h),
        (d - b, c + g, f + h, squares[3]),
    )
    row = table[max(range(4), key=squares.__getitem__)]
    length = math.hypot(*row)
    return tuple([part / length for part in row])
