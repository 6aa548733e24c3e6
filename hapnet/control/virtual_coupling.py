"""The device's end of a plain virtual coupling, its force held from tick to tick: f = -K (x - y) - B v.

y is the newest position that the world sent (Colgate, Stanley, Brown 1995). Nothing keeps it passive over a network; a
law that is to do so is added to it.
"""

from __future__ import annotations

from operator import mul, sub

from hapnet.checks import Vector
from hapnet.control.coupling import CouplingSample, Motion, Port, Wave
from hapnet.mechanics.spring import Spring


class VirtualCoupling:
    """A spring, which may saturate, and a damper to the newest position.

    Parameters
    ----------
    spring : K. damping : B's diagonal [Ns/m]. position : x(0) [m], where it is at rest.
    """

    def __init__(self, spring: Spring, damping: Vector, position: Vector) -> None:
        self.set_position = self.position = position
        self._spring = spring
        self._damping = damping

    def receive(self, sample: CouplingSample) -> None:
        """A position came [m]."""
        assert not isinstance(sample, Motion | Port | Wave), "a bare position is what the world sends here"
        self.set_position = sample

    def on_peer_changed(self) -> None:
        """Positions need no count: another peer's go on where the first one's ended."""

    def next_sample(self, x: Vector, v: Vector) -> CouplingSample:
        """The position [m]."""
        return x

    def coupled(self, x: Vector, v: Vector) -> Vector:
        """The spring's and the damper's force [N] at x [m] and v [m/s]."""
        spring = self._spring.force(tuple(map(sub, x, self.set_position)))
        return tuple(map(sub, spring, map(mul, self._damping, v)))

    def moved(self, x: Vector) -> Vector:
        """Way from the last measured position to x, which takes its place [m]."""
        before, self.position = self.position, x
        return tuple(map(sub, x, before))
