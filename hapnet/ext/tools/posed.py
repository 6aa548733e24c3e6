"""A device of three axes that says how its handle is turned, as a device of a pose's twelve coordinates.

Most such devices give no torque. Then the force along the arms' coordinates is cut before it reaches the device, and
the account counts what is left: the world's answer to a turn is seen, and not felt. A driver with a method
``apply_wrench(force, torque)`` gives both.

A torque that a device holds along the world's axes works as much as the force along the coordinates that it is counted
as, up to the square of the angle of a tick over 6: 4e-6 of the work at 5 rad/s.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from hapnet import checks
from hapnet.checks import Vector
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.mechanics.pose import ARM_M, AXES, along_coordinates, coordinates, wrench
from hapnet.units import POSE

_FARTHEST = 2.5
"""The ends of the arms lie within so many times their length from home; twice is the diameter of what they reach."""


class Posed:
    """The driver `device` of three axes, as one of twelve. What it has besides goes through.

    clock : monotonic [s]. arm_m : the length of the pose's arms [m].

    Raises InvalidParameter: the driver does not say how the handle is turned.
    """

    dof: int = AXES
    units: str = POSE
    contact_force: None = None
    """Hides the driver's, which says no torque."""

    def __init__(
        self, device: Any, name: str, clock: Callable[[], float] = time.monotonic, arm_m: float = ARM_M
    ) -> None:
        if not callable(getattr(device, "orientation", None)):
            if callable(close := getattr(device, "close", None)):
                close()
            raise InvalidParameter("hardware", name, "a device that turns (orientation), for a scene with a tool")
        self._device, self._clock, self._arm_m = device, clock, arm_m
        self.gives_torque: bool = callable(getattr(device, "apply_wrench", None))
        self._x: Vector = ()
        self._at_s = 0.0
        if (workspace := getattr(device, "workspace", None)) is not None:
            self.workspace = (*workspace, *(_FARTHEST * arm_m,) * (AXES - 3))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)

    def read(self) -> tuple[Vector, Vector]:
        """The pose's coordinates [m] and their velocity [m/s]: that of the arms is a quotient of differences."""
        (position, velocity), now = self._device.read(), self._clock()
        quaternion = self._device.orientation()
        if quaternion is None:
            raise HapnetError("it does not say how its handle is turned")
        x = coordinates(position, quaternion, self._arm_m)
        turned: Vector = (0.0,) * (AXES - 3)
        if self._x and (span := self._interval() or now - self._at_s) > 0.0:
            turned = tuple([(new - old) / span for new, old in zip(x[3:], self._x[3:], strict=True)])
        self._x, self._at_s = x, now
        return x, (*velocity, *turned)

    def _interval(self) -> float | None:
        found: Any = getattr(self._device, "interval", None)
        span: float | None = None if found is None else found()
        return span

    def apply(self, force: Vector) -> Vector | None:
        """Hold this force (12,) [N] along the coordinates; returns the one that is really applied, if it is known."""
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
        """Not sent beside the stream: the pose has it."""
        return

    def acted(self) -> Vector | None:
        """The force that acted between the last two readings (12,) [N], if a device without torque reports it."""
        found: Any = getattr(self._device, "acted", None)
        force = None if found is None or self.gives_torque else found()
        return None if force is None else (*force, *(0.0,) * (AXES - 3))

    def vibrate(self, force: Vector) -> None:
        """Take the part of the force that grains make [N]."""
        if callable(vibrate := getattr(self._device, "vibrate", None)):
            vibrate(force[:3])
