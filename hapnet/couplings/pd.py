"""PD over a constant delay (hapnet/control/pd.py): its tuning rule, where it is passive, and its ends.

No predictor stands before it. The proof (Lee, Spong 2006) needs the other side's real position of a bounded time ago:
K_d pays for how far that side may have moved since. A prediction h seconds ahead adds the power K_p v h v_peer to what
must be paid, up to K_p h/2 more on each side's velocity. As the device renders no more damping, the rule would have to
lower the stiffness (derived here).
"""

from __future__ import annotations

from dataclasses import dataclass

from hapnet.control import pd
from hapnet.control.deadband import LONGEST_S
from hapnet.couplings.link_delays import Delays
from hapnet.couplings.spec import (
    RENDERED_DAMPING,
    Between,
    CouplingSpec,
    CouplingStart,
    held_law,
    scalar_stiffness,
    stepped_law,
)
from hapnet.params import Params
from hapnet.wire.messages import Motion
from netem import LinkProfile


@dataclass(frozen=True)
class Tuning:
    stiffness_N_m: float
    damping_Ns_m: float
    coordination_Ns_m: float
    extra_damping_Ns_m: float

    @property
    def gains(self) -> pd.Gains:
        return pd.Gains(self.stiffness_N_m, self.damping_Ns_m, self.coordination_Ns_m, self.extra_damping_Ns_m)


def tune(params: Params, link: Delays) -> Tuning:
    """Choose K_p so that the device can render the K_d that the rule demands. A K_d given by the user keeps K_p."""
    device, own = params.device, params.pd
    K = scalar_stiffness(params)
    held_back = 2.0 * LONGEST_S if params.wire.deadband else 0.0
    trip = pd.round_trip(
        link.round_trip_bound_s + held_back, device.pspm_period_s, params.world.step_max_s, 1.0 / device.servo_hz
    )
    K_p, K_d, *_ = pd.Gains(K, own.damping) if own.damping else pd.tuned(K, trip, RENDERED_DAMPING)
    return Tuning(K_p, K_d, own.coordination, own.extra_damping)


def warn(params: Params, tuning: Tuning) -> tuple[str, ...]:
    gains, device = tuning.gains, params.device
    need = gains.stiffness / device.servo_hz / 2.0 + gains.drag
    if device.own_damping > need:
        return ()
    return (
        f"the coupling pd holds its force for a tick: with {device.own_damping:g} Ns/m of damping in the device itself "
        f"it is not passive for motions as fast as a tick; above {need:.3g} Ns/m it would be",
    )


def covers(params: Params, tuning: Tuning, virtual: bool) -> bool:
    """True with one known delay in each direction, gains by the rule, and own damping that covers the hold's leak."""
    link = params.link
    profiles = [LinkProfile.named(words) for words in (link.up, link.down)]
    known = all(profile == LinkProfile(delay_ns=profile.delay_ns) for profile in profiles)
    by_rule = not params.pd.damping and not params.pd.coordination
    still = not (link.up_timeline or link.down_timeline)
    return virtual and known and still and by_rule and not warn(params, tuning)


def _device(start: CouplingStart[Tuning]) -> pd.DevicePD:
    return pd.DevicePD(start.tuning.gains, start.position)


def _world(start: CouplingStart[Tuning]) -> pd.WorldPD:
    return pd.WorldPD(start.tuning.gains, start.position)


PD = CouplingSpec(
    name="pd",
    title="PD over a constant delay",
    source="Lee, Spong 2006",
    claim="passive at both ports, if K_d is at least K_p times half the round trip and nothing is lost",
    device=held_law(_device),
    world=stepped_law(_world),
    tuning=Tuning,
    tune=tune,
    shared=("stiffness_N_m", "damping_Ns_m", "coordination_Ns_m"),
    device_sends=Motion,
    world_sends=Motion,
    covers=covers,
    warn=warn,
    searched={
        "pd.damping": Between(0.2, RENDERED_DAMPING, log=True),
        "pd.coordination": Between(0.0, 2.0),
        "pd.extra_damping": Between(0.0, 2.0),
    },
)
