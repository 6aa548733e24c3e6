"""The device's end of a plain virtual coupling, with its force held from tick to tick: f = -K (x - y) - B v.

y is the newest position that the world sent (Colgate, Stanley, Brown 1995). Nothing here makes it passive over a
network; PO/PC and energy bounding add that.
"""

from __future__ import annotations

from hapnet.checks import Vector
from hapnet.control.coupling import CouplingSample, Motion, Port, Position, Proxy, Wave
from hapnet.control.law import DeviceEnd
from hapnet.mechanics import spring as springs
from hapnet.mechanics.spring import Spring
from hapnet.records.equation import equation
from hapnet.records.record import Floats, OfAxes, Reals
from hapnet.records.vectors import copy


class VirtualCoupling(DeviceEnd):
    """A spring, which may saturate, tied to the newest position, and a damper.

    Parameters
    ----------
    spring : K. damping : B's diagonal [Ns/m]. position : x(0) [m], where it starts at rest.

    Attributes
    ----------
    position : the last measured one [m]. moved : from the one before [m]. energies : a law's account of each axis [J].
    """

    spring: Spring
    damping: OfAxes
    position: OfAxes
    moved: OfAxes
    energies: OfAxes

    def __init__(self, spring: Spring, damping: Vector, position: Vector) -> None:
        super().__init__(position)
        self.spring, self.damping, self.position = spring, list(damping), list(position)
        self.moved, self.energies = [0.0] * self.n, [0.0] * self.n

    def receive(self, sample: CouplingSample) -> None:
        """A position arrived [m]."""
        assert not isinstance(sample, Position | Motion | Port | Wave | Proxy), "the world sends bare positions here"
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
        copy(self.n, x, self.said.value)

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
