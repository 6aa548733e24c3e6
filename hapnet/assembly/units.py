"""Are these metres, and N/m? Parameters that lie outside of the device's operating range are refused."""

from __future__ import annotations

from hapnet.assembly.user_device import declared_range
from hapnet.errors import InvalidParameter
from hapnet.params import Params
from hapnet.plant.operating_range import in_millimetres

_PLACES = (
    "operator_hand.start_m", "operator_hand.goal_m", "operator_hand.amplitude_m", "operator_hand.press_depth_m",
    "operator_hand.hover_m", "world.wall.position_m", "world.wall.half_width_m",
)  # fmt: skip
"""Lengths that are of the device's size, whatever the run is."""


def check_units(params: Params, dof: int) -> None:
    """Raise InvalidParameter for what only another unit explains: a length, or the stiffness of a simulated device.

    The stiffness range of a device of the user's own is its own affair: it is checked when that is made.
    """
    declared = declared_range(params.device, dof)
    for name in _PLACES:
        length = abs(params.get(name))
        if length > declared.reach:
            allowed = f"within the {declared.reach:g} m that the device reaches (device.workspace_m)"
            raise InvalidParameter(name, params.get(name), allowed + in_millimetres(length, declared.reach))
    if params.hardware == "simulated":
        declared.check_stiffness("device.stiffness", params.device.stiffness, dof)
