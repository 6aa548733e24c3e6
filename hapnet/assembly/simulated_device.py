"""The simulated device: a mass, or the device of an extension (an arm, a tool's handle)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hapnet.loading import extension
from hapnet.params import Params, arm_file, is_arm
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.operator import Operator
from hapnet.plant.worlds.protocol import World
from hapnet.recording.hand import fingerprint
from hapnet.units import METRES, POSE

if TYPE_CHECKING:
    from hapnet.assembly.build import Setup


def unit_of(hardware: str) -> str:
    """The unit of a simulated device's axes. Raises InvalidParameter: there is no such arm."""
    return str(extension("arms").unit_of(hardware)) if is_arm(hardware) else METRES


def description(params: Params) -> dict[str, Any]:
    """The description of the device for a recording: the content of its file, and an arm's frames for pictures."""
    found = {"hardware_sha256": fingerprint(arm_file(params.hardware))}
    return {**found, **extension("arms").description(params)} if is_arm(params.hardware) else found


def described(setup: Setup, seed: int) -> dict[str, Any]:
    """The description of a run for a recording's ``meta``, without what differs between the clocks."""
    params, scene = setup.params, setup.scene
    return {
        "params": params.as_dict(),
        "sources": dict(params.sources),
        "operator_sha256": fingerprint(params.operator),
        **description(params),
        "seed": seed,
        "scene": scene.name,
        "surfaces": [surface._asdict() for surface in scene.surfaces],
        "coupling": params.coupling,
        "tuning": setup.tuned,
        "felt": setup.felt,
    }


def simulated_device(params: Params, scene: World, hand: Operator) -> SimulatedDevice:
    """The simulated device of these parameters in a hand. Raises InvalidParameter."""
    device: SimulatedDevice
    if is_arm(params.hardware):
        device = extension("arms").simulated_arm(params, hand)
        return device
    kind = extension("tools").SimulatedHandle if scene.units == POSE else SimulatedDevice
    own = params.device
    device = kind(
        hand, mass=own.mass, damping=own.own_damping, period=1.0 / own.servo_hz, substeps=own.substeps,
        resolution=own.resolution_m, force_limit=own.force_limit_N or None,
    )  # fmt: skip
    return device


def device_warnings(params: Params) -> tuple[str, ...]:
    """Warnings for the user about a simulated device: what an arm's file has that is not used or looks wrong."""
    return tuple(extension("arms").warnings(params)) if is_arm(params.hardware) else ()


def real_time_warnings(params: Params) -> tuple[str, ...]:
    """Warnings for the user of a device's side, shown before control starts."""
    return tuple(extension("arms").real_time_warnings(params)) if is_arm(params.hardware) else ()
