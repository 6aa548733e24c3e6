"""PSPM off: the plain virtual coupling, ybar = y, for comparison.

It has the same spring, ledger and bound, but does not use the reservoir: E stays E(0), and nothing is harvested, sent
or credited. On bad links its margin falls below zero.
"""

from __future__ import annotations

from hapnet.checks import Vector
from hapnet.control.pspm import Modulation
from hapnet.mechanics.spring import Spring


class ZeroOrderHold:
    """Replaces `SetPositionModulator` and accepts every set-position unchanged.

    Parameters
    ----------
    spring : the coupling spring.
    position : x(0) [m].
    energy : E(0) [J], counted in the bound as with PSPM.
    """

    __slots__ = ("deficit", "energy", "set_position", "spring")
    level: float | None = None
    """None: there is no reservoir to fill."""
    modulated = False

    def __init__(self, spring: Spring, position: Vector, energy: float) -> None:
        self.spring: Spring = spring
        self.set_position: Vector = position
        self.energy: float = energy
        self.deficit: float = 0.0

    @property
    def account(self) -> float:
        return self.energy

    def modulate(self, y: Vector, x: Vector, dissipated: float, received: float, keep: float = 0.0) -> Modulation:
        """Set ybar = y; no energy changes."""
        before = self.spring.between(self.set_position, x)
        self.set_position = y
        jump = self.spring.between(y, x) - before
        return Modulation(y, self.energy, 0.0, 0.0, 0.0, jump)

    def give(self, dt: float, peer_level: float, keep: float) -> float:
        """Zero [J]: there is no reservoir."""
        return 0.0

    def split_reservoir(self, most: float = 0.0) -> float:
        """Zero [J]: there is no reservoir to split."""
        return 0.0
