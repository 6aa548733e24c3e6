"""The declared workspace, maximum speed and stiffness range of a device; and the check of its readings against them.

All are in SI units. The defaults are generous: they fit no particular device, but detect millimetres given as metres.
If you know a device better, declare smaller values with a margin: outside of them the force is switched off.
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
from hapnet.mechanics.encoders import rounding

WORKSPACE_M = 1e-3, 10.0
SPEED_MPS = 1e-2, 100.0
SOFTEST_MOST = 10.0
"""A smaller maximum stiffness is refused [N/m]: it must have been given in N/mm."""

LATENCY_S = 0.005
"""Largest age of a reading [s]: a device that is read often repeats a reading, then jumps."""

MIN_MOTION_M = 1e-4
"""Smallest motion of a recorded hand that moves at all [m]: even the tremor of a still hand is larger."""

_FAST = 3  # consecutive velocities that must be too high: a single one may come from a division by a short time


@dataclass(frozen=True)
class OperatingRange:
    """The declared range of a device.

    workspace : the device's reach from its origin, in all directions or on each axis [m].
    speed : maximum speed of the handle [m/s]. stiffness : smallest and largest that it renders [N/m].
    """

    workspace: Vector
    speed: float
    stiffness: tuple[float, float]

    @property
    def reach(self) -> float:
        """Largest distance of any point of the workspace from the origin [m]."""
        return self.workspace[0] if len(self.workspace) == 1 else math.hypot(*self.workspace)

    def outside(self, x: Sequence[float]) -> str | None:
        """A message that `x` [m] is outside the workspace; None if it is inside."""
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

    def check_stiffness(
        self, name: str, stiffness: ArrayLike, dof: int, unit: str = "N/m", declared_by: str = ""
    ) -> None:
        """Raise InvalidParameter if K [N/m] is softer or stiffer than declared, in any direction.

        unit : of K. declared_by : the parameter that declares it; empty: the device itself does.
        """
        values = np.linalg.eigvalsh(checks.spd(name, stiffness, dof))
        minimum, most = self.stiffness
        if values[0] < minimum * (1.0 - 1e-9) or values[-1] > most * (1.0 + 1e-9):
            renders = f"{minimum:g} to {most:g} {unit} in every direction, as the device renders"
            raise InvalidParameter(name, stiffness, f"{renders} ({declared_by})" if declared_by else renders)


NamedValue = tuple[str, object]
"""The user's name for a value, and the value given."""


def operating_range(dof: int, workspace: NamedValue, speed: NamedValue, stiffness: NamedValue) -> OperatingRange:
    """The declared range of a device with `dof` axes, checked.

    Raises InvalidParameter: a value is not a number, or so large or small that its unit must be wrong.
    """
    return OperatingRange(_workspace(*workspace, dof), _speed(*speed), _stiffness(*stiffness))


def in_millimetres(value: float, most: float, asks: str = "are these millimetres") -> str:
    """A hint for a message, if `value` is more than twice `most`, but a thousandth of it would be allowed."""
    return f" ({asks}?)" if 2.0 * most < value <= 1000.0 * most else ""


class RangeWatch:
    """Checks every reading of a running device. After the first impossible reading it refuses all.

    declared : the device's range. resolution : of its encoders [m]. position : the first reading [m].
    """

    def __init__(self, declared: OperatingRange, resolution: float, position: Vector) -> None:
        self._declared = declared
        self._count = rounding(resolution, len(position))
        self._last = position
        self._fast = 0
        self._rested_s = 0.0  # how long the readings before the last one were the same
        self.why: str | None = None
        """A message about the impossible reading; None: none so far."""

    def passes(self, dt: float, x: Vector, v: Vector) -> bool:
        """Whether this reading is possible, `dt` seconds after the previous one."""
        if self.why is None:
            self.why = self._look(dt, x, v)
            self._rested_s = self._rested_s + dt if x == self._last else 0.0
            self._last = x
        return self.why is None

    def _look(self, dt: float, x: Vector, v: Vector) -> str | None:
        declared = self._declared
        if (where := declared.outside(x)) is not None:
            return where
        most = f"its maximum speed is {declared.speed:g} m/s"
        travel = math.dist(x, self._last) - self._count
        if travel > declared.speed * (dt + LATENCY_S):
            hint = in_millimetres(travel, declared.speed * (dt + LATENCY_S))
            if (rested_s := self._rested_s) and travel <= declared.speed * (dt + rested_s + LATENCY_S):
                hint = f" (it repeated one reading for {1e3 * rested_s:.3g} ms before: let it declare rate_hz)"
            return f"it reads a displacement of {travel:.4g} m in {dt * 1e3:.3g} ms, {most}{hint}"
        speed = math.hypot(*v)
        self._fast = self._fast + 1 if speed > declared.speed else 0
        hint = in_millimetres(speed, declared.speed, "is it in mm/s")
        return f"it reads a velocity of {speed:.4g} m/s, {most}{hint}" if self._fast >= _FAST else None


def check_motion(name: str, path: Array, reach: float) -> None:
    """Raise InvalidParameter unless `path` (N, n) [m] can be a hand's motion within `reach` [m] on each axis."""
    far = float(np.abs(path).max())
    if far > reach:
        allowed = f"positions in m, within the {reach:g} m that the device reaches (device.workspace_m); these go to"
        raise InvalidParameter("operator", name, f"{allowed} {far:.4g} m{in_millimetres(far, reach)}")
    moved = float(np.ptp(path, axis=0).max())
    if 0.0 < moved < MIN_MOTION_M:
        raise InvalidParameter(
            "operator", name, f"positions in m; these move by only {moved:.2g} m (is their unit right?)"
        )


def _workspace(name: str, value: object, dof: int) -> Vector:
    low, high = WORKSPACE_M
    words = f"{low:g} to {high:g} m from the origin, or one such number for each of {dof} axes"
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
    minimum, most = checks.vector(name, cast(ArrayLike, value), 2)
    if not 0.0 <= minimum < most or most < SOFTEST_MOST:
        raise InvalidParameter(name, value, f"smallest and largest stiffness, the largest {SOFTEST_MOST:g} N/m or more")
    return minimum, most
