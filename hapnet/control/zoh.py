"""PSPM off: the plain virtual coupling, ybar = y, for comparison.

The same spring, the same ledger and the same bound, but no reservoir is charged or paid from: E stays E(0), nothing is
harvested, sent or credited. On bad links its margin goes below zero.
"""

from __future__ import annotations

from hapnet.checks import Vector
from hapnet.control.pspm import Modulation
from hapnet.mechanics.spring import Spring


class ZeroOrderHold:
    """Stands where `SetPositionModulator` stands and takes every set-position as it comes.

    Parameters
    ----------
    spring : the coupling spring.
    position : x(0) [m].
    energy : E(0) [J], counted in the bound as PSPM's is.
    """

    __slots__ = ("deficit", "energy", "set_position", "spring")

    def __init__(self, spring: Spring, position: Vector, energy: float) -> None:
        self.spring = spring
        self.set_position = position
        self.energy = energy
        self.deficit = 0.0

    @property
    def account(self) -> float:
        return self.energy

    def modulate(self, y: Vector, x: Vector, dissipated: float, received: float, keep: float = 0.0) -> Modulation:
        """ybar = y; the energies are left alone."""
        before = self.spring.between(self.set_position, x)
        self.set_position = y
        jump = self.spring.between(y, x) - before
        return Modulation(y, self.energy, 0.0, 0.0, 0.0, jump)

    def split_reservoir(self, most: float = 0.0) -> float:
        """Nothing: there is no reservoir [J]."""
        return 0.0
