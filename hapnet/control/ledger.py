"""The running energy account of one side, and its half of Theorem 1.

With W the energy put in at this side's port since the start, V the energy stored in the device (or virtual mass) and
its spring, E the reservoir's content, and the energy credited from and sent to the other side:

    margin = W + V(0) + E(0) + credited - sent        what is left of this side's share of the bound
    slack  = margin - V - E                            the theorem's half: never below zero

Each process checks its own half alone, with no common clock. The halves add up to the theorem because one side never
credits more than the other has sent.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class LedgerState(NamedTuple):
    """`Ledger`'s attributes, and what rounding has added too much to its sums [J]."""

    bound: float
    work: float
    credited: float
    sent: float
    margin: float
    margin_min: float
    slack: float
    slack_min: float
    stored: float
    reservoir: float
    carry: float
    sent_carry: float
    credited_carry: float


class Ledger:
    """Account of one side; all in joules.

    Parameters
    ----------
    stored : V(0): kinetic and potential energy at the start.
    reservoir : E(0).

    Sums are compensated (Kahan), so rounding does not show after days of ticks.
    """

    __slots__ = (
        "_carry", "_credited_carry", "_sent_carry", "bound", "credited", "margin", "margin_min", "reservoir", "sent",
        "slack", "slack_min", "stored", "work",
    )  # fmt: skip

    def __init__(self, stored: float, reservoir: float) -> None:
        self.bound: float = stored + reservoir
        """This side's share of d^2: V(0) + E(0)."""
        self.work: float = 0.0
        self.credited: float = 0.0
        self.sent: float = 0.0
        self.margin: float = self.bound
        self.margin_min: float = self.bound
        self.slack: float = 0.0
        self.slack_min: float = math.inf
        self.stored: float = stored
        """V at the last `observe`, or at the start."""
        self.reservoir: float = reservoir
        """E likewise; a deficit counts as negative."""
        self._carry = self._sent_carry = self._credited_carry = 0.0

    def credit(self, energy: float) -> None:
        """Energy received from the other side, each joule once."""
        self.credited, self._credited_carry = _added(self.credited, energy, self._credited_carry)

    def send(self, energy: float) -> None:
        """Energy shuffled to the other side."""
        self.sent, self._sent_carry = _added(self.sent, energy, self._sent_carry)

    def put_in(self, work: float) -> None:
        """Add the work done on this side at its port since the last call; negative if the side output energy."""
        term = work - self._carry
        total = self.work + term
        self._carry = (total - self.work) - term
        self.work = total

    def observe(self, stored: float, reservoir: float) -> None:
        """Update margin and slack with the present V and E (a deficit counts as negative)."""
        margin = self.work + self.bound + self.credited - self.sent
        slack = margin - stored - reservoir
        self.margin = margin
        self.slack = slack
        self.stored = stored
        self.reservoir = reservoir
        if margin < self.margin_min:
            self.margin_min = margin
        if slack < self.slack_min:
            self.slack_min = slack

    def state(self) -> LedgerState:
        """What `restore` takes."""
        return LedgerState(
            self.bound, self.work, self.credited, self.sent, self.margin, self.margin_min, self.slack, self.slack_min,
            self.stored, self.reservoir, self._carry, self._sent_carry, self._credited_carry,
        )  # fmt: skip

    def restore(self, state: LedgerState) -> None:
        """Go on from there."""
        (
            self.bound, self.work, self.credited, self.sent, self.margin, self.margin_min, self.slack, self.slack_min,
            self.stored, self.reservoir, self._carry, self._sent_carry, self._credited_carry,
        ) = state  # fmt: skip


def _added(total: float, term: float, carry: float) -> tuple[float, float]:
    """Kahan summation: the new total, and the error that rounding added to it."""
    term -= carry
    new = total + term
    return new, (new - total) - term
