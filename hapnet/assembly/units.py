"""Refuses parameters outside the device's operating range: lengths that are not in metres, stiffnesses not in N/m."""

from __future__ import annotations

from hapnet.assembly.user_device import declared_range
from hapnet.errors import InvalidParameter
from hapnet.params import Params, is_simulated
from hapnet.plant.operating_range import in_millimetres

_PLACES = (
    "operator_hand.start_m", "operator_hand.goal_m", "operator_hand.amplitude_m", "operator_hand.press_depth_m",
    "operator_hand.hover_m", "world.wall.position_m", "world.wall.half_width_m",
)  # fmt: skip
"""Lengths that are comparable to the device's size in every run."""


def check_units(params: Params, dof: int) -> None:
    """Raise InvalidParameter for a length, or a simulated device's stiffness, that only another unit explains.

    The stiffness for a user's own device is checked when that device is made, since it may declare its range.
    """
    declared = declared_range(params.device, dof)
    for name in _PLACES:
        length = abs(params.get(name))
        if length > declared.reach:
            allowed = f"within the {declared.reach:g} m that the device reaches (device.workspace_m)"
            raise InvalidParameter(name, params.get(name), allowed + in_millimetres(length, declared.reach))
    if is_simulated(params.hardware):
        declared.check_stiffness("device.stiffness", params.device.stiffness, dof)
