"""Energy bounding at the device (hapnet/control/eba.py): its tuning rule and its ends.

The bound holds for any force that is asked for (Kim, Ryu 2004). So the world may predict the device, as with popc: see
there, and `eba.predict_s`.
"""

from __future__ import annotations

from dataclasses import dataclass

from hapnet.control.coupling import DeviceLaw, WorldCoupling
from hapnet.control.eba import EnergyBounding
from hapnet.couplings.feel import predicts
from hapnet.couplings.link_delays import Delays
from hapnet.couplings.set_position import device_spring, plain_world
from hapnet.couplings.spec import RENDERED_DAMPING, Between, CouplingSpec, CouplingStart, held_law
from hapnet.errors import InvalidParameter
from hapnet.params import Params


@dataclass(frozen=True)
class Tuning:
    damping_Ns_m: float
    predicts: bool = False


def tune(params: Params, link: Delays) -> Tuning:
    damping = params.eba.damping or params.device.own_damping
    if damping == 0.0:
        allowed = "above 0 with the coupling eba, which may render no force without damping (or set eba.damping)"
        raise InvalidParameter("device.own_damping", 0.0, allowed)
    return Tuning(damping, predicts(params, link, params.eba.predict_s))


def _device(start: CouplingStart[Tuning]) -> DeviceLaw:
    device = start.params.device
    return EnergyBounding(
        *device_spring(start.params, len(start.position)),
        start.position,
        own_damping=start.tuning.damping_Ns_m,
        period=1.0 / device.servo_hz,
        resolution=device.resolution_m,
    )


def _world(start: CouplingStart[Tuning]) -> WorldCoupling:
    return plain_world(start, start.tuning.predicts)


EBA = CouplingSpec(
    name="eba",
    title="energy bounding",
    source="Kim, Ryu 2004",
    claim="passive at the hand's port, if the device really has the damping that is assumed",
    device=held_law(_device),
    world=_world,
    tuning=Tuning,
    tune=tune,
    set_positions=frozenset({"world"}),
    scaled=True,
    searched={"device.damping": Between(0.05, RENDERED_DAMPING, log=True), "eba.predict_s": Between(0.0, 0.3)},
)
