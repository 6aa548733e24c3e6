"""Passive set-position modulation (Lee, Huang 2009): each side's spring end moves as far as its reservoir can pay.

Algorithm 1, which modulates a set-position, is in hapnet/control/pspm.py; servo, world and compiled code use it.
The parameters are those of each side's spring and reservoir, in `device` and `world`.
"""

from __future__ import annotations

from hapnet.checks import Vector
from hapnet.control.pspm import SetPositionModulator
from hapnet.control.reserve import Holding
from hapnet.control.set_position_coupling import Modulator
from hapnet.couplings import rendering
from hapnet.couplings.rendering import RenderingTuning
from hapnet.couplings.set_position import BOTH_SIDES, Side, ends
from hapnet.couplings.spec import CouplingSpec, two_springs
from hapnet.mechanics.spring import Spring
from hapnet.params import Params, WorldParams


def modulator(
    side: Side, spring: Spring, position: Vector, energy: float, reserve: float, holding: Holding | None
) -> Modulator:
    """The `MakeModulator` of PSPM."""
    return SetPositionModulator(
        stiffness=side.stiffness,
        position=position,
        ceiling=side.ceiling_J,
        shuffle="all" if side.shuffle == "all" else "harvested",
        force_limit=spring.force_limit,
        energy=energy,
        reserve=reserve,
        held_m=0.0 if holding is None else holding.far,
        drag_N=0.0 if holding is None else holding.drag,
        injects=isinstance(side, WorldParams),
    )


def _covers(params: Params, tuning: RenderingTuning, virtual: bool) -> bool:
    """True, except with the range harvest under zero-order hold, which relies on own damping (`held_torque.check`)."""
    device = params.device
    sampled = device.servo == "sampled" or (device.servo == "auto" and (tuning.contact_model or not virtual))
    return not (sampled and device.harvest == "range")


_ENDS = ends(modulator)

LAW = CouplingSpec(
    name="pspm",
    title="passive set-position modulation",
    source="Lee, Huang 2009",
    claim="passive at both ports, whatever the link does",
    device=_ENDS.device,
    world=_ENDS.world,
    continuous=_ENDS.continuous,
    follower=_ENDS.follower,
    tuning=RenderingTuning,
    tune=rendering.tune,
    shared=("contact_model",),
    sends_planes=True,
    set_positions=BOTH_SIDES,
    scaled=True,
    springs=two_springs,
    halves=True,
    joint=False,
    covers=_covers,
    compiled=(None, None),
    searched=rendering.SEARCHED,
)
