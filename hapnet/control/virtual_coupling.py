"""The device's end of a plain virtual coupling, with its force held from tick to tick: f = -K (x - y) - B v.

y is the newest position that the world sent (Colgate, Stanley, Brown 1995). Nothing here makes it passive over a
network; PO/PC and energy bounding add that.
"""

from __future__ import annotations

from operator import mul, sub

from hapnet.checks import Vector
from hapnet.control.coupling import CouplingSample, Motion, Port, Position, Proxy, Wave
from hapnet.mechanics.spring import Spring


class VirtualCoupling:
    """A spring, which may saturate, tied to the newest position, and a damper.

    Parameters
    ----------
    spring : K. damping : B's diagonal [Ns/m]. position : x(0) [m], where it starts at rest.
    """

    def __init__(self, spring: Spring, damping: Vector, position: Vector) -> None:
        self.set_position: Vector = position
        self.position: Vector = position
        self._spring = spring
        self._damping = damping

    def receive(self, sample: CouplingSample) -> None:
        """A position arrived [m]."""
        assert not isinstance(sample, Position | Motion | Port | Wave | Proxy), "the world sends bare positions here"
        self.set_position = sample

    def on_peer_changed(self) -> None:
        """Do nothing: positions are not counted, so the new peer's simply continue the old one's."""

    def next_sample(self, x: Vector, v: Vector) -> CouplingSample:
        """The measured position [m]."""
        return x

    def coupled(self, x: Vector, v: Vector) -> Vector:
        """The spring's and the damper's force [N] at x [m] and v [m/s]."""
        return tuple(map(sub, self._spring.force(self.set_position, x), map(mul, self._damping, v)))

    def moved(self, x: Vector) -> Vector:
        """Displacement from the last measured position to x [m]; x becomes the last position."""
        before, self.position = self.position, x
        return tuple(map(sub, x, before))
