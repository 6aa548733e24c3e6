"""A device of three axes with a measured orientation, as a device of a pose's twelve coordinates.

Most such devices give no torque. Then the force along the arms' coordinates is cut before it reaches the device, and
the account counts the rest: the world's response to a turn is visible, and not felt. A driver with a method
``apply_wrench(force, torque)`` renders both.

A device holds a torque along the world's axes, and it is counted as a force along the coordinates. The work differs by
the square of a tick's angle over 6: by 4e-6 of it at 5 rad/s.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from numpy.typing import ArrayLike

from hapnet import checks
from hapnet.checks import Vector
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.mechanics.pose import ARM_M, AXES, along_coordinates, along_motion, coordinates, wrench
from hapnet.units import POSE

_FARTHEST = 2.5
"""The workspace of the arms' ends, in arm lengths; they reach at most 2 from home."""


class Posed:
    """The driver `device` of three axes, as a driver of twelve; all other attributes are passed through.

    clock : monotonic [s]. arm_m : the length of the pose's arms [m].

    Raises InvalidParameter: the driver does not report the handle's orientation.
    """

    dof: int = AXES
    units: str = POSE
    contact_force: None = None
    """Hides the driver's contact force, which has no torque."""

    def __init__(
        self, device: Any, name: str, clock: Callable[[], float] = time.monotonic, arm_m: float = ARM_M
    ) -> None:
        if not callable(getattr(device, "orientation", None)):
            if callable(close := getattr(device, "close", None)):
                close()
            raise InvalidParameter("hardware", name, "a device that turns (orientation), for a scene with a tool")
        if getattr(device, "jaw", False):
            device.close()
            raise InvalidParameter("hardware", name, "a device without jaw=, for a scene with a tool")
        self._device, self._clock, self._arm_m = device, clock, arm_m
        self.gives_torque: bool = callable(getattr(device, "apply_wrench", None))
        self._x: Vector = ()
        self._x_before: Vector = ()
        self._at_s = 0.0

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._device, name)
        return self._reach(found) if name == "workspace" and found is not None else found

    def _reach(self, workspace: ArrayLike) -> Vector:
        """The device's present workspace [m], on each coordinate; a reach in all directions is one on each axis."""
        given = checks.vector("workspace", workspace)
        point = given * 3 if len(given) == 1 else given
        return (*point, *(_FARTHEST * self._arm_m,) * (AXES - 3))

    def read(self) -> tuple[Vector, Vector]:
        """The pose's coordinates [m] and their velocity [m/s], for the arms by a difference quotient."""
        (position, velocity), now = self._device.read(), self._clock()
        quaternion = self._device.orientation()
        if quaternion is None:
            raise HapnetError("it does not report how its handle is turned")
        x = coordinates(position, quaternion, self._arm_m)
        turned: Vector = (0.0,) * (AXES - 3)
        if self._x and (span := self._interval() or now - self._at_s) > 0.0:
            turned = tuple([(new - old) / span for new, old in zip(x[3:], self._x[3:], strict=True)])
        self._x_before, self._x, self._at_s = self._x, x, now
        return x, (*velocity, *turned)

    def _interval(self) -> float | None:
        found: Any = getattr(self._device, "interval", None)
        span: float | None = None if found is None else found()
        return span

    def apply(self, force: Vector) -> Vector | None:
        """Hold this force (12,) [N] along the coordinates; returns the force really applied, if it is known."""
        if not self.gives_torque:
            applied = self._device.apply(force[:3])
            return None if applied is None else (*applied, *(0.0,) * (AXES - 3))
        applied = self._device.apply_wrench(*wrench(self._x, force, self._arm_m))
        if applied is None:
            return None
        try:
            push, torque = (checks.vector("apply_wrench()", part, 3) for part in applied)
        except (TypeError, ValueError):
            raise HapnetError("apply_wrench() gives force and torque, three numbers each, or None") from None
        return along_coordinates(self._x, push, torque, self._arm_m)

    def orientation(self) -> None:
        """None: it is not sent as a signal, as the pose contains it."""
        return

    def acted(self) -> Vector | None:
        """The force that acted between the last two readings (12,) [N], if the device reports it.

        It does the work of the device's force on the point's motion, and of its torque on the turn
        (`hapnet.mechanics.pose.turned`).
        """
        found: Any = getattr(self._device, "acted_wrench" if self.gives_torque else "acted", None)
        acted = None if found is None else found()
        if acted is None:
            return None
        if self.gives_torque:
            force, torque = acted
            return along_motion(self._x_before or self._x, self._x, force, torque, self._arm_m)
        return (*acted, *(0.0,) * (AXES - 3))

    def vibrate(self, force: Vector) -> None:
        """Take the part of the force that grains make [N]."""
        if callable(vibrate := getattr(self._device, "vibrate", None)):
            vibrate(force[:3])
