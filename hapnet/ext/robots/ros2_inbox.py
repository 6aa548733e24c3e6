"""The newest message of a ROS topic, without late, bad and foreign messages; the clock is an argument.

A message is used only if it came in time. After a stall a network, or a process that was stopped, delivers all delayed
messages at once. So after a silence messages are dropped until two are half a period apart: then they are current.
Only the time of receipt counts, by this machine's monotonic clock, never the publisher's clock.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

from hapnet.errors import BadMessage
from hapnet.transport.ros2 import Attachment

T = TypeVar("T")

LARGEST = 65536
"""The longest message [bytes]."""

PERIODS = 3
"""The number of periods without a message that count as a silence."""


class Inbox(Generic[T]):
    """The messages that came on one topic: one thread calls `take`, another `next`.

    decode : converts a message's bytes to a value, or raises BadMessage. period_s : between two messages [s].
    clock : monotonic [ns].

    Attributes
    ----------
    lost : number of messages that never came, by their sequence numbers. bad : of invalid messages. late : of delayed,
    repeated or overtaken messages. foreign : of messages of a second publisher, while the first is active.
    """

    def __init__(self, decode: Callable[[bytes], T], period_s: float, clock: Callable[[], int]) -> None:
        self.lost = self.bad = self.late = self.foreign = 0
        self._decode, self._clock = decode, clock
        self._period_ns = round(period_s * 1e9)
        self._silence_ns = PERIODS * self._period_ns
        self._publisher = b""
        self._number = 0
        self._heard_ns: int | None = None
        self._held_up = False
        self._came = threading.Condition()
        self._newest: tuple[T, int] | None = None

    def take(self, data: bytes, attachment: bytes) -> None:
        """Take a message from the network."""
        now_ns = self._clock()
        try:
            number, _, publisher = Attachment.decode(attachment)
            if len(data) > LARGEST:
                raise BadMessage("size", f"{len(data)} bytes; allowed: up to {LARGEST}")
            value = self._decode(data)
        except BadMessage:
            self.bad += 1
            return
        since_ns = None if self._heard_ns is None else now_ns - self._heard_ns
        if publisher != self._publisher:
            if since_ns is not None and since_ns <= self._silence_ns:
                self.foreign += 1
                return
            self._publisher, self._number = publisher, number - 1
        if number <= self._number:
            self.late += 1
            return
        self.lost += number - self._number - 1
        self._number, self._heard_ns = number, now_ns
        if since_ns is not None:
            self._held_up = since_ns > self._silence_ns or (self._held_up and 2 * since_ns < self._period_ns)
        if self._held_up:
            self.late += 1
            return
        with self._came:
            self._newest = value, now_ns
            self._came.notify()

    def next(self, wait_s: float = 0.0) -> tuple[T, int] | None:
        """The newest value not taken yet, and its time of receipt [ns], waiting at most `wait_s`; None: none came."""
        until_ns = self._clock() + round(wait_s * 1e9)
        with self._came:
            while True:
                self._came.wait_for(lambda: self._newest is not None, max(0, until_ns - self._clock()) * 1e-9)
                newest, self._newest = self._newest, None
                if newest is None or self._clock() - newest[1] <= self._silence_ns:
                    return newest
                self.late += 1  # this process was stopped

    @property
    def unused(self) -> str:
        """The counts of messages that were not used, as text; empty: all were used."""
        counts = {"lost": self.lost, "bad": self.bad, "late": self.late, "of another publisher": self.foreign}
        return ", ".join(f"{count} {name}" for name, count in counts.items() if count)
