"""Simulated arms by their names: ``omni``, and ``arm:FILE.urdf?tip=LINK``."""

from __future__ import annotations

from hapnet.errors import InvalidParameter
from hapnet.params import DeviceParams, Params, is_arm
from hapnet.plant.arms.omni import omni
from hapnet.plant.arms.table import ArmTable, apparent_masses, felt_damping

_DEFAULTS = DeviceParams()


def table_of(hardware: str) -> ArmTable:
    """The arm that `hardware` names.

    Raises InvalidParameter: there is none, or its file cannot be used.
    """
    name, _, behind = hardware.partition(":")
    if name == "omni":
        if behind:
            raise InvalidParameter("hardware", hardware, "omni, which takes no options")
        return omni()
    raise InvalidParameter("hardware", hardware, "omni")


def with_arm(params: Params) -> Params:
    """The parameters as an arm needs them, if the device is one: three axes, and what its tip weighs and damps at home.

    Raises InvalidParameter: a parameter does not go with an arm.
    """
    if not is_arm(params.hardware):
        return params
    table, device = table_of(params.hardware), params.device
    if params.dof not in (0, 3):
        raise InvalidParameter("dof", params.dof, f"0 or 3 with the device {params.hardware}")
    for name, plain in (("servo", "sampled"), ("harvest", "measured")):
        if (value := getattr(device, name)) not in ("auto", plain):
            raise InvalidParameter(f"device.{name}", value, f"auto or {plain} with the device {params.hardware}")
    own = {"mass": min(apparent_masses(table)), "own_damping": felt_damping(table)}
    for name, value in own.items():
        if (given := getattr(device, name)) not in (getattr(_DEFAULTS, name), value):
            raise InvalidParameter(
                f"device.{name}", given, f"left out with the device {params.hardware}: its links have it"
            )
    return params.set({"dof": 3, **{f"device.{name}": value for name, value in own.items()}})
