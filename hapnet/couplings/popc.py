"""Passivity observer and controller at the device (hapnet/control/popc.py): its tuning rule and its ends.

The observer and the controller stand at the device's port, after whatever makes the force (Hannaford, Ryu 2002: "any"
virtual environment). So the world may predict the device there: the claim is for the hand's port alone. It does where
age and lag together are within `popc.predict_s`, by default no longer than the positions that are fitted. Longer
predictions made both ports together far from passive, as measured.
"""

from __future__ import annotations

from dataclasses import dataclass

from hapnet.control import popc
from hapnet.control.coupling import DeviceLaw, WorldCoupling
from hapnet.couplings.feel import predicts
from hapnet.couplings.link_delays import Delays
from hapnet.couplings.set_position import device_spring, plain_world
from hapnet.couplings.spec import RENDERED_DAMPING, Between, CouplingSpec, CouplingStart, held_law
from hapnet.params import Params


@dataclass(frozen=True)
class Tuning:
    damping_cap_Ns_m: float
    velocity_floor_m_s: float
    predicts: bool = False


def tune(params: Params, link: Delays) -> Tuning:
    device = params.device
    by_rule = popc.damping_cap(device.mass, 1.0 / device.servo_hz, RENDERED_DAMPING)
    return Tuning(
        params.popc.damping_cap or by_rule, params.popc.velocity_floor, predicts(params, link, params.popc.predict_s)
    )


def _device(start: CouplingStart[Tuning]) -> DeviceLaw:
    return popc.PassivityController(
        *device_spring(start.params, len(start.position)),
        start.position,
        velocity_floor=start.tuning.velocity_floor_m_s,
        damping_cap=start.tuning.damping_cap_Ns_m,
    )


def _world(start: CouplingStart[Tuning]) -> WorldCoupling:
    return plain_world(start, start.tuning.predicts)


POPC = CouplingSpec(
    name="popc",
    title="passivity observer and controller",
    source="Hannaford, Ryu 2002",
    claim="passive at the hand's port, except for the energy that the controller's limits leave",
    device=held_law(_device),
    world=_world,
    tuning=Tuning,
    tune=tune,
    set_positions=frozenset({"world"}),
    scaled=True,
    searched={
        "device.damping": Between(0.05, RENDERED_DAMPING, log=True),
        "popc.velocity_floor": Between(0.0005, 0.01, log=True),
        "popc.damping_cap": Between(0.5, RENDERED_DAMPING, log=True),
        "popc.predict_s": Between(0.0, 0.3),
    },
)
