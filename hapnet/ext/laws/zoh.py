"""The plain virtual coupling (Colgate, Stanley, Brown 1995): a spring on each side, tied to the newest set-position.

Its parameters are those of the springs, `device` and `world`.
"""

from __future__ import annotations

from hapnet.couplings import rendering
from hapnet.couplings.rendering import RenderingTuning
from hapnet.couplings.set_position import BOTH_SIDES, ends, plain
from hapnet.couplings.spec import CouplingSpec, two_springs

_ENDS = ends(plain)

LAW = CouplingSpec(
    name="zoh",
    title="virtual coupling, held",
    source="Colgate, Stanley, Brown 1995",
    claim="passive without delay, with a new position every tick, if the device's own damping exceeds K T/2 + B",
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
    joint=False,
    compiled=(None, None),
    searched=rendering.SEARCHED,
)
