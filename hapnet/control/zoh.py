"""PSPM off: the plain virtual coupling, ybar = y, for comparison.

It has the same spring, ledger and bound, but does not use the reservoir: E stays E(0), and nothing is harvested, sent
or credited. On bad links its margin falls below zero.
"""

from __future__ import annotations

from hapnet.checks import Vector
from hapnet.control.pspm import Modulation, SetPositionModulator
from hapnet.mechanics.spring import Spring, between
from hapnet.records.record import OfAxes, Reals, Record, equation
from hapnet.records.vectors import copy


class ZeroOrderHold(Record):
    """Replaces `SetPositionModulator` and accepts every set-position unchanged.

    spring : the coupling spring.
    position : x(0) [m].
    energy : E(0) [J], counted in the bound as with PSPM.

    Its fields are those of a `SetPositionModulator`.
    """

    ybar: OfAxes
    energy: float
    deficit: float
    discarded: float
    jump: float
    spring: Spring
    level = None  # there is no reservoir to fill
    modulated = False

    def __init__(self, spring: Spring, position: Vector, energy: float) -> None:
        super().__init__()
        self.ybar, self.energy, self.spring = list(position), energy, spring

    @property
    def set_position(self) -> Vector:
        """ybar [m]."""
        return tuple(self.ybar)

    @property
    def account(self) -> float:
        return self.energy

    def modulate(self, y: Vector, x: Vector, dissipated: float, received: float, keep: float = 0.0) -> Modulation:
        """Set ybar = y; no energy changes."""
        hold(self, y, x)
        return Modulation(self.set_position, self.energy, 0.0, 0.0, 0.0, self.jump)

    def give(self, dt: float, peer_level: float, keep: float) -> float:
        """Zero [J]: there is no reservoir."""
        return 0.0

    def split_reservoir(self, most: float = 0.0) -> float:
        """Zero [J]: there is no reservoir to split."""
        return 0.0


@equation
def hold(m: ZeroOrderHold | SetPositionModulator, y: Reals, x: Reals) -> None:
    """Set ybar = y; no energy changes: `ZeroOrderHold.modulate`."""
    before = between(m.spring, m.ybar, x)
    copy(m.spring.dof, y, m.ybar)
    m.jump = between(m.spring, y, x) - before
