"""How far, how fast and how stiff a device may be: what it declares, and the parameters for the rest."""

from __future__ import annotations

from hapnet.params import DeviceParams
from hapnet.plant.device import Device
from hapnet.plant.operating_range import SPEED_MPS, NamedValue, OperatingRange, operating_range


def declared_range(params: DeviceParams, dof: int, device: Device | None = None) -> OperatingRange:
    """The operating range: what `device` declares, and `params` for the rest.

    Raises InvalidParameter: a number in it is impossible.
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
