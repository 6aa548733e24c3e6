"""Probes of the network: `hapnet doctor` sends them, and a side answers them without its servo or protocol.

A probe is any payload. Its answer has eight more bytes in front, the number of probes answered so far. From these the
sender computes the round trip and the loss in each direction.
"""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import zenoh

from hapnet.errors import TransportError
from hapnet.records.histogram import Histogram
from hapnet.transport.config import reason
from hapnet.transport.entities import RateLimiter
from hapnet.wire.path import STALL_NS

PROBE = "probe"
"""The last part of the keys."""

MOST_HZ, MOST_AT_ONCE = 500, 100
MAX_LENGTH = 512
"""Probes beyond this rate [1/s] or burst, and longer ones [bytes], get no answer."""

EVERY_NS = 5_000_000
"""Time between two probes [ns]: as often as a device sends its position."""
_SIZE = 76  # the length of a position with three coordinates
_COUNT, _STAMPS = struct.Struct(">Q"), struct.Struct(">QQ")


class Answering:
    """Answers probes. put : sends an answer, from any thread. clock : returns the time [ns]."""

    def __init__(self, put: Callable[[bytes], object], clock: Callable[[], int] = time.monotonic_ns) -> None:
        self._put, self._clock = put, clock
        self._rate_limiter = RateLimiter(MOST_HZ, MOST_AT_ONCE)
        self._lock = threading.Lock()
        self._answered = 0

    def answer(self, data: bytes) -> None:
        """Answer a probe. Called on one of Zenoh's threads."""
        if not 1 <= len(data) <= MAX_LENGTH or not self._rate_limiter.admit(self._clock()):
            return
        with self._lock:
            self._answered += 1
            count = self._answered
        self._put(_COUNT.pack(count % 2**64) + data)


def answer_probes(session: zenoh.Session, asked: str, answered: str) -> None:
    """Answer probes on the key `asked`, with the key `answered`, until the session ends."""
    publisher = _publisher(session, answered)
    answering = Answering(publisher.put)

    def receive(sample: zenoh.Sample) -> None:
        answering.answer(sample.payload.to_bytes())

    session.declare_subscriber(asked, zenoh.handlers.Callback(receive, indirect=False))


@dataclass
class Answers:
    """Figures from the answers, beginning with the first."""

    trips: Histogram = field(default_factory=Histogram)
    min_ns: int | None = None
    received: int = 0
    stalls: int = 0
    max_stall_ns: int = 0
    _first: tuple[int, int] | None = None  # numbers of the probe and of its answer
    _last: tuple[int, int] = (0, 0)
    _heard_ns: int = 0

    def take(self, now_ns: int, data: bytes) -> None:
        """Count an answer; other payloads, copies and overtaken answers are ignored."""
        if len(data) != _COUNT.size + _SIZE:
            return
        (count,) = _COUNT.unpack_from(data)
        number, sent_ns = _STAMPS.unpack_from(data, _COUNT.size)
        trip_ns = now_ns - sent_ns
        if trip_ns < 0 or (self._first is not None and (number <= self._last[0] or count <= self._last[1])):
            return
        if self._first is None:
            self._first = number, count
        elif (stall_ns := now_ns - self._heard_ns - EVERY_NS) > STALL_NS:
            self.stalls += 1
            self.max_stall_ns = max(self.max_stall_ns, stall_ns)
        self._last, self._heard_ns = (number, count), now_ns
        self.received += 1
        self.trips.add(trip_ns)
        self.min_ns = trip_ns if self.min_ns is None else min(self.min_ns, trip_ns)

    @property
    def losses(self) -> tuple[float, float]:
        """The fractions of probes and of answers that were lost; other senders' probes reduce the first."""
        if self._first is None:
            return 0.0, 0.0
        sent, answered = (last - first + 1 for first, last in zip(self._first, self._last, strict=True))
        return max(0.0, 1.0 - answered / sent), max(0.0, 1.0 - self.received / answered)


def ask(config: zenoh.Config, asked: str, answered: str, seconds: float, patience_s: float) -> Answers | None:
    """Open Zenoh, and send probes until `seconds` after the first answer; None if none comes in `patience_s`. Blocks.

    Raises TransportError: Zenoh cannot be opened, or fails.
    """
    try:
        with zenoh.open(config) as session:
            return _probe(session, asked, answered, seconds, patience_s)
    except zenoh.ZError as error:
        raise TransportError(reason(error)) from None


def _probe(session: zenoh.Session, asked: str, answered: str, seconds: float, patience_s: float) -> Answers | None:
    answers = Answers()
    lock = threading.Lock()

    def receive(sample: zenoh.Sample) -> None:
        now_ns = time.monotonic_ns()
        with lock:
            answers.take(now_ns, sample.payload.to_bytes())

    subscriber = session.declare_subscriber(answered, zenoh.handlers.Callback(receive, indirect=False))
    publisher = _publisher(session, asked)
    try:
        due_ns = began_ns = time.monotonic_ns()
        number, end_ns = 0, began_ns + round(patience_s * 1e9)
        while (now_ns := time.monotonic_ns()) < end_ns:
            if now_ns < due_ns:
                time.sleep((due_ns - now_ns) * 1e-9)
                continue
            publisher.put(_STAMPS.pack(number, now_ns).ljust(_SIZE, b"\0"))
            number, due_ns = number + 1, max(due_ns + EVERY_NS, now_ns)
            if answers.received and began_ns:
                began_ns, end_ns = 0, now_ns + round(seconds * 1e9)
        time.sleep(min(1.0, 2e-9 * (answers.trips.quantile(0.99) or 0)))  # for the last answers
        with lock:
            return answers if answers.received else None
    finally:
        for entity in (publisher, subscriber):
            undeclare: Callable[[], None] = entity.undeclare  # zenoh's stub leaves its type out
            undeclare()


def _publisher(session: zenoh.Session, key: str) -> zenoh.Publisher:
    return session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.DROP,
        priority=zenoh.Priority.INTERACTIVE_LOW,  # as control: the queue is long, and nothing overtakes a position
        express=True,
        reliability=zenoh.Reliability.BEST_EFFORT,
    )
