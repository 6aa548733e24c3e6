"""Refuses parameters outside the device's operating range: lengths that are not in metres, stiffnesses not in N/m."""

from __future__ import annotations

from hapnet.assembly.user_device import declared_range
from hapnet.errors import InvalidParameter
from hapnet.params import Params, is_simulated
from hapnet.plant.operating_range import in_millimetres
from hapnet.plant.worlds.protocol import World
from hapnet.units import METRES, text_of, units_of

_PLACES = (
    "operator_hand.start_m", "operator_hand.goal_m", "operator_hand.amplitude_m", "operator_hand.press_depth_m",
    "operator_hand.hover_m", "world.wall.position_m", "world.wall.half_width_m",
)  # fmt: skip
"""Lengths that are comparable to the device's size in every run."""


def with_units(params: Params, scene: World) -> Params:
    """The parameters with the world's units, if an axis is none in metres.

    Raises InvalidParameter: the parameters or the world name others.
    """
    of_world = units_of(scene.units, scene.dof, f"the units of the scene {params.scene}")
    if params.units != "auto" and units_of(params.units, scene.dof) != of_world:
        allowed = f"auto or {text_of(of_world)}: the scene {params.scene} sets its own"
        raise InvalidParameter("units", params.units, allowed)
    return params if set(of_world) == {METRES} else params.set({"units": text_of(of_world)})


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
