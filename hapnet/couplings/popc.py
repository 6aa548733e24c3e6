"""Passivity observer and controller at the device (hapnet/control/popc.py): its tuning rule and its ends."""

from __future__ import annotations

from dataclasses import dataclass

from hapnet.control import popc
from hapnet.control.coupling import DeviceLaw
from hapnet.couplings.link_delays import Delays
from hapnet.couplings.set_position import device_spring, plain_world
from hapnet.couplings.spec import RENDERED_DAMPING, CouplingSpec, CouplingStart, held_law
from hapnet.params import Params


@dataclass(frozen=True)
class Tuning:
    damping_cap_Ns_m: float
    velocity_floor_m_s: float


def tune(params: Params, link: Delays) -> Tuning:
    device = params.device
    by_rule = popc.damping_cap(device.mass, 1.0 / device.servo_hz, RENDERED_DAMPING)
    return Tuning(params.popc.damping_cap or by_rule, params.popc.velocity_floor)


def _device(start: CouplingStart[Tuning]) -> DeviceLaw:
    return popc.PassivityController(
        *device_spring(start.params, len(start.position)),
        start.position,
        velocity_floor=start.tuning.velocity_floor_m_s,
        damping_cap=start.tuning.damping_cap_Ns_m,
    )


POPC = CouplingSpec(
    name="popc",
    title="passivity observer and controller",
    source="Hannaford, Ryu 2002",
    claim="passive at the hand's port, except for the energy that the controller's limits leave",
    device=held_law(_device),
    world=plain_world,
    tuning=Tuning,
    tune=tune,
    set_positions=frozenset({"world"}),
    scaled=True,
)
