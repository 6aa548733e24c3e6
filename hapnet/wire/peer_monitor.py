"""Monitor the peer: whether it is silent, how long its silences lasted, and how many positions were lost meanwhile.

Only a new position shows that the peer is alive: a repeated frame, or an old frame of a dead process, does not.
"""

from __future__ import annotations

from dataclasses import dataclass

from hapnet.records.record import NEVER, Record, equation
from hapnet.wire.events import PeerHeard, PeerSilent
from hapnet.wire.numbering import Numbering


@dataclass(frozen=True, slots=True)
class Outages:
    """The silences and losses of a side so far, over all pairs."""

    count: int
    """Silences that ended, and the silence that still lasts, if any."""
    max_ns: int
    total_ns: int
    recovery_max_ns: int
    """The longest time from the other side's first message after a silence, of any kind, to its first position."""
    received: int
    """Positions that were newer than all before them."""
    missing: int
    """Positions that were not used: they were lost, or came late."""


LIVING_NS = 500_000_000
"""A peer with a new position within this time is alive, whatever silence the user sets."""


class PeerMonitor(Record):
    """Monitors the times and the numbers of the peer's messages.

    silence_ns : after this time without a new position the peer is silent.
    living_ns : after this time without a new position another may take its place.

    Attributes
    ----------
    numbers : the numbering of the present pair's stream.
    life_ns : when the last new position came, or the pair began. last_ns : the same, but a new pair does not end a
        silence. sign_ns : when the first message of any kind came in this silence. `NEVER`: there was none.
    reported : whether the present silence was reported.
    silences, max_ns, total_ns, recovery_max_ns, received, missing : the values of `Outages`, for ended silences.
    ended_ns, recovery_ns, missed : the figures of the silence that the last new position ended; ended_ns 0: none.
    """

    silence_ns: int
    life_ns: int
    last_ns: int
    sign_ns: int
    reported: int
    silences: int
    max_ns: int
    total_ns: int
    recovery_max_ns: int
    received: int
    missing: int
    ended_ns: int
    recovery_ns: int
    missed: int
    numbers: Numbering

    def __init__(self, silence_ns: int, living_ns: int = LIVING_NS) -> None:
        super().__init__()
        self.silence_ns = silence_ns
        self._living_ns = living_ns
        self._left_ns: int | None = None
        self.life_ns = self.last_ns = self.sign_ns = NEVER
        self.numbers = Numbering()

    @property
    def heard_ns(self) -> int | None:
        """The time at which the last new position came, or the first pair began."""
        return None if self.last_ns == NEVER else self.last_ns

    def begin(self, now_ns: int) -> None:
        """Begin a pair, with a numbering of its own."""
        self.life_ns = now_ns
        if self.last_ns == NEVER:
            self.last_ns = now_ns
        self.numbers = Numbering()
        self.on_any_message(now_ns)

    @equation
    def on_any_message(self, now_ns: int) -> None:
        """Enter a message of any kind from the peer, or from a side that may become the peer."""
        if now_ns - self.last_ns > self.silence_ns and self.sign_ns == NEVER:
            self.sign_ns = now_ns

    def on_position(self, now_ns: int, since: int) -> PeerHeard | None:
        """Enter a new position, `since` numbers after the previous one; returns the silence that it ends, if any.

        `since` is negative if the numbering went back to another run: so many positions were not missing.
        """
        on_position(self, now_ns, since)
        return self.ended

    @property
    def ended(self) -> PeerHeard | None:
        """The silence that the last new position ended, if any."""
        return PeerHeard(self.ended_ns, self.recovery_ns, self.missed) if self.ended_ns else None

    def watch(self, now_ns: int) -> PeerSilent | None:
        """Return the present silence, if it was not reported yet."""
        if self.reported or not self.is_silent(now_ns):
            return None
        self.reported = 1
        return PeerSilent(self.last_ns)

    def is_silent(self, now_ns: int) -> bool:
        """Whether no new position came for `silence_ns`."""
        return now_ns - self.last_ns > self.silence_ns

    def living(self, now_ns: int) -> bool:
        """Whether a new position came, or the pair began, within `living_ns`."""
        return self.life_ns != NEVER and now_ns - self.life_ns <= self._living_ns

    def leave(self, now_ns: int) -> None:
        """Enter that this side ends: a later silence of the peer, which may end too, is no outage."""
        self._left_ns = now_ns

    def outages(self, now_ns: int) -> Outages:
        """The outages at `now_ns`, with a silence that still lasts, or lasted when this side began to end."""
        lasting_ns = (now_ns if self._left_ns is None else min(now_ns, self._left_ns)) - self.last_ns
        if lasting_ns <= self.silence_ns:
            lasting_ns = 0
        return Outages(
            self.silences + (lasting_ns > 0),
            max(self.max_ns, lasting_ns),
            self.total_ns + lasting_ns,
            self.recovery_max_ns,
            self.received,
            self.missing,
        )


@equation
def on_position(monitor: PeerMonitor, now_ns: int, since: int) -> None:
    """Enter a new position, and return the silence that it ends, if any: `PeerMonitor.on_position`."""
    missing = since - 1 if since > 0 else since
    monitor.received += 1
    if missing:
        monitor.missing = max(0, monitor.missing + missing)
    silence_ns = now_ns - monitor.last_ns
    monitor.last_ns = monitor.life_ns = now_ns
    monitor.ended_ns = 0
    if silence_ns <= monitor.silence_ns:
        return
    recovery_ns = 0 if monitor.sign_ns == NEVER else now_ns - monitor.sign_ns
    monitor.silences += 1
    monitor.max_ns = max(monitor.max_ns, silence_ns)
    monitor.total_ns += silence_ns
    monitor.recovery_max_ns = max(monitor.recovery_max_ns, recovery_ns)
    monitor.reported, monitor.sign_ns = 0, NEVER
    monitor.ended_ns, monitor.recovery_ns, monitor.missed = silence_ns, recovery_ns, max(0, missing)


on_any_message = PeerMonitor.on_any_message
"""These methods as functions, for calls from equations."""
