"""The state of one end of a law: its account, its set-position, and its tank if it shuffles energy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, Protocol, TypeVar

from hapnet.checks import Vector
from hapnet.control import ledger as ledgers
from hapnet.control.law import LawAccount
from hapnet.control.ledger import Ledger
from hapnet.control.samples import CouplingSample


class Law(Protocol):
    """The common part of both ends of a law. An end starts at rest at its initial position.

    An end that shuffles energy has a `Tank` as its attribute `tank`.
    """

    @property
    def set_position(self) -> Vector:
        """The point to which the spring is tied [m]: see `CouplingState.set_position`."""

    def receive(self, sample: CouplingSample) -> None:
        """Take in a sample that arrived: see `CouplingState.receive`."""

    def on_peer_changed(self) -> None:
        """Start again with a new peer; its counts start at zero."""


class Tank(Protocol):
    """A law's energy at one side. The work put in at the port and the energy that arrives are added to it.

    level : the energy [J]; at the start this side's share of d^2. figures : as `DeviceCoupling.figures`.
    """

    level: float
    figures: dict[str, Any]

    @property
    def limited_share(self) -> float | None:
        """The share of the ticks or steps in which the energy did not suffice for the law's force; None: no ticks."""

    def give(self, dt: float) -> float:
        """Take out the energy to shuffle now, `dt` seconds after the last time. Returns that energy [J]."""


L = TypeVar("L", bound=Law)
Stamped = Callable[[CouplingSample, float, float], None]


class LawState(LawAccount, Generic[L]):
    """The `CouplingState` of a law.

    law : this end of the law. initial_energy : this side's share of d^2 [J].
    stamped : receives each sample before the law, with its time and its age, as `CouplingState.receive`.

    Attributes
    ----------
    tank : the law's; None: it shuffles no energy.
    """

    def __init__(self, law: L, initial_energy: float, stamped: Stamped | None = None) -> None:
        super().__init__()
        self.law = law
        self.tank: Tank | None = getattr(law, "tank", None)
        self._stamped = stamped
        self.ledger = Ledger(0.0, initial_energy)
        self.account = self.reservoir = self.energy_min = initial_energy
        self.deficit = self.deficit_max = self.discarded = 0.0

    @property
    def modulated_share(self) -> float | None:
        return None if self.tank is None else self.tank.limited_share

    @property
    def set_position(self) -> Vector:
        return self.law.set_position

    @property
    def target(self) -> Vector:
        return self.law.set_position

    def potential(self, x: Vector) -> float:
        """Zero [J]: a law counts the energy of its own springs."""
        return 0.0

    def receive(self, sample: CouplingSample, sent_s: float, age_s: float) -> None:
        if self._stamped is not None:
            self._stamped(sample, sent_s, age_s)
        self.law.receive(sample)

    def credit(self, energy: float) -> None:
        """Add energy that arrived to the tank. A law without a tank ignores it: its peer sends none."""
        if self.tank is not None:
            ledgers.credit(self.ledger, energy)
            self.fill(energy)

    def fill(self, energy: float) -> None:
        """Add energy to the tank [J], if there is one; negative: it came out at the port."""
        if self.tank is not None:
            self.tank.level += energy
            self.account = level = self.tank.level
            self.reservoir, self.deficit = max(0.0, level), max(0.0, -level)
            self.energy_min = min(self.energy_min, self.reservoir)
            self.deficit_max = max(self.deficit_max, self.deficit)

    def give(self, dt: float) -> float:
        """Take the energy to shuffle out of the tank, `dt` seconds after the last time. Returns that energy [J]."""
        if self.tank is None:
            return 0.0
        given = self.tank.give(dt)
        ledgers.send(self.ledger, given)
        self.fill(0.0)
        return given

    def on_peer_changed(self) -> float:
        """Notify the law. Returns zero [J]: a tank sends energy all the time."""
        self.law.on_peer_changed()
        return 0.0
