"""How long the calls of a driver take: one that blocks, or cannot keep the servo's rate, is named.

On a busy machine any call may take long, because the thread waits for a processor or for its turn in the interpreter.
So the time on a processor and in the queue for one does not count, and stalls in the driver's calls are compared with
those between them. No clock: times are arguments.

`Clocks` compares the device's clock with ours: the intervals that it reports must add up to the time that has passed.
"""

from __future__ import annotations

from collections.abc import Callable
from statistics import median

from hapnet.recording.samples import Event

LONG_NS = 1_000_000_000
"""A call that took so long is named, however busy the machine is."""

OFTEN, SHARE = 5, 3
"""Shorter stalls are named when there are so many, and so many times as many as there are outside of the calls."""

WINDOW = 500
"""So many readings show how long one takes, as a median."""

SLOW = 1.3
"""A reading may take so many periods."""


class DriverTimes:
    """Watches the calls of a driver, in their order. name : of the device. period_ns : of the servo.

    limit_ns : a longer call is a stall. paced : whether the servo waits for its own deadlines, and not in `read`.

    Attributes
    ----------
    blocked_ns : the longest stall; blocked : how many were named as such, and what they were, empty: none was.
    rate_hz : the readings that it made in a second while it was too slow; None: it was not.
    """

    def __init__(self, name: str, period_ns: int, limit_ns: int, *, paced: bool) -> None:
        self._name, self._period_ns, self._limit_ns, self._paced = name, period_ns, limit_ns, paced
        self.blocked_ns = 0
        self.blocked = ""
        self.rate_hz: float | None = None
        self._inside = self._outside = 0
        self._ended_ns: int | None = None
        self._readings: list[int] = []
        self._begun_ns = 0
        self._slow = False

    def between(self, now_ns: int) -> None:
        """The calls of a tick begin."""
        if self._ended_ns is not None and now_ns - self._ended_ns > self._limit_ns + self._period_ns:
            self._outside += 1

    def called(
        self, call: str, begun_ns: int, ended_ns: int, waited: Callable[[], int], before_ns: int
    ) -> Event | None:
        """A call has ended; returns what is to be reported.

        waited : how long the thread ran or waited for a processor so far [ns]; it was `before_ns` before the call.
        """
        self._ended_ns = ended_ns
        took_ns = ended_ns - begun_ns
        if call == "read" and self._paced and (slow := self._rate(begun_ns, took_ns)) is not None:
            return slow
        if took_ns <= self._limit_ns or took_ns - (waited_ns := waited() - before_ns) <= self._limit_ns:
            return None
        self._inside += 1
        self.blocked_ns = max(self.blocked_ns, took_ns)
        often = self._paced and self._inside >= OFTEN and self._inside >= SHARE * self._outside
        if took_ns - waited_ns < LONG_NS and not (often and (not self.blocked or self._inside % 100 == 0)):
            return None
        many = f", and {self._inside - 1} calls before it stalled too" if self._inside > 1 else ""
        self.blocked = f"{call}() of {self._name} took {_time(took_ns)}{many}"
        return Event(ended_ns, "device", self.blocked, "warning")

    def _rate(self, begun_ns: int, took_ns: int) -> Event | None:
        if not self._readings:
            self._begun_ns = begun_ns
        self._readings.append(took_ns)
        if len(self._readings) < WINDOW:
            return None
        takes_ns, lasted_ns = median(self._readings), begun_ns + took_ns - self._begun_ns
        self._readings = []
        slow = takes_ns > SLOW * self._period_ns
        if slow == self._slow:
            return None
        self._slow = slow
        if not slow:
            return Event(begun_ns, "device", f"read() of {self._name} is fast enough again")
        self.rate_hz = WINDOW * 1e9 / lasted_ns
        asked = 1e9 / self._period_ns
        text = f"read() of {self._name} takes {_time(takes_ns)}: {self.rate_hz:.0f} of {asked:.0f} readings a second"
        return Event(begun_ns, "device", text, "warning")


class RepeatedReadings:
    """How many of a device's readings are new: one that is read more often than it measures repeats the last.

    A reading is repeated if it is the one before, although it says that the device moves.
    """

    def __init__(self) -> None:
        self._moving = self._repeated = 0
        self._before: object = None

    def see(self, position: tuple[float, ...], velocity: tuple[float, ...]) -> None:
        """Take the next reading."""
        reading = position, velocity
        if any(velocity):
            self._moving += 1
            self._repeated += reading == self._before
        self._before = reading

    def new_hz(self, asked_hz: float) -> float | None:
        """The new readings in a second, of so many asked for; None: most are new, or it hardly moved."""
        if self._moving < WINDOW or 2 * self._repeated < self._moving:
            return None
        return asked_hz * (self._moving - self._repeated) / self._moving


def _time(ns: float) -> str:
    return f"{ns * 1e-9:.1f} s" if ns >= 1e9 else f"{ns * 1e-6:.1f} ms"


class Clocks:
    """The same intervals by a device's clock and by ours, added up."""

    LATE_S = 0.1
    RATE = 0.02
    """Readings may wait for so long, and the clocks run at rates that differ by so much: resonators are within 1 %."""

    def __init__(self) -> None:
        self._reported_s = self._lived_s = 0.0
        self._reported_on_time_s = self._on_time_s = 0.0

    def apart(self, reported_s: float, lived_s: float, *, late: bool) -> str | None:
        """Another interval [s]; returns by how much the clocks differ, in words, if that cannot be.

        late : the servo stalled. Of what the device reported meanwhile some may be lost, and the rest comes later.
        """
        self._reported_s += reported_s
        self._lived_s += lived_s
        if not late:
            self._reported_on_time_s += reported_s
            self._on_time_s += lived_s
        slack_s = self.LATE_S + self.RATE * self._lived_s
        if self._reported_s <= self._lived_s + slack_s and self._reported_on_time_s >= self._on_time_s - slack_s:
            return None
        return f"{self._reported_s:.3g} s in {self._lived_s:.3g} s (is the unit s?)"
