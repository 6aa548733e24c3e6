"""The device's end of a plain virtual coupling, with its force held from tick to tick: f = -K (x - y) - B v.

y is the newest position that the world sent (Colgate, Stanley, Brown 1995). This alone is not passive over a network;
PO/PC and energy bounding make it passive, each with an account of the energy that the hand put in, axis by axis.

Both laws' authors bound this account: otherwise energy put in long ago would pay for energy that comes out now. After a
while without force nothing is touched, and a surplus is dropped (`Reset`; Hannaford and Ryu 2002 reset their observer
in this way; energy bounding for several axes restarts after a tick without force). A debt remains. So a law's claim
about its port also holds from each reset on.
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
    """The condition in which a law's account of an axis drops a surplus."""

    below_N: float = 0.0
    """A force below this counts as no force [N]; 0: the account never drops its surplus."""
    after_s: float = math.inf
    """The time without force after which the surplus is dropped [s]; 0: after a tick."""


NEVER = Reset()


class VirtualCoupling(DeviceEnd):
    """A spring, which may saturate, tied to the newest position, and a damper.

    spring : K. damping : B's diagonal [Ns/m]. position : x(0) [m], where it starts at rest. reset : of the account.

    Attributes
    ----------
    position : the last measured position [m]. moved : the way from the position before [m]. energies : a law's account
    of each axis [J]. idle : the time that each axis has had no force [s].
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
        """Take in a position [m]."""
        assert not isinstance(sample, PositionSample | MotionSample | PortSample | WaveSample | ProxySample), (
            "the world sends bare positions here"
        )
        self.y[:] = sample

    @equation
    def take(self, value: Reals, more: Reals, amount: float, total_s: float) -> None:
        """Take in a position [m]."""
        copy(self.n, value, self.y)

    def on_peer_changed(self) -> None:
        """Do nothing: positions are not counted, so a new peer's positions simply continue the old peer's."""

    @equation
    def set_outgoing(self, x: Reals, v: Reals) -> None:
        """Write the measured position [m] into `outgoing`."""
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
    """Store the way from the last measured position to x [m]; x becomes the last position."""
    for i in range(law.n):
        law.moved[i] = x[i] - law.position[i]
        law.position[i] = x[i]


@equation
def forget(law: VirtualCoupling, dt: float, held: Reals) -> None:
    """Drop the surplus of each axis without force for longer than `after_s`; `held` was the force for `dt` seconds."""
    for i in range(law.n):
        law.idle[i] = law.idle[i] + dt if abs(held[i]) < law.below_N else 0.0
        if law.idle[i] > law.after_s:
            law.idle[i], law.energies[i] = 0.0, min(law.energies[i], 0.0)
