"""Parameters as they are used: what nobody set is chosen by the scene, the device or a rule, once and in one place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hapnet.assembly.device_class import servo_rate
from hapnet.assembly.follower import follower_of
from hapnet.assembly.scenes import scene_of, with_scene
from hapnet.assembly.simulated_device import with_own_device
from hapnet.assembly.springs import with_springs
from hapnet.assembly.units import with_units
from hapnet.couplings.registry import coupling
from hapnet.couplings.spec import CouplingSpec
from hapnet.errors import InvalidParameter
from hapnet.param_sources import DEVICE, RULE
from hapnet.params import Params, is_simulated
from hapnet.plant.worlds.protocol import World


@dataclass(frozen=True)
class Resolved:
    """The parameters of a run, each value with its source, and the scene that was made with them.

    What the user set is in it as it was set; "auto" and 0 stay where they mean that a part chooses by itself.
    """

    params: Params
    scene: World
    coupling: CouplingSpec[Any]


def resolved(params: Params) -> Resolved:
    """The parameters as they are used. Resolved again they do not change.

    Raises InvalidParameter: names the parameter that cannot be used as it was set.
    """
    _refuse_simulated_only(params)
    params = with_scene(with_own_device(params))
    scene = scene_of(params)
    before, params = params, with_units(params, scene)
    if params != before:  # radians have other defaults, also for the scene's walls
        scene = scene_of(params)
    spec = coupling(params.coupling)
    params = _with_stages(with_springs(_with_rate(params)), spec)
    params, scene = follower_of(params).place(params, spec, scene)
    return Resolved(params, scene, spec)


_SIMULATED = ("operator", "operator_hand.", "device.mass", "device.own_damping", "device.substeps")
"""Beginnings of the names of what only a simulated device has."""


def _refuse_simulated_only(params: Params) -> None:
    """Raise InvalidParameter if the user set, beside a device that is not simulated, what only a simulated one has."""
    if is_simulated(params.hardware):
        return
    for name, value in params.changes().items():
        if name.startswith(_SIMULATED) and params.asked(name):
            raise InvalidParameter(name, value, f"left out with the device {params.hardware}: it is not simulated")


def _with_rate(params: Params) -> Params:
    """The parameters with the rate of the device, where that is below the servo's."""
    rate_hz = servo_rate(params)
    if rate_hz == params.device.servo_hz:
        return params
    params.require("device.servo_hz", rate_hz, f"at most {rate_hz:g}, as the device {params.hardware}")
    return params.set({"device.servo_hz": rate_hz}, DEVICE)


def _with_stages(params: Params, spec: CouplingSpec[Any]) -> Params:
    """The parameters with the rendering that "auto" stands for with this law."""
    if params.rendering == "hapnet" and not spec.takes_positions:
        sent = " and ".join(sorted({kind.__name__ for kind in (spec.device_sends, spec.world_sends)}))
        allowed = (
            f"auto or paper with the coupling {params.coupling}: it sends {sent}, so it has no set-position to choose"
        )
        raise InvalidParameter("rendering", "hapnet", allowed)
    return params.set({"rendering": "hapnet"}, RULE) if params.rendering == "auto" and spec.world_tells else params
