"""A side's account, reported to its peer while both run and at the end, until the peer has answered. No clock.

An account is the sender's own claim, and nothing in the protocol depends on it. The newest account counts. A side
whose account is final requests an answer, and repeats it every `REPEAT_NS` until one comes. An answer is an account
too, made after the account that it answers: so it covers all earlier time, though the two sides have no common clock.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from hapnet.errors import BadMessage
from hapnet.wire.fields import Signal
from hapnet.wire.messages import Account

REPEAT_NS = 100_000_000
KEPT = ("ledger.margin_J", "ledger.slack_J", "sent_nJ", "credited_nJ")
"""The values that stay of the last account of an earlier peer."""


class Heard(NamedTuple):
    """The newest account of the peer. came_ns : when it came. covers : made after this side's newest came."""

    number: int
    values: Mapping[str, Signal]
    final: bool
    came_ns: int
    covers: int


class AccountExchange:
    """The accounts of one side, in both directions.

    Attributes
    ----------
    heard : the newest account of the peer, or of the last peer if there is none now; None: none came.
    owes : the peer has requested an account, and none was sent since.
    former : the last account of each earlier peer that reported one, with the values in `KEPT`.
    """

    def __init__(self) -> None:
        self.heard: Heard | None = None
        self.owes: bool = False
        self.former: list[Heard] = []
        self._values: dict[str, Signal] = {}
        self._number = self._answered = self._first_final = self._newest = self._reported_heard = 0
        self._final = False
        self._due_ns: int | None = None

    def report(self, values: Mapping[str, Signal], *, final: bool) -> None:
        """Send the peer this account, made now. A final account that has not changed keeps its number."""
        if not (final and self._final and dict(values) == self._values):
            self._number += 1
            self._values = dict(values)
        if final and not self._final:
            self._first_final = self._number
        self._final = final
        self._reported_heard, self.owes, self._due_ns = self._newest, False, 0

    @property
    def known(self) -> bool:
        """Whether the peer has answered the newest account, a final one. True also if the peer never reported, as then
        no answer will come.
        """
        return self.heard is None or (self._final and self._answered >= self._number)

    @property
    def whole(self) -> bool:
        """Whether the newest account of the peer covers all of this side's time: it is final, or answers a final
        account.
        """
        heard = self.heard
        return heard is not None and (heard.final or 0 < self._first_final <= heard.covers)

    def receive(self, message: Account, now_ns: int) -> None:
        """Take an account of the peer.

        Raises BadMessage: it is older than an earlier one, or answers an account that was never sent.
        """
        if message.heard > self._number:
            raise BadMessage("range", f"an account that answers {message.heard}; allowed: up to {self._number}")
        if message.number < self._newest or not message.number:
            raise BadMessage("stale", f"account {message.number} comes after a later one")
        covers = message.heard
        if self.heard is not None and message.number == self._newest:  # repeated, or answered once more
            covers = max(covers, self.heard.covers)
        self._newest = message.number
        self._answered = max(self._answered, message.heard)
        self.owes = self.owes or message.asks
        self.heard = Heard(message.number, message.values, message.final, now_ns, covers)

    def poll(self, now_ns: int) -> tuple[int, int, bool, bool, dict[str, Signal]] | None:
        """Return the elements of an `Account` to send now, from its number on; None: nothing is due."""
        if self._due_ns is None or now_ns < self._due_ns:
            return None
        asks = self._final and self._answered < self._number
        if self._due_ns and not asks:  # it was answered before it was due again
            self._due_ns = None
            return None
        self._due_ns = now_ns + REPEAT_NS if asks else None
        return self._number, self._reported_heard, asks, self._final, self._values

    @property
    def next_due_ns(self) -> int | None:
        """The time to call `poll` next; None: nothing is planned."""
        return self._due_ns

    def change_pair(self, *, paired: bool) -> None:
        """Forget the accounts exchanged with the last peer, if there is a new one; without a peer the last account
        stays."""
        self.owes, self._due_ns, self._answered = False, None, 0
        if paired:
            if (heard := self.heard) is not None:
                kept = {name: heard.values[name] for name in KEPT if name in heard.values}
                self.former.append(heard._replace(values=kept))
            self.heard, self._newest, self._reported_heard = None, 0, 0
