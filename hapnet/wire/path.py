"""Measure the path between two sides from their streams without a common clock: round trip, jitter, loss, stalls, age.

A message holds the time when it was sent (`sent_ns`, on its sender's clock), the stamp of this side that came last at
its sender (`echo_ns`), and when that stamp came (`came_ns`, on the sender's clock). A message that arrives at `now_ns`
measures a round trip of

    (now_ns - echo_ns) - (sent_ns - came_ns)                                   (RFC 5905, section 8)

This contains neither the difference of the clocks nor the time for which the other side held the stamp. How it splits
into the two directions cannot be known. Of the direction to this side only the variation is known: now_ns - sent_ns,
less its recent minimum. So an age is that variation plus half of the minimum round trip.

The numbers show how many messages are missing, as in RFC 3550 (section 6.4.1): all numbers between the first and the
newest, less the messages that came, late or not. A transport may drop overtaken messages, which are then not lost on
the path. A sender on such a transport announces that nothing overtakes every n-th of its messages. Loss, jitter and
round trips are those of these messages alone, and stand for all. All are measured from stamp to arrival, so an emulated
link is part of the path.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from hapnet.records.histogram import Histogram, add
from hapnet.records.record import NEVER, Record, equation
from hapnet.wire import peer_monitor as monitors
from hapnet.wire.numbering import AGAIN, DOUBTFUL, LATE, NEW, SEEN, place
from hapnet.wire.peer_monitor import PeerMonitor
from hapnet.wire.replay_window import ReplayWindow, accept, restart

_NANO = 1e-9

STALL_NS = 100_000_000
"""A stall: nothing new came for this much longer than the sender paused. 3GPP TR 22.847 allows no longer delay."""

MAX_NS = 60_000_000_000
"""No round trip is longer: an echo that implies a longer one is wrong."""


@dataclass(frozen=True, slots=True)
class PathFigures:
    """A side's path since its start, or its last seconds. Times are in ns, and None until they are known.

    jitter_p50_ns, jitter_p99_ns : how much longer the messages to this side took than the fastest recent one.
    age_p50_ns, age_p99_ns : the greatest age of each message in use: just before the next replaced it. A
        message without jitter is assumed to take half of the minimum round trip.
    """

    round_trip_min_ns: int | None
    round_trip_p50_ns: int | None
    round_trip_p99_ns: int | None
    jitter_p50_ns: int | None
    jitter_p99_ns: int | None
    age_p50_ns: int | None
    age_p99_ns: int | None
    sent: int
    """Messages that the other side has numbered since the first that arrived."""
    arrived: int
    """The number of these that have arrived, late or not."""
    overtaken: int
    """The number that a later one has overtaken: they came late, or the transport dropped them."""
    lost: int
    """The number that were lost on the path; an estimate if the other side samples its stream."""
    stalls: int
    """The number of times that no new message came for `STALL_NS` longer than the sender paused."""
    max_stall_ns: int


class Counts(Record):
    """All counts of a path. The difference of two such counts describes the time between them.

    sampled, sampled_came : `sent` and `came` of the sampled messages, if not all are sampled.
    """

    trips: Histogram
    jitter: Histogram
    ages: Histogram
    sent: int
    came: int
    late: int
    stalls: int
    max_stall_ns: int
    sampled: int
    sampled_came: int

    def __init__(self) -> None:
        self.trips, self.jitter, self.ages = Histogram(), Histogram(), Histogram()
        self.sent = self.came = self.late = self.stalls = self.max_stall_ns = 0
        self.sampled = self.sampled_came = 0

    def since(self, earlier: Counts) -> Counts:
        part = Counts()
        part.trips, part.jitter = self.trips.since(earlier.trips), self.jitter.since(earlier.jitter)
        part.ages = self.ages.since(earlier.ages)
        part.sent, part.came = self.sent - earlier.sent, self.came - earlier.came
        part.late, part.stalls = self.late - earlier.late, self.stalls - earlier.stalls
        part.sampled, part.sampled_came = self.sampled - earlier.sampled, self.sampled_came - earlier.sampled_came
        part.max_stall_ns = self.max_stall_ns
        return part

    def copy(self) -> Counts:
        return self.since(Counts())

    @property
    def lost(self) -> int:
        """The number of messages that have not come and were not overtaken; where nothing came late, nothing was
        overtaken.
        """
        missing = max(0, self.sent - self.came)
        if not self.sampled or not self.late:
            return missing
        return min(missing, max(0, round(self.sent * (1.0 - self.sampled_came / self.sampled))))


class Path(Record):
    """Measures the path to this side, and the round trip.

    Attributes
    ----------
    all : the counts since the start.
    min_trip_ns : the minimum round trip; `NEVER`: none was measured.
    since_ns, every : see `begin`.
    echo_ns, came_ns : stamp and arrival of the sampled message that came last, late or not: what to echo.
    last_ns, last_stamp_ns : arrival and stamp of the newest; `NEVER`: there is none.
    under_way_ns : `took_ns` of the message that came last.
    """

    all: Counts
    min_trip_ns: int
    since_ns: int
    every: int
    echo_ns: int
    came_ns: int
    last_ns: int
    last_stamp_ns: int
    under_way_ns: int

    def __init__(self) -> None:
        self.all = Counts()
        self.min_trip_ns = NEVER
        self.under_way_ns = self.last_stamp_ns = 0
        self.begin(0)

    def begin(self, now_ns: int, every: int = 1) -> None:
        """Begin a pair: the peer has another clock, and has received no earlier stamp of this side.

        every : nothing overtakes a message whose number is a multiple of it; these are the sample.
        """
        self.since_ns, self.every = now_ns, every
        self.echo_ns = self.came_ns = 0
        self.last_ns = NEVER

    @property
    def arrival(self) -> tuple[int, int] | None:
        """Stamp and arrival of the sampled message that came last, late or not [ns]: what to echo."""
        return (self.echo_ns, self.came_ns) if self.came_ns or self.echo_ns else None

    @equation
    def on_position(self, now_ns: int, number: int, sent_ns: int, since: int, min_ns: int, place: int) -> bool:
        """Enter a message of the stream, `since` numbers after the newest before it; see `Numbering` for the rest.

        Returns True if it is one of the sample, so that its echo counts.
        """
        counts, every = self.all, self.every
        sampled = number % every == 0
        counts.came += 1
        if sampled:
            self.echo_ns, self.came_ns = sent_ns, now_ns
            add(counts.jitter, now_ns - sent_ns - min_ns)
        if every > 1:
            counts.sampled_came += 1 if sampled else 0
            counts.sampled += 0 if place == LATE else number // every - (number - since) // every
        if place == LATE:
            counts.late += 1
            return sampled
        counts.sent += since
        if place == NEW and self.last_ns != NEVER:
            add(counts.ages, now_ns - self.last_stamp_ns - min_ns)
            stall_ns = now_ns - self.last_ns - (sent_ns - self.last_stamp_ns if since == 1 else 0)
            if stall_ns > STALL_NS:
                counts.stalls += 1
                if stall_ns > counts.max_stall_ns:
                    counts.max_stall_ns = stall_ns
        self.last_ns, self.last_stamp_ns = now_ns, sent_ns
        return sampled

    @equation
    def on_echo(self, now_ns: int, sent_ns: int, echo_ns: int, came_ns: int) -> None:
        """Enter a message that echoes a stamp of this side."""
        if not (self.since_ns <= echo_ns <= now_ns and came_ns <= sent_ns):
            return
        trip_ns = now_ns - echo_ns - sent_ns + came_ns
        if not 0 <= trip_ns <= MAX_NS:
            return
        add(self.all.trips, trip_ns)
        if trip_ns < self.min_trip_ns:
            self.min_trip_ns = trip_ns

    @equation
    def took_ns(self, now_ns: int, sent_ns: int, min_ns: int) -> int:
        """Estimate the transit time of a message that comes now, without a common clock [ns]."""
        half_ns = 0 if self.min_trip_ns == NEVER else self.min_trip_ns // 2
        return min(max(0, now_ns - sent_ns - min_ns), MAX_NS) + half_ns

    def counts(self) -> Counts:
        """The counts so far, for `figures` of the time from now on."""
        return self.all.copy()

    def figures(self, since: Counts | None = None) -> PathFigures:
        """The figures of all messages, or of those after `since`; minimum round trip and longest stall are of all.

        This needs no lock: a message that comes meanwhile may be counted in only some of the figures.
        """
        return self._figures(self.all if since is None else self.all.since(since))

    def _figures(self, counts: Counts) -> PathFigures:
        min_ns, trips = None if self.min_trip_ns == NEVER else self.min_trip_ns, counts.trips
        half_ns = None if min_ns is None else min_ns // 2

        def age(q: float) -> int | None:
            older_ns = counts.ages.quantile(q)
            return None if older_ns is None or half_ns is None else older_ns + half_ns

        lost = counts.lost
        return PathFigures(
            min_ns, trips.interpolated(0.5, min_ns or 0), trips.interpolated(0.99, min_ns or 0),
            counts.jitter.quantile(0.5), counts.jitter.quantile(0.99), age(0.5), age(0.99),
            counts.sent, counts.came, counts.late + max(0, counts.sent - counts.came) - lost, lost,
            counts.stalls, counts.max_stall_ns,
        )  # fmt: skip


@equation
def arrive(
    path: Path,
    monitor: PeerMonitor,
    window: ReplayWindow,
    counts_once: bool,
    now_ns: int,
    number: int,
    sent_ns: int,
    echo_ns: int,
    came_ns: int,
) -> int:
    """Return the place of a message of the peer's stream, and enter its measurements unless it is doubtful.

    A late message whose number is in `window` is a copy: it is not measured. Where each message counts once (waves),
    any message whose number is in `window` is a copy.
    """
    numbers = monitor.numbers
    newest = numbers.newest
    found = place(numbers, now_ns, number, sent_ns)
    if found == DOUBTFUL:
        return found
    if found == AGAIN:
        restart(window, number)
    copy = not accept(window, number)
    if copy and found == LATE:
        return SEEN
    since = 1 if newest < 0 else number - newest
    if on_position(path, now_ns, number, sent_ns, since, numbers.min_ns, found) and echo_ns:
        on_echo(path, now_ns, sent_ns, echo_ns, came_ns)
    path.under_way_ns = took_ns(path, now_ns, sent_ns, numbers.min_ns)
    if found == LATE:
        monitors.on_any_message(monitor, now_ns)
    else:
        monitors.on_position(monitor, now_ns, since)
    return SEEN if copy and counts_once else found


@equation
def is_used(place: int, counts_once: bool, may_be_late: bool) -> bool:
    """Whether a message in this place is used. counts_once : see `arrive`. may_be_late : this side accepts it late."""
    return place in (NEW, AGAIN) or (place == LATE and (counts_once or may_be_late))


on_position, on_echo, took_ns = Path.on_position, Path.on_echo, Path.took_ns
"""These methods as functions, for calls from equations."""


class InUse(Record):
    """The newest of the peer's samples in use: when it was sent, on the peer's clock, when it came, and its transit
    time [ns]; took_ns is below 0 if there is none."""

    sent_ns: int
    came_ns: int
    took_ns: int

    def __init__(self) -> None:
        self.sent_ns, self.came_ns, self.took_ns = 0, 0, -1


@equation
def age_s(used: InUse, now_ns: int) -> float:
    """Estimate the age of the sample [s]; NaN where there is none.

    A step that begins late has a `now_ns` before a sample that came meanwhile, which is as old as its transit then.
    """
    return (max(0, now_ns - used.came_ns) + used.took_ns) * _NANO if used.took_ns >= 0 else math.nan


@equation
def transit_s(used: InUse) -> float:
    """The sample's arrival on this side's clock less its stamp on the peer's clock [s]; NaN where there is none."""
    return (used.came_ns - used.sent_ns) * _NANO if used.took_ns >= 0 else math.nan


@equation
def age_of_content_s(used: InUse, now_ns: int, aimed_s: float) -> float:
    """The age of the sample's content [s]. aimed_s : the time on this side's clock that the world predicts; else 0."""
    return now_ns * _NANO - aimed_s if aimed_s else age_s(used, now_ns)
