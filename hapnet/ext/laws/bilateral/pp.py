"""Position-position: each robot's spring and damper are tied to the other robot's motion (Lawrence, IEEE T-RA 9(5),
1993, the position error architecture; it needs no force sensor, and most pairs of arms run it).

    F_l = K_l (x_f - x_l) + B_l (v_f - v_l),    F_f = K_f (x_l - x_f) + B_f (v_l - v_f)

Each side sends ``x + (B/K) v`` with the other side's B and K, so one position carries both terms. At rest and without
delay a hand that pushes the leader against a wall K_w feels K_l, K_f and K_w: with x_f = K_f x_l/(K_f + K_w) the force
is K_l K_w x_l/(K_f + K_w).

With a round trip R the two springs give out energy: bare, the pair vibrates where K_l R is not small against the
damping (Lee, Spong 2006: passive for a damping of at least K R/2 on each side).
"""

from __future__ import annotations

from hapnet.control.samples import CouplingSample
from hapnet.couplings.spec import CouplingStart, two_springs
from hapnet.ext.laws.parts.bilateral_port import (
    BilateralEnd,
    BilateralTuning,
    between_robots,
    led,
    tune,
)


class PositionEnd(BilateralEnd):
    """Either end: a spring to the place that the other end sent.

    stiffness : K of this end [N/m]. lead_s : B/K of the other end [s].
    """

    def __init__(self, stiffness: float, lead_s: float) -> None:
        super().__init__(stiffness)
        self._lead_s = lead_s

    def pull(self) -> tuple[float, ...]:
        return tuple([self.stiffness * (y - x) for y, x in zip(self.peer, self.x, strict=True)])

    def content(self, level: float | None) -> CouplingSample:
        return led(self.x, self._lead_s, self.v, level)


def _leader(start: CouplingStart[BilateralTuning]) -> BilateralEnd:
    return PositionEnd(start.tuning.leader_stiffness_N_m, start.tuning.follower_lead_s)


def _follower(start: CouplingStart[BilateralTuning]) -> BilateralEnd:
    return PositionEnd(start.tuning.follower_stiffness_N_m, start.tuning.leader_lead_s)


LAW = between_robots(
    "pp",
    "position-position",
    "Lawrence 1993",
    (_leader, _follower),
    BilateralTuning,
    tune,
    scaled=True,
    springs=two_springs,
)
