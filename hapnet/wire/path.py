"""The path between two sides, as their streams show it without a common clock: round trip, jitter, loss, stalls, age.

A message says when it was sent (`sent_ns`, on its sender's clock), which stamp of this side its sender has used last
(`echo_ns`), and when that stamp had come (`came_ns`, on the sender's clock). If it arrives at `now_ns`, it has measured
a round trip of

    (now_ns - echo_ns) - (sent_ns - came_ns)                                   (RFC 5905, section 8)

This contains neither the difference of the clocks nor the time for which the other side held the stamp. How it splits
into the way there and the way back cannot be known. Of the way to this side only the variation is known: now_ns -
sent_ns, less the least such difference lately. So an age is that variation plus half of the least round trip.

The numbers show what was lost, as in RFC 3550 (section 6.4.1): all numbers between the first and the newest, less those
that came, late or not. All of it is measured from stamp to arrival, so an emulated link is part of the path.
"""

from __future__ import annotations

from dataclasses import dataclass

from hapnet.histogram import Histogram
from hapnet.wire.numbering import Place

STALL_NS = 100_000_000
"""A stall: nothing new came for this much longer than the sender paused. 3GPP TR 22.847 allows no longer delay."""

LONGEST_NS = 60_000_000_000
"""No round trip is longer: an echo that claims it is wrong."""


@dataclass(frozen=True, slots=True)
class PathFigures:
    """A side's path since its start, or its last seconds. Times are in ns, and None before anything is known.

    jitter : how much longer the messages to this side took than the fastest lately.
    age : the age of what this side used, at its oldest: just before the next took its place. A message without jitter
        is assumed to take half of the least round trip.
    """

    round_trip_min_ns: int | None
    round_trip_p50_ns: int | None
    round_trip_p99_ns: int | None
    jitter_p50_ns: int | None
    jitter_p99_ns: int | None
    age_p50_ns: int | None
    age_p99_ns: int | None
    sent: int
    """Messages that the other side has numbered since the first that came here."""
    lost: int
    """How many of these have not come."""
    stalls: int
    """How often nothing new came for `STALL_NS` longer than the sender paused."""
    longest_stall_ns: int


class Counts:
    """All that is counted of a path. The difference of two such counts describes the time between them."""

    def __init__(self) -> None:
        self.trips: Histogram = Histogram()
        self.jitter: Histogram = Histogram()
        self.ages: Histogram = Histogram()
        self.sent = self.came = self.stalls = self.longest_stall_ns = 0

    def since(self, earlier: Counts) -> Counts:
        part = Counts()
        part.trips, part.jitter = self.trips.since(earlier.trips), self.jitter.since(earlier.jitter)
        part.ages = self.ages.since(earlier.ages)
        part.sent, part.came = self.sent - earlier.sent, self.came - earlier.came
        part.stalls = self.stalls - earlier.stalls
        part.longest_stall_ns = self.longest_stall_ns
        return part

    def copy(self) -> Counts:
        return self.since(Counts())


class Path:
    """Measures the path to this side, and the round trip."""

    def __init__(self) -> None:
        self._all = Counts()
        self._least_trip_ns: int | None = None
        self.begin(0)

    def begin(self, now_ns: int) -> None:
        """A pair begins: the peer has another clock, and knows no earlier stamp of this side."""
        self._since_ns = now_ns
        self._last: tuple[int, int] | None = None  # arrival and stamp of the newest

    def on_position(self, now_ns: int, sent_ns: int, since: int, least_ns: int, place: Place) -> None:
        """A message of the stream came, `since` numbers after the newest before it; see `Numbering` for the rest."""
        counts = self._all
        counts.came += 1
        counts.jitter.add(now_ns - sent_ns - least_ns)
        if place is Place.LATE:
            return
        counts.sent += since
        if place is Place.NEW and self._last is not None:
            came_ns, stamp_ns = self._last
            counts.ages.add(now_ns - stamp_ns - least_ns)
            stall_ns = now_ns - came_ns - (sent_ns - stamp_ns if since == 1 else 0)
            if stall_ns > STALL_NS:
                counts.stalls += 1
                if stall_ns > counts.longest_stall_ns:
                    counts.longest_stall_ns = stall_ns
        self._last = now_ns, sent_ns

    def on_echo(self, now_ns: int, sent_ns: int, echo_ns: int, came_ns: int) -> None:
        """The message brought a stamp of this side back."""
        if not (self._since_ns <= echo_ns <= now_ns and came_ns <= sent_ns):
            return
        trip_ns = now_ns - echo_ns - sent_ns + came_ns
        if not 0 <= trip_ns <= LONGEST_NS:
            return
        self._all.trips.add(trip_ns)
        if self._least_trip_ns is None or trip_ns < self._least_trip_ns:
            self._least_trip_ns = trip_ns

    def took_ns(self, now_ns: int, sent_ns: int, least_ns: int) -> int:
        """Estimate of how long a message that comes now was under way, without a common clock [ns]."""
        return min(max(0, now_ns - sent_ns - least_ns), LONGEST_NS) + (self._least_trip_ns or 0) // 2

    def counts(self) -> Counts:
        """The counts so far, for `figures` of the time from now on."""
        return self._all.copy()

    def figures(self, since: Counts | None = None) -> PathFigures:
        """The figures of all messages, or of those since then. The least round trip and the longest stall are of all.

        This needs no lock: a message that comes meanwhile may be counted in only some of the figures.
        """
        return self._figures(self._all if since is None else self._all.since(since))

    def _figures(self, counts: Counts) -> PathFigures:
        least_ns = self._least_trip_ns
        half_ns = None if least_ns is None else least_ns // 2

        def age(q: float) -> int | None:
            older_ns = counts.ages.quantile(q)
            return None if older_ns is None or half_ns is None else older_ns + half_ns

        return PathFigures(
            least_ns, counts.trips.quantile(0.5), counts.trips.quantile(0.99),
            counts.jitter.quantile(0.5), counts.jitter.quantile(0.99), age(0.5), age(0.99),
            counts.sent, max(0, counts.sent - counts.came), counts.stalls, counts.longest_stall_ns,
        )  # fmt: skip
