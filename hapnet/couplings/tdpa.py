"""Two-port time-domain passivity (hapnet/control/tdpa.py): its tuning rule and its ends.

The controllers stand last at both ports and count what really comes out. So the world may command any displacement
(Ryu, Artigas, Preusche 2010): with `tdpa.predict` one that leads to where the device will be, delay included. The
energy of that motion arrives a delay later, so the controller yields more in contact: it becomes freer, and softer. By
default the law only continues the newest position by its own estimate of the velocity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hapnet.control.coupling import LawSteps, WorldCoupling
from hapnet.control.tdpa import TdpaDevice, TdpaWorld
from hapnet.couplings import feel
from hapnet.couplings.link_delays import Delays
from hapnet.couplings.spec import RENDERED_DAMPING, Between, CouplingSpec, CouplingStart, held_law, scalar_stiffness
from hapnet.params import Params
from hapnet.wire.messages import Port


@dataclass(frozen=True)
class Tuning:
    stiffness_N_m: float
    damping_Ns_m: float
    velocity_floor_m_s: float
    force_floor_N: float
    damping_cap_Ns_m: float
    speed_limit_m_s: float
    debt_limit_J: float
    recovery_s: float
    predicts: bool = False


def tune(params: Params, link: Delays) -> Tuning:
    """Choose the damping that damps the heaviest axis of the virtual mass critically, as far as the device renders it.

    alpha is at most what the device renders, and at most m/T, which stops the device within a tick: a stronger held
    damper would reverse it. The link's delays do not matter.
    """
    chosen, device = params.tdpa, params.device
    K = chosen.stiffness or scalar_stiffness(params)
    mass = np.asarray(params.world.mass)
    heaviest = float(np.linalg.norm(mass, 2) if mass.ndim == 2 else mass.max())
    return Tuning(
        stiffness_N_m=K,
        damping_Ns_m=chosen.damping or min(2.0 * math.sqrt(K * heaviest), RENDERED_DAMPING),
        velocity_floor_m_s=chosen.velocity_floor,
        force_floor_N=chosen.force_floor,
        damping_cap_Ns_m=chosen.damping_cap or min(RENDERED_DAMPING, device.mass * device.servo_hz),
        speed_limit_m_s=chosen.speed_limit,
        debt_limit_J=chosen.debt_limit_J,
        recovery_s=chosen.recovery_s,
        predicts=chosen.predict and params.feel != "paper",
    )


def _device(start: CouplingStart[Tuning]) -> TdpaDevice:
    tuning = start.tuning
    return TdpaDevice(
        position=start.position,
        velocity_floor=tuning.velocity_floor_m_s,
        damping_cap=tuning.damping_cap_Ns_m,
        debt_limit=tuning.debt_limit_J,
        stiffness=tuning.stiffness_N_m,
    )


def _world(start: CouplingStart[Tuning]) -> WorldCoupling:
    tuning = start.tuning
    law = TdpaWorld(
        position=start.position,
        stiffness=tuning.stiffness_N_m,
        damping=tuning.damping_Ns_m,
        force_floor=tuning.force_floor_N,
        speed_limit=tuning.speed_limit_m_s,
        debt_limit=tuning.debt_limit_J,
        recovery=tuning.recovery_s,
        predictor=feel.predictor(start.params) if tuning.predicts else None,
    )
    return LawSteps(law, start.initial_energy, law.stamped)


TDPA = CouplingSpec(
    name="tdpa",
    title="two-port time-domain passivity",
    source="Ryu, Artigas, Preusche 2010, with drift compensation",
    claim="passive at both ports, whatever the link does, except for a bounded debt; without compensation it drifts",
    device=held_law(_device),
    world=_world,
    tuning=Tuning,
    tune=tune,
    device_sends=Port,
    world_sends=Port,
    covers=lambda params, tuning, virtual: True,
    allowance_J=lambda tuning: 2.0 * tuning.debt_limit_J,
    searched={
        "tdpa.stiffness": Between(50.0, 1000.0, log=True),
        "tdpa.damping": Between(0.5, 20.0, log=True),
        "tdpa.velocity_floor": Between(0.0005, 0.01, log=True),
        "tdpa.force_floor": Between(0.01, 0.2, log=True),
        "tdpa.damping_cap": Between(0.5, RENDERED_DAMPING, log=True),
        "tdpa.speed_limit": Between(0.15, 1.0, log=True),
        "tdpa.recovery_s": Between(0.005, 0.2, log=True),
        "tdpa.predict": (False, True),
    },
)
