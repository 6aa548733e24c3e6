"""A user's own device, given as ``module:Class``: checked when it is made, and guarded while it runs.

It may declare its operating range: `workspace` [m], `greatest_speed` [m/s] and `stiffness_range` [N/m], as in
`hapnet.plant.operating_range`. The parameters stand in for what it does not declare. For the speed the limit is ten
times device.greatest_speed: above that parameter only the account is not known; above ten times it, the unit is wrong.
"""

from __future__ import annotations

from collections.abc import Callable
from math import isfinite
from typing import Any

from hapnet import checks
from hapnet.checks import Vector
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.loading import cause, load
from hapnet.params import DeviceParams
from hapnet.plant.device import Device
from hapnet.plant.operating_range import SPEED_MPS, NamedValue, OperatingRange, operating_range

ALLOWED = "simulated, or module:Class with dof, force_limit, resolution, read and apply"


def load_class(name: str) -> Callable[..., Any]:
    """Import the class, but make no device: that may open the hardware, which only one process can do.

    Raises
    ------
    InvalidParameter : there is no such class.
    """
    found = load("hardware", name, ALLOWED)
    if not callable(found):
        raise InvalidParameter("hardware", name, ALLOWED)
    made: Callable[..., Any] = found
    return made


def declared_range(params: DeviceParams, dof: int, device: Device | None = None) -> OperatingRange:
    """The operating range: what `device` declares, and `params` for the rest.

    Raises
    ------
    InvalidParameter : a number in it is impossible.
    """

    def declared_or(part: str, name: str, value: object) -> NamedValue:
        declared = getattr(device, part, None)
        return (name, value) if declared is None else (part, declared)

    return operating_range(
        dof,
        declared_or("workspace", "device.workspace_m", params.workspace_m),
        declared_or("greatest_speed", "device.greatest_speed", _unless_declared(params.greatest_speed)),
        declared_or("stiffness_range", "device.stiffness_range", params.stiffness_range),
    )


def _unless_declared(speed: float) -> float:
    low, high = SPEED_MPS
    return min(max(10.0 * speed, low), high)


class UserDevice:
    """The device `name`, made with ``dof`` and read once. `params` stand in for what it does not declare.

    Its driver may fail at any time, and a NaN would become a force. So whatever it raises, and any reading that is not
    two times `dof` finite numbers, becomes one HapnetError that names the device.

    Raises
    ------
    InvalidParameter : the device cannot be made, lacks a part, or its first reading does not fit.
    """

    def __init__(self, name: str, dof: int, params: DeviceParams | None = None) -> None:
        self.name, self.dof = name, dof
        make = load_class(name)
        try:
            self.device: Device = make(dof=dof)
        except Exception as error:
            raise InvalidParameter("hardware", name, f"{ALLOWED}, made with dof ({cause(error)})") from error
        missing = [
            part for part in ("dof", "force_limit", "resolution", "read", "apply") if not hasattr(self.device, part)
        ]
        if missing:
            raise InvalidParameter("hardware", name, f"{ALLOWED}; it lacks {', '.join(missing)}")
        if self.device.dof != dof:
            raise InvalidParameter("hardware", name, f"a device with {dof} degrees of freedom, as the scene has")
        limit = self.device.force_limit
        speed, mass = (getattr(self.device, part, None) for part in ("greatest_speed", "smallest_mass"))
        try:
            self.force_limit = None if limit is None else checks.positive("force_limit", limit)
            self.resolution = checks.non_negative("resolution", self.device.resolution)
            self.greatest_speed = None if speed is None else checks.positive("greatest_speed", speed)
            self.smallest_mass = None if mass is None else checks.positive("smallest_mass", mass)
            self.declared = declared_range(params or DeviceParams(), dof, self.device)
        except InvalidParameter as error:
            raise InvalidParameter("hardware", name, f"a device whose limits are numbers ({error})") from error
        try:
            position, _ = self.read()
        except HapnetError as error:
            raise InvalidParameter("hardware", name, f"a device that can be read ({error})") from error
        if (where := self.declared.outside(position)) is not None:
            allowed = f"a device within its workspace (declared by itself or by device.workspace_m); {where}"
            raise InvalidParameter("hardware", name, allowed)

    def read(self) -> tuple[Vector, Vector]:
        """Position [m] and velocity [m/s]; HapnetError if the device fails."""
        try:
            position, velocity = self.device.read()
            x, v = tuple(map(float, position)), tuple(map(float, velocity))
        except Exception as error:
            raise HapnetError(f"the device {self.name} failed: read() raised {cause(error)}") from error
        if len(x) != self.dof or len(v) != self.dof or not isfinite(sum(x) + sum(v)):
            wanted = f"position and velocity of {self.dof} finite numbers each"
            raise HapnetError(f"the device {self.name} failed: read() gave {x}, {v} instead of {wanted}")
        return x, v

    def apply(self, force: Vector) -> Vector | None:
        """Hold a force [N]; returns the one really applied, if the device reports it. HapnetError if it fails."""
        try:
            told = self.device.apply(force)
            applied = None if told is None else tuple(map(float, told))
        except Exception as error:
            raise HapnetError(f"the device {self.name} failed: apply() raised {cause(error)}") from error
        if applied is not None and (len(applied) != self.dof or not isfinite(sum(applied))):
            wanted = f"the applied force, {self.dof} finite numbers, or None"
            raise HapnetError(f"the device {self.name} failed: apply() gave {applied} instead of {wanted}")
        return applied
