"""The running energy account of one side, and its half of Theorem 1.

With W the energy put in at this side's port since the start, V the energy stored in the device (or virtual mass) and
its spring, E the reservoir's content, and the energy credited from and sent to the other side:

    margin = W + V(0) + E(0) + credited - sent        the rest of this side's share of the bound
    slack  = margin - V - E                            the theorem's half: never below zero

Each process checks its own half, without a common clock. The halves add up to the theorem because a side never
credits more energy than the other has sent.
"""

from __future__ import annotations

import math

from hapnet.records.record import Record, equation


class Ledger(Record):
    """The energy account of one side; all values in joules.

    stored : V(0): kinetic and potential energy at the start.
    reservoir : E(0).

    Attributes
    ----------
    bound : this side's share of d^2: V(0) + E(0).
    stored : V at the last `observe`, or at the start. reservoir : E likewise; a deficit counts as negative.
    carry, credited_carry, sent_carry : excess in the sums by rounding, for compensated summation (Kahan): rounding
        stays negligible after days of ticks.
    """

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

    def __init__(self, stored: float, reservoir: float) -> None:
        super().__init__()
        self.bound = self.margin = self.margin_min = stored + reservoir
        self.slack_min = math.inf
        self.stored, self.reservoir = stored, reservoir

    def credit(self, energy: float) -> None:
        """Add energy received from the other side, each joule once."""
        credit(self, energy)

    def send(self, energy: float) -> None:
        """Add energy shuffled to the other side."""
        send(self, energy)

    def put_in(self, work: float) -> None:
        """Add the work done on this side at its port since the last call; negative if the side output energy."""
        put_in(self, work)

    def observe(self, stored: float, reservoir: float) -> None:
        """Update margin and slack with the present V and E (a deficit counts as negative)."""
        observe(self, stored, reservoir)


@equation
def credit(ledger: Ledger, energy: float) -> None:
    """Add energy received from the other side: `Ledger.credit`."""
    ledger.credited, ledger.credited_carry = _added(ledger.credited, energy, ledger.credited_carry)


@equation
def send(ledger: Ledger, energy: float) -> None:
    """Add energy shuffled to the other side: `Ledger.send`."""
    ledger.sent, ledger.sent_carry = _added(ledger.sent, energy, ledger.sent_carry)


@equation
def put_in(ledger: Ledger, work: float) -> None:
    """Add work done on this side at its port: `Ledger.put_in`."""
    ledger.work, ledger.carry = _added(ledger.work, work, ledger.carry)


@equation
def observe(ledger: Ledger, stored: float, reservoir: float) -> None:
    """Update margin and slack with the present V and E: `Ledger.observe`."""
    margin = ledger.work + ledger.bound + ledger.credited - ledger.sent
    slack = margin - stored - reservoir
    ledger.margin = margin
    ledger.slack = slack
    ledger.stored = stored
    ledger.reservoir = reservoir
    if margin < ledger.margin_min:
        ledger.margin_min = margin
    if slack < ledger.slack_min:
        ledger.slack_min = slack


@equation
def _added(total: float, term: float, carry: float) -> tuple[float, float]:
    """Kahan summation: the new total, and the error that rounding added to it."""
    term -= carry
    new = total + term
    return new, (new - total) - term
