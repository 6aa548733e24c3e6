"""Is the peer heard, since when not, and what was lost meanwhile.

Only a new position is a sign of life: a replayed frame, or one that a process left behind when it died, is none.
"""

from __future__ import annotations

from dataclasses import dataclass

from hapnet.wire.events import PeerHeard, PeerSilent
from hapnet.wire.numbering import Numbering


@dataclass(frozen=True, slots=True)
class Outages:
    """What a side had to do without so far, over all pairs."""

    count: int
    """Silences: those that ended, and the one that lasts."""
    longest_ns: int
    total_ns: int
    recovery_max_ns: int
    """The longest time from the other side's first word after a silence, of whatever kind, to its first position."""
    received: int
    """Positions that were newer than all before them."""
    missing: int
    """Positions between these that had not come before them: lost, or overtaken."""


LIVING_NS = 500_000_000
"""A peer that was heard within that is alive, however short or long a silence the user asks for."""


class PeerMonitor:
    """Keeps the time of what is heard, and its numbers.

    Parameters
    ----------
    silence_ns : the peer is silent when no new position came for longer.
    living_ns : nobody may take its place until none came for longer.

    Attributes
    ----------
    numbers : of the pair's positions.
    """

    def __init__(self, silence_ns: int, living_ns: int = LIVING_NS) -> None:
        self._silence_ns, self._living_ns = silence_ns, living_ns
        self._life_ns: int | None = None  # of the last new position, or of the pair's beginning
        self._heard_ns: int | None = None  # the same, but a new pair does not end a silence
        self.numbers = Numbering()  # what came before the pair's first position was not for this side
        self._told = False
        self._word_ns: int | None = None
        self._count = self._longest_ns = self._total_ns = self._recovery_max_ns = self._received = self._missing = 0

    @property
    def heard_ns(self) -> int | None:
        """When the last new position came, or the first pair began."""
        return self._heard_ns

    def begin(self, now_ns: int) -> None:
        """A pair begins, and positions are numbered anew."""
        self._life_ns = now_ns
        if self._heard_ns is None:
            self._heard_ns = now_ns
        self.numbers = Numbering()
        self.on_any_message(now_ns)

    def on_any_message(self, now_ns: int) -> None:
        """Something came from the other side, a position or not, from the peer or from one that may become it."""
        if self._word_ns is None and self._heard_ns is not None and now_ns - self._heard_ns > self._silence_ns:
            self._word_ns = now_ns

    def on_position(self, now_ns: int, since: int) -> PeerHeard | None:
        """A new position came, `since` numbers after the one before; what it ends, if that was a silence.

        `since` is negative where another run of numbers is believed that is behind: so many were not missing after all.
        """
        missing = since - 1 if since > 0 else since
        self._received += 1
        self._missing = max(0, self._missing + missing)
        heard_ns, self._heard_ns, self._life_ns = self._heard_ns, now_ns, now_ns
        if heard_ns is None or now_ns - heard_ns <= self._silence_ns:
            return None
        silence_ns = now_ns - heard_ns
        recovery_ns = 0 if self._word_ns is None else now_ns - self._word_ns
        self._count += 1
        self._longest_ns = max(self._longest_ns, silence_ns)
        self._total_ns += silence_ns
        self._recovery_max_ns = max(self._recovery_max_ns, recovery_ns)
        self._told, self._word_ns = False, None
        return PeerHeard(silence_ns, recovery_ns, max(0, missing))

    def watch(self, now_ns: int) -> PeerSilent | None:
        """A silence that has not been told yet."""
        if self._told or self._heard_ns is None or now_ns - self._heard_ns <= self._silence_ns:
            return None
        self._told = True
        return PeerSilent(self._heard_ns)

    def living(self, now_ns: int) -> bool:
        """Is the peer too young to be called silent, or was it heard lately?"""
        return self._life_ns is not None and now_ns - self._life_ns <= self._living_ns

    def outages(self, now_ns: int) -> Outages:
        """The account at `now_ns`, a silence that lasts included."""
        lasting_ns = 0 if self._heard_ns is None else now_ns - self._heard_ns
        if lasting_ns <= self._silence_ns:
            lasting_ns = 0
        return Outages(
            self._count + (lasting_ns > 0),
            max(self._longest_ns, lasting_ns),
            self._total_ns + lasting_ns,
            self._recovery_max_ns,
            self._received,
            self._missing,
        )
