"""The device's end of a plain virtual coupling, with its force held from tick to tick: f = -K (x - y) - B v.

y is the newest position that the world sent (Colgate, Stanley, Brown 1995). Nothing here makes it passive over a
network; PO/PC and energy bounding add that, each with an account of the energy that the hand put in, axis by axis.

Both laws' authors bound that account: energy put in long ago would otherwise pay for what is given out now. Where no
force was rendered for a while, nothing is being touched, and a surplus is forgotten (`Reset`; Hannaford and Ryu 2002
reset their observer so; energy bounding for several axes begins anew after a tick without force). A debt stays. So
what a law claims of its port then holds from each reset on, too.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from hapnet.checks import Vector
from hapnet.control.coupling import CouplingSample, MotionSample, PortSample, PositionSample, ProxySample, WaveSample
from hapnet.control.law import DeviceEnd
from hapnet.mechanics import spring as springs
from hapnet.mechanics.spring import Spring
from hapnet.records.record import Floats, OfAxes, Reals, equation
from hapnet.records.vectors import copy


class Reset(NamedTuple):
    """When a law's account of an axis forgets a surplus."""

    below_N: float = 0.0
    """A force below this counts as none [N]; 0: none does."""
    after_s: float = math.inf
    """For longer than this there was none [s]; 0: for one tick."""


NEVER = Reset()


class VirtualCoupling(DeviceEnd):
    """A spring, which may saturate, tied to the newest position, and a damper.

    spring : K. damping : B's diagonal [Ns/m]. position : x(0) [m], where it starts at rest. reset : of the account.

    Attributes
    ----------
    position : the last measured one [m]. moved : from the one before [m]. energies : a law's account of each axis [J].
    idle : how long each axis has had no force [s].
    """

    spring: Spring
    damping: OfAxes
    position: OfAxes
    moved: OfAxes
    energies: OfAxes
    idle: OfAxes
    below_N: float
    after_s: float

    def __init__(self, spring: Spring, damping: Vector, position: Vector, reset: Reset = NEVER) -> None:
        super().__init__(position)
        self.spring, self.damping, self.position = spring, list(damping), list(position)
        self.moved, self.energies, self.idle = [0.0] * self.n, [0.0] * self.n, [0.0] * self.n
        self.below_N, self.after_s = reset

    def receive(self, sample: CouplingSample) -> None:
        """A position arrived [m]."""
        assert not isinstance(sample, PositionSample | MotionSample | PortSample | WaveSample | ProxySample), (
            "the world sends bare positions here"
        )
        self.y[:] = sample

    @equation
    def take(self, value: Reals, more: Reals, amount: float, total_s: float) -> None:
        """A position arrived [m]."""
        copy(self.n, value, self.y)

    def on_peer_changed(self) -> None:
        """Do nothing: positions are not counted, so the new peer's simply continue the old one's."""

    @equation
    def say(self, x: Reals, v: Reals) -> None:
        """The measured position [m]."""
        copy(self.n, x, self.outgoing.value)

    def coupled(self, x: Vector, v: Vector) -> Vector:
        """The spring's and the damper's force [N] at x [m] and v [m/s]."""
        couple(self, x, v, self.out)
        return tuple(self.out)

    def untie(self, x: Vector) -> None:
        """Tie the spring to x [m] until a sample arrives."""
        self.y[:] = x


@equation
def couple(law: VirtualCoupling, x: Reals, v: Reals, out: Floats) -> None:
    """The spring's and the damper's force [N] at x [m] and v [m/s]."""
    springs.force(law.spring, x, law.y, out)
    for i in range(law.n):
        out[i] = out[i] - law.damping[i] * v[i]


@equation
def pass_to(law: VirtualCoupling, x: Reals) -> None:
    """The path from the last measured position to x [m]; x becomes the last position."""
    for i in range(law.n):
        law.moved[i] = x[i] - law.position[i]
        law.position[i] = x[i]


@equation
def forget(law: VirtualCoupling, dt: float, held: Reals) -> None:
    """`held` was rendered for dt. The surplus of an axis that has had no force for so long is forgotten."""
    for i in range(law.n):
        law.idle[i] = law.idle[i] + dt if abs(held[i]) < law.below_N else 0.0
        if law.idle[i] > law.after_s:
            law.idle[i], law.energies[i] = 0.0, min(law.energies[i], 0.0)
