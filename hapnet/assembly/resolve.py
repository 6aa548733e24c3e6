"""Resolves the parameters of a run: once, in one place, and in one order.

A value that the user set is used, whatever it equals. Each other value comes from the first of these that sets it:
the device, the scene, its units, the device's rate, a rule. `Params.source` returns where a value comes from.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, cast

from hapnet.assembly.choices import Choice, Refusal, before_scene, choosing, contributions, refuse
from hapnet.assembly.device_class import servo_rate
from hapnet.assembly.scenes import scene_defaults, scene_of
from hapnet.assembly.springs import spring
from hapnet.assembly.units import check_units, scene_units
from hapnet.control.set_position_servo import Harvest
from hapnet.couplings import held_torque
from hapnet.couplings.registry import coupling
from hapnet.couplings.spec import CouplingSpec
from hapnet.param_sources import DEVICE, RULE
from hapnet.params import Params, is_simulated, known_damping
from hapnet.plant.worlds.protocol import World


@dataclass(frozen=True)
class Resolved:
    """The parameters of a run, each value with its source, and the scene that was made with them.

    Values that the user set are unchanged. servo, harvest : the meaning of "auto"; the parameters keep "auto".
    """

    params: Params
    scene: World
    coupling: CouplingSpec[Any]
    servo: str
    harvest: Harvest


def resolve(params: Params, default_servo: str = "sampled") -> Resolved:
    """Return the parameters as the run uses them; resolving them again changes nothing.

    default_servo : used if the device's servo is "auto" and this servo fits.

    Raises InvalidParameter: names the parameter that cannot be used as it was set.
    """
    _refuse_simulated_only(params)
    params = choosing(params, *before_scene(params), scene_defaults)
    scene = scene_of(params)
    before, params = params, choosing(params, partial(scene_units, scene=scene))
    if params != before:  # radians have other defaults, also for the scene's walls
        scene = scene_of(params)
    brought = contributions(params)
    params = choosing(params, *[part for one in brought for part in one.in_scene], _rate, spring, _rendering)
    spec = coupling(params.coupling)
    for one in brought:
        one.check(params, spec, scene)
        scene = one.place(params, spec, scene)
    check_units(params, scene.dof)
    servo, harvest = params.device.servo, params.device.harvest
    if servo == "auto":
        acts_within = spec.continuous is not None and params.rendering == "paper"
        servo = default_servo if acts_within and not any(one.sampled_only for one in brought) else "sampled"
    if harvest == "auto":
        harvest = "range" if servo == "continuous" else "measured"
    return Resolved(params, scene, spec, servo, cast(Harvest, harvest))


_SIMULATED = ("operator", "operator_model.", "device.mass", "device.own_damping", "device.substeps")
"""Prefixes of the parameters that only a simulated device has."""


def _refuse_simulated_only(params: Params) -> None:
    """Raise InvalidParameter if the user set a parameter of simulated devices, and the device is not simulated."""
    if not is_simulated(params.hardware):
        allowed = f"left out with the device {params.hardware}: it is not simulated"
        refuse(
            Refusal(params.asked(name), name, value, allowed)
            for name, value in params.changes().items()
            if name.startswith(_SIMULATED)
        )


def _rate(params: Params) -> Choice:
    """Choose the device's rate if it is below the servo's. Raises InvalidParameter: the user set a higher rate."""
    rate_hz = servo_rate(params.hardware, params.device.servo_hz)
    params.require("device.servo_hz", rate_hz, f"at most {rate_hz:g}, as the device {params.hardware}")
    return Choice({} if rate_hz == params.device.servo_hz else {"device.servo_hz": rate_hz}, DEVICE)


def _rendering(params: Params) -> Choice:
    """Choose the rendering for "auto" with this law. Raises InvalidParameter: the law cannot have the set rendering."""
    spec = coupling(params.coupling)
    sent = " and ".join(sorted({kind.__name__ for kind in (spec.device_sends, spec.world_sends)}))
    allowed = f"auto or paper with the coupling {params.coupling}: it sends {sent}, so it has no set-position to choose"
    asked = params.rendering
    refuse((Refusal(asked == "hapnet" and not spec.takes_positions, "rendering", asked, allowed),))
    return Choice({"rendering": "hapnet"} if asked == "auto" and spec.sends_planes else {}, RULE)


_SET_POSITIONS_ONLY = {"smoothing_s": 0.0, "predict_s": 0.0, "on_silence": "hold"}
"""Parameters that apply to received set-positions, and their values for a law that does not receive any."""

_SAMPLED_ONLY = {"clutch": "", "enable": "auto"}
"""Parameters of the device that only a sampled servo reads, and their values with another servo."""


def misfits(used: Resolved) -> Iterator[Refusal]:
    """Yield the values that do not fit together, in order of precedence: only the first is reported."""
    params, spec, servo, harvest = used.params, used.coupling, used.servo, used.harvest
    device, within_step = params.device, servo == "continuous"
    law = f"with the coupling {params.coupling}"
    yield Refusal(
        used.scene.moves_proxy and "world" not in spec.set_positions, "coupling", params.coupling,
        f"one whose virtual mass has a spring in the scene {params.scene}, such as pspm or zoh",
    )  # fmt: skip
    unknown = device.servo == "continuous" and spec.continuous is None
    yield Refusal(unknown, "device.servo", servo, f"sampled {law}")
    for field_name, nothing in _SAMPLED_ONLY.items() if within_step else ():
        value = getattr(device, field_name)
        allowed = f"{nothing or 'empty'} with the continuous servo"
        yield Refusal(value != nothing, f"device.{field_name}", value, allowed)
    yield Refusal(
        within_step and harvest == "measured", "device.harvest", "measured",
        "range with the continuous servo: no torque is held",
    )  # fmt: skip
    yield Refusal(
        within_step and device.resolution_m > 0.0, "device.resolution_m", device.resolution_m,
        "0 with the continuous servo",
    )  # fmt: skip
    yield Refusal(
        0.0 < device.watchdog_s < 1.0 / device.servo_hz, "device.watchdog_s", device.watchdog_s,
        "0 (off), or a period of the servo or more",
    )  # fmt: skip
    yield Refusal(
        harvest == "range" and device.trusted_damping > 0.0 and is_simulated(params.hardware),
        "device.trusted_damping", device.trusted_damping, "0 with the range harvest",
    )  # fmt: skip
    for name, side in (("device", device), ("world", params.world)):
        for field_name, plain in _SET_POSITIONS_ONLY.items() if name not in spec.set_positions else ():
            value = getattr(side, field_name)
            yield Refusal(value != plain, f"{name}.{field_name}", value, f"{plain} {law}")
        yield Refusal(
            side.on_silence == "release" and not side.step_limit_N, f"{name}.on_silence", "release",
            f"hold, or release with {name}.step_limit_N above 0",
        )  # fmt: skip
    own = not is_simulated(params.hardware) and servo != "sampled"
    yield Refusal(own, "device.servo", servo, "sampled with a device of your own")


def held_warnings(used: Resolved) -> list[str]:
    """Warnings about a held torque; the declarations of a user's own device count only when that device is made."""
    params = used.params
    if used.servo != "sampled" or not used.coupling.halves:
        return []
    device = dataclasses.replace(params.device, own_damping=known_damping(params))
    found = held_torque.check(device, used.harvest, used.scene.dof)
    return found if is_simulated(params.hardware) or used.harvest == "range" else []
