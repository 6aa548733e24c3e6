"""Position-force: the follower tracks the leader, and the leader renders the force that the follower measures at its
contact (Lawrence, IEEE T-RA 9(5), 1993, the force reflection architecture; Hannaford 1989).

    F_l = F_e - B_l v_l,    F_f = K_f (x_l - x_f) + B_f (v_l - v_f)

F_e is the measured force of the surroundings on the follower, so the hand feels neither the follower's mass nor its
friction. The leader has no spring of its own: `device.stiffness` is only the spring of PSPM's port.

With a round trip R and a hand of mass M, damping b and stiffness k (the leader's included) the loop is

    1 + k_e K_f/(k_e + K_f) e^(-s R) / (M s^2 + b s + k) = 0

with k_e the contact's stiffness, for a follower that is fast against R. It is unstable before a stiff wall unless the
hand damps it (`force_reflection_limit`).
"""

from __future__ import annotations

import math

from hapnet.control.samples import CouplingSample, ProxySample
from hapnet.couplings.rendering import largest
from hapnet.couplings.spec import CouplingStart
from hapnet.ext.laws.bilateral.pp import PositionEnd
from hapnet.ext.laws.parts.bilateral_port import (
    BilateralEnd,
    BilateralTuning,
    between_robots,
    led,
    tune,
)
from hapnet.wire import messages


class ForceLeader(BilateralEnd):
    """The leader's end: it renders the force that the follower sends [N].

    stiffness : of the port's spring [N/m]. lead_s : B/K of the follower [s].
    """

    def __init__(self, stiffness: float, lead_s: float) -> None:
        super().__init__(stiffness)
        self._lead_s = lead_s

    def receive(self, sample: CouplingSample, sent_s: float, age_s: float) -> None:
        if isinstance(sample, ProxySample):
            self.peer = sample.force

    def pull(self) -> tuple[float, ...]:
        return self.peer

    def content(self, level: float | None) -> CouplingSample:
        return led(self.x, self._lead_s, self.v, level)


class ForceFollower(PositionEnd):
    """The follower's end: it tracks the leader, and sends the force at its contact [N]."""

    def content(self, level: float | None) -> CouplingSample:
        return ProxySample(self.x, 0.0, self.sensed, None, None, level)


def force_reflection_limit(mass: float, damping: float, stiffness: float, round_trip_s: float) -> float:
    """The stiffest contact, in series with K_f, that the leader can be shown without vibrating [N/m].

    mass, damping, stiffness : of the hand with the leader [kg, Ns/m, N/m]. round_trip_s : R [s].

    At the limit the loop's gain is 1 where its phase is -180 degrees (Nyquist):
    ``k - M w^2 + j b w = -k_c e^(-j w R)``.
    So w is where w R and the phase of the left side add up to pi, and k_c its absolute value there.
    """
    if round_trip_s <= 0.0:
        return math.inf
    low, high = 0.0, math.pi / round_trip_s

    def phase(w: float) -> float:
        return w * round_trip_s + math.atan2(damping * w, stiffness - mass * w * w) - math.pi

    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if phase(middle) < 0.0 else (low, middle)
    w = 0.5 * (low + high)
    return math.hypot(stiffness - mass * w * w, damping * w)


def _leader(start: CouplingStart[BilateralTuning]) -> BilateralEnd:
    return ForceLeader(start.tuning.leader_stiffness_N_m, start.tuning.follower_lead_s)


def _follower(start: CouplingStart[BilateralTuning]) -> BilateralEnd:
    return ForceFollower(start.tuning.follower_stiffness_N_m, 0.0)


LAW = between_robots(
    "pf",
    "position-force",
    "Lawrence 1993",
    (_leader, _follower),
    BilateralTuning,
    tune,
    world_sends=messages.Proxy,
    springs=lambda params, tuning: (largest(params.world.stiffness),),
    senses=True,
)
