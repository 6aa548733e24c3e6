"""How far a device reaches, how fast it moves and which stiffness it renders, as declared; and the watch that it does.

All are in metres, and the defaults are generous: they tell no device from another, but millimetres from metres. Whoever
knows a device better declares less, with a margin: beyond it no force is rendered any more.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from hapnet import checks
from hapnet.checks import Array, Vector
from hapnet.errors import InvalidParameter

WORKSPACE_M = 1e-3, 10.0
SPEED_MPS = 1e-2, 100.0
SOFTEST_MOST = 10.0
"""No device's greatest stiffness is less than that [N/m]: that would be one in N/mm."""

LATENCY_S = 0.005
"""How much older than it is a reading may be: a device that is asked often repeats itself, then jumps [s]."""

LEAST_MOTION_M = 1e-4
"""A recorded hand that moves at all moves by more [m]: one that holds still trembles by as much."""

_FAST = 3  # reported velocities in a row: a single one may be a division by a short time


@dataclass(frozen=True)
class OperatingRange:
    """What is declared.

    workspace : how far from its origin the device reaches, or on each axis, either way [m].
    speed : the greatest speed of the handle [m/s]. stiffness : the least and the greatest that it renders [N/m].
    """

    workspace: Vector
    speed: float
    stiffness: tuple[float, float]

    @property
    def reach(self) -> float:
        """The farthest that any point can be from the origin [m]."""
        return self.workspace[0] if len(self.workspace) == 1 else math.hypot(*self.workspace)

    def outside(self, x: Sequence[float]) -> str | None:
        """Where `x` [m] is, in words, if that is outside of the workspace."""
        if len(self.workspace) == 1:
            far, most = math.hypot(*x), self.workspace[0]
            where = ""
        else:
            axis = max(range(len(x)), key=lambda i: abs(x[i]) / self.workspace[i])
            far, most = abs(x[axis]), self.workspace[axis]
            where = f" on axis {'xyz'[axis] if axis < 3 else axis}"
        if far <= most:
            return None
        return (
            f"it reads {far:.4g} m from its origin{where}, its workspace ends at {most:g} m{in_millimetres(far, most)}"
        )

    def check_stiffness(self, name: str, stiffness: ArrayLike, dof: int) -> None:
        """Raise InvalidParameter if K [N/m] is softer or stiffer, in any direction, than what is declared."""
        values = np.linalg.eigvalsh(checks.spd(name, stiffness, dof))
        least, most = self.stiffness
        if values[0] < least * (1.0 - 1e-9) or values[-1] > most * (1.0 + 1e-9):
            allowed = f"{least:g} to {most:g} N/m in every direction, what the device renders (device.stiffness_range)"
            raise InvalidParameter(name, stiffness, allowed)


Told = tuple[str, object]
"""What the user calls it, and what was given."""


def operating_range(dof: int, workspace: Told, speed: Told, stiffness: Told) -> OperatingRange:
    """What is declared for a device of so many axes.

    Raises
    ------
    InvalidParameter : a number that is none, or as only another unit makes it.
    """
    return OperatingRange(_workspace(*workspace, dof), _speed(*speed), _stiffness(*stiffness))


def in_millimetres(value: float, most: float) -> str:
    """A hint, if `value` in thousandths would be at most that."""
    return " (are these millimetres?)" if 2.0 * most < value <= 1000.0 * most else ""


class RangeWatch:
    """Looks at every reading of a device that runs; the first one that cannot be is the last that counts.

    declared : of the device. resolution : of its encoders [m]. position : the first that it gave [m].
    """

    def __init__(self, declared: OperatingRange, resolution: float, position: Vector) -> None:
        self._declared = declared
        self._count = resolution * math.sqrt(len(position))
        self._last = position
        self._fast = 0
        self.why: str | None = None
        """What was wrong, in words; None: nothing so far."""

    def passes(self, dt: float, x: Vector, v: Vector) -> bool:
        """Can this be, `dt` seconds after the reading before it?"""
        if self.why is None:
            self.why = self._look(dt, x, v)
            self._last = x
        return self.why is None

    def _look(self, dt: float, x: Vector, v: Vector) -> str | None:
        declared = self._declared
        if (where := declared.outside(x)) is not None:
            return where
        most = f"its greatest speed is {declared.speed:g} m/s"
        way = math.dist(x, self._last) - self._count
        if way > declared.speed * (dt + LATENCY_S):
            return f"it reads a way of {way:.4g} m in {dt * 1e3:.3g} ms, {most}"
        speed = math.hypot(*v)
        self._fast = self._fast + 1 if speed > declared.speed else 0
        return f"it reads a velocity of {speed:.4g} m/s, {most}" if self._fast >= _FAST else None


def check_motion(name: str, path: Array, reach: float) -> None:
    """Raise InvalidParameter unless a recorded hand can be one: `path` [m], (N, n), in a workspace of `reach`."""
    far = float(np.abs(path).max())
    if far > reach:
        allowed = f"positions in m, within the {reach:g} m that the device reaches (device.workspace_m); these go to"
        raise InvalidParameter("operator", name, f"{allowed} {far:.4g}{in_millimetres(far, reach)}")
    moved = float(np.ptp(path, axis=0).max())
    if 0.0 < moved < LEAST_MOTION_M:
        raise InvalidParameter("operator", name, f"positions in m; these move by {moved:.2g} in all (are these km?)")


def _workspace(name: str, value: object, dof: int) -> Vector:
    low, high = WORKSPACE_M
    words = f"{low:g} to {high:g} m from the origin, or so on each of {dof} axes"
    found = checks.vector(name, cast(ArrayLike, value))
    if len(found) not in (1, dof) or min(found) < low or max(found) > high:
        raise InvalidParameter(name, value, words + in_millimetres(max(found), high))
    return found


def _speed(name: str, value: object) -> float:
    low, high = SPEED_MPS
    (found, *more) = checks.vector(name, cast(ArrayLike, value))
    if more or not low <= found <= high:
        raise InvalidParameter(name, value, f"{low:g} to {high:g} m/s")
    return found


def _stiffness(name: str, value: object) -> tuple[float, float]:
    least, most = checks.vector(name, cast(ArrayLike, value), 2)
    if not 0.0 <= least < most or most < SOFTEST_MOST:
        raise InvalidParameter(name, value, f"the least stiffness and the greatest, {SOFTEST_MOST:g} N/m or more")
    return least, most
