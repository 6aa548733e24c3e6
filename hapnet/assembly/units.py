"""The units of the axes, and the defaults for radians; refuses parameters that must be in another unit."""

from __future__ import annotations

from hapnet.assembly.choices import Choice
from hapnet.assembly.device_class import declared_range
from hapnet.assembly.simulated_device import unit_of
from hapnet.errors import InvalidParameter
from hapnet.param_sources import SCENE
from hapnet.params import Params, is_arm, is_simulated
from hapnet.plant.operating_range import in_millimetres
from hapnet.plant.worlds.protocol import World
from hapnet.units import METRES, RADIANS, one_text, within

_PLACES = (
    "operator_model.start_m", "operator_model.goal_m", "operator_model.amplitude_m", "operator_model.press_depth_m",
    "operator_model.hover_m", "world.wall.position_m", "world.wall.half_width_m",
)  # fmt: skip
"""Lengths that are comparable to the device's size in every run."""


LEVER_M = 0.1
"""Defaults for axes in radians are the defaults in metres, as if they acted at this lever [m]."""

_POWERS = {
    2: ("device.damping", "device.mass", "device.own_damping", "operator_model.mass", "operator_model.damping",
        "operator_model.stiffness", "world.mass", "world.damping", "world.stiffness", "world.wall.stiffness",
        "world.wall.damping", "follower.mass", "follower.own_damping"),
    1: ("device.force_limit_N", "device.step_limit_N", "device.self_test_N", "world.step_limit_N",
        "follower.force_limit_N", "follower.step_limit_N"),
    -1: ("device.greatest_speed", "operator_model.start_m", "operator_model.goal_m", "operator_model.amplitude_m",
         "operator_model.press_depth_m", "operator_model.hover_m", "world.wall.position_m", "world.wall.half_width_m",
         "contact_model.reach_m", "follower.greatest_speed"),
}  # fmt: skip
_DEFAULTS = Params()
_TURNED = {
    **{name: _DEFAULTS.get(name) * LEVER_M**power for power, names in _POWERS.items() for name in names},
    "device.stiffness": 2.0, "device.stiffness_range": (1e-3, 1e4), "device.workspace_m": 10.0,
}  # fmt: skip
"""Defaults for axes in radians: Nm/rad, Nms/rad, kg m^2, Nm, rad and rad/s."""


def scene_units(params: Params, scene: World) -> Choice:
    """Choose the scene's units, and the defaults for radians if all axes are in radians.

    Raises InvalidParameter: the parameters, the device or the world have other units.
    """
    of_world = one_text(scene.units, scene.dof, f"the units of the scene {params.scene}")
    if params.units != "auto" and one_text(params.units, scene.dof) != of_world:
        raise InvalidParameter("units", params.units, f"auto or {of_world}: the scene {params.scene} sets its own")
    if is_arm(params.hardware) and (unit := unit_of(params.hardware)) != of_world:
        need = f"one whose axes are in {of_world}, as those of the scene {params.scene}"
        raise InvalidParameter("hardware", params.hardware, f"{need}; this one's are in {unit}")
    turned = _TURNED if of_world == RADIANS else {}
    left = {name: value for name, value in turned.items() if name not in params.given}
    return Choice({} if of_world == METRES else {"units": of_world, **left}, SCENE)


def check_units(params: Params, dof: int) -> None:
    """Raise InvalidParameter for a length, or a simulated device's stiffness, that must be in another unit.

    The stiffness for a user's own device is checked when that device is made, since it may declare its range.
    """
    declared = declared_range(params.device, dof)
    for name in _PLACES:
        length = abs(params.get(name))
        if length > declared.reach:
            allowed = f"within the {declared.reach:g} m that the device reaches (device.workspace_m)"
            raise InvalidParameter(name, params.get(name), allowed + in_millimetres(length, declared.reach))
    if is_simulated(params.hardware):
        unit = within(METRES if params.units == "auto" else params.units, "N/m")
        declared.check_stiffness("device.stiffness", params.device.stiffness, dof, unit, "device.stiffness_range")
