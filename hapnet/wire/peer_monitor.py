"""Whether the peer is heard, how long its silences lasted, and what was lost meanwhile.

Only a new position shows that the peer is alive: a repeated frame, or one that a dead process left in the network, does
not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from hapnet.wire.events import PeerHeard, PeerSilent
from hapnet.wire.numbering import Numbering


@dataclass(frozen=True, slots=True)
class Outages:
    """The silences and losses of a side so far, over all pairs."""

    count: int
    """Silences: those that ended, and one that still lasts."""
    longest_ns: int
    total_ns: int
    recovery_max_ns: int
    """The longest time from the other side's first message after a silence, of any kind, to its first position."""
    received: int
    """Positions that were newer than all before them."""
    missing: int
    """Positions that were not used: they were lost, or came late."""


LIVING_NS = 500_000_000
"""A peer that was heard within this time is alive, whatever silence the user asks for."""


class PeerMonitor:
    """Watches when the peer is heard, and the numbers of its messages.

    Parameters
    ----------
    silence_ns : after this time without a new position the peer is silent.
    living_ns : after this time without a new position another may take its place.

    Attributes
    ----------
    numbers : the numbering of the present pair's stream.
    """

    def __init__(self, silence_ns: int, living_ns: int = LIVING_NS) -> None:
        self.silence_ns: Final = silence_ns
        self._living_ns = living_ns
        self._life_ns: int | None = None  # of the last new position, or of the pair's beginning
        self._heard_ns: int | None = None  # the same, but a new pair does not end a silence
        self.numbers: Numbering = Numbering()  # what came before the pair's first position was for somebody else
        self._reported = False
        self._sign_ns: int | None = None  # of the first message of any kind in this silence
        self._count = self._longest_ns = self._total_ns = self._recovery_max_ns = self._received = self._missing = 0

    @property
    def heard_ns(self) -> int | None:
        """When the last new position came, or the first pair began."""
        return self._heard_ns

    def begin(self, now_ns: int) -> None:
        """A pair begins, with a numbering of its own."""
        self._life_ns = now_ns
        if self._heard_ns is None:
            self._heard_ns = now_ns
        self.numbers = Numbering()
        self.on_any_message(now_ns)

    def on_any_message(self, now_ns: int) -> None:
        """A message of any kind came from the other side, from the peer or from one that may become it."""
        if self._sign_ns is None and self._heard_ns is not None and now_ns - self._heard_ns > self.silence_ns:
            self._sign_ns = now_ns

    def on_position(self, now_ns: int, since: int) -> PeerHeard | None:
        """A new position came, `since` numbers after the one before; returns the silence that it ends, if any.

        `since` is negative if the numbering went back to another run: so many were not missing after all.
        """
        missing = since - 1 if since > 0 else since
        self._received += 1
        self._missing = max(0, self._missing + missing)
        heard_ns, self._heard_ns, self._life_ns = self._heard_ns, now_ns, now_ns
        if heard_ns is None or now_ns - heard_ns <= self.silence_ns:
            return None
        silence_ns = now_ns - heard_ns
        recovery_ns = 0 if self._sign_ns is None else now_ns - self._sign_ns
        self._count += 1
        self._longest_ns = max(self._longest_ns, silence_ns)
        self._total_ns += silence_ns
        self._recovery_max_ns = max(self._recovery_max_ns, recovery_ns)
        self._reported, self._sign_ns = False, None
        return PeerHeard(silence_ns, recovery_ns, max(0, missing))

    def resume(self, heard_ns: int, newest: int, received: int, missing: int) -> None:
        """Go on after so many positions that were counted elsewhere, with no silence.

        The newest of them has number `newest` and came at `heard_ns`.
        """
        self._heard_ns = self._life_ns = heard_ns
        self._received += received
        self._missing += missing
        self.numbers.resume(heard_ns, newest)

    def watch(self, now_ns: int) -> PeerSilent | None:
        """The present silence, if it was not reported yet."""
        if self._reported or self._heard_ns is None or now_ns - self._heard_ns <= self.silence_ns:
            return None
        self._reported = True
        return PeerSilent(self._heard_ns)

    def living(self, now_ns: int) -> bool:
        """Was the peer heard lately, or paired lately?"""
        return self._life_ns is not None and now_ns - self._life_ns <= self._living_ns

    def outages(self, now_ns: int) -> Outages:
        """The account at `now_ns`, with a silence that still lasts."""
        lasting_ns = 0 if self._heard_ns is None else now_ns - self._heard_ns
        if lasting_ns <= self.silence_ns:
            lasting_ns = 0
        return Outages(
            self._count + (lasting_ns > 0),
            max(self._longest_ns, lasting_ns),
            self._total_ns + lasting_ns,
            self._recovery_max_ns,
            self._received,
            self._missing,
        )
