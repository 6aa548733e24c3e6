"""Resolves the parameters of a run: once, in one place, and in one order.

A value that was set is used, whatever it equals. For the rest, the first of these chooses that has something to say:
the device, the scene, its units, the device's rate, a rule. `Params.source` says of each value where it comes from.
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

    What the user set is in it as it was set. servo, harvest : what "auto" stands for, which stays in the parameters.
    """

    params: Params
    scene: World
    coupling: CouplingSpec[Any]
    servo: str
    harvest: Harvest


def resolve(params: Params, default_servo: str = "sampled") -> Resolved:
    """The parameters as they are used. Resolved again they do not change.

    default_servo : used where the device's servo is left open, and where that one can act.

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


_SIMULATED = ("operator", "operator_hand.", "device.mass", "device.own_damping", "device.substeps")
"""Beginnings of the names of what only a simulated device has."""


def _refuse_simulated_only(params: Params) -> None:
    """Raise InvalidParameter if the user set, beside a device that is not simulated, what only a simulated one has."""
    if not is_simulated(params.hardware):
        allowed = f"left out with the device {params.hardware}: it is not simulated"
        refuse(
            Refusal(params.asked(name), name, value, allowed)
            for name, value in params.changes().items()
            if name.startswith(_SIMULATED)
        )


def _rate(params: Params) -> Choice:
    """The rate of the device, where that is below the servo's. Raises InvalidParameter: more was set."""
    rate_hz = servo_rate(params.hardware, params.device.servo_hz)
    params.require("device.servo_hz", rate_hz, f"at most {rate_hz:g}, as the device {params.hardware}")
    return Choice({} if rate_hz == params.device.servo_hz else {"device.servo_hz": rate_hz}, DEVICE)


def _rendering(params: Params) -> Choice:
    """The rendering that "auto" stands for with this law. Raises InvalidParameter: the law cannot have it."""
    spec = coupling(params.coupling)
    sent = " and ".join(sorted({kind.__name__ for kind in (spec.device_sends, spec.world_sends)}))
    allowed = f"auto or paper with the coupling {params.coupling}: it sends {sent}, so it has no set-position to choose"
    asked = params.rendering
    refuse((Refusal(asked == "hapnet" and not spec.takes_positions, "rendering", asked, allowed),))
    return Choice({"rendering": "hapnet"} if asked == "auto" and spec.sends_planes else {}, RULE)


_SET_POSITIONS_ONLY = {"smoothing_s": 0.0, "predict_s": 0.0, "on_silence": "hold"}
"""Parameters that apply to received set-positions, and their values for a law that receives something else."""

_SAMPLED_ONLY = {"clutch": "", "enable": "auto"}
"""Parameters of the device that only a sampled servo reads, and their values with another."""


def misfits(used: Resolved) -> Iterator[Refusal]:
    """The values that do not go together, in the order in which the first is reported."""
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
    """Warnings of a torque that is held; what a device of the user's own declares counts only when it is made."""
    params = used.params
    if used.servo != "sampled" or not used.coupling.limited:
        return []
    device = dataclasses.replace(params.device, own_damping=known_damping(params))
    found = held_torque.check(device, used.harvest, used.scene.dof)
    return found if is_simulated(params.hardware) or used.harvest == "range" else []
