"""Measures the durations of a driver's calls, and reports calls that block or cannot keep the servo's rate.

On a busy machine any call may take long, because the thread waits for a processor or for its turn in the interpreter.
So the time on a processor and in the queue for a processor does not count, and stalls in the driver's calls are
compared with the stalls between them. There is no clock: times are arguments.

`Clocks` compares the device's clock with ours: the intervals that it reports must add up to the time that has passed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from statistics import median

from hapnet.recording.samples import Event

LONG_NS = 1_000_000_000
"""A call that took longer than this is reported, however busy the machine is [ns]."""

OFTEN, SHARE = 5, 3
"""Shorter stalls are reported when there are OFTEN or more, and SHARE times as many as between the calls."""

WINDOW = 500
"""The number of readings over which the median duration is taken."""

SLOW = 1.3
"""The longest median duration of a reading that keeps the rate, in periods."""


class DriverTimes:
    """Watches the calls of a driver, in their order. name : of the device. period_ns : of the servo.

    limit_ns : a longer call is a stall. paced : whether the servo waits for its own deadlines, and not in `read`.

    Attributes
    ----------
    blocked_ns : the longest stall; blocked : the text of the last report about stalls; empty: there was none.
    rate_hz : the readings in a second while the driver was too slow; None: it was not.
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
        """Note that the calls of a tick begin."""
        if self._ended_ns is not None and now_ns - self._ended_ns > self._limit_ns + self._period_ns:
            self._outside += 1

    def called(
        self, call: str, begun_ns: int, ended_ns: int, waited: Callable[[], int], before_ns: int
    ) -> Event | None:
        """Count a call that has ended; returns the event to report, if any.

        waited : the time for which the thread ran or waited for a processor so far [ns]: `before_ns` before the call.
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
    """Counts how many readings are new: a device that is read more often than it measures repeats the last reading.

    Two kinds of device are found: one that repeats its velocity too, which is then not zero; and one whose velocity is
    the difference of its positions, so that its position rests for some readings and then jumps. Steps of an encoder
    are no jumps: only a change counts that is larger than the smallest change so far by `JUMP`.
    """

    JUMP, JUMPS = 4.0, 30

    def __init__(self) -> None:
        self._moving = self._repeated = 0
        self._before: tuple[tuple[float, ...], tuple[float, ...]] | None = None
        self._smallest = math.inf
        self._rests = self._jumps = self._readings = 0
        self._still = True

    def see(self, position: tuple[float, ...], velocity: tuple[float, ...]) -> None:
        """Take the next reading."""
        reading = position, velocity
        if any(velocity):
            self._moving += 1
            self._repeated += reading == self._before
        self._rests += 1
        if self._before is not None and (step := math.dist(position, self._before[0])):
            self._smallest = min(self._smallest, step)
            if step > self.JUMP * self._smallest and self._still:
                self._jumps += 1
                self._readings += self._rests
            self._rests, self._still = 0, True
        elif any(velocity):
            self._still = False
        self._before = reading

    def new_hz(self, asked_hz: float) -> float | None:
        """New readings in a second, of `asked_hz` in all; None: most are new, or the device hardly moved."""
        if self._moving >= WINDOW and 2 * self._repeated >= self._moving:
            return asked_hz * (self._moving - self._repeated) / self._moving
        if self._jumps >= self.JUMPS and self._readings >= 2 * self._jumps:
            return asked_hz * self._jumps / self._readings
        return None


def _time(ns: float) -> str:
    return f"{ns * 1e-9:.1f} s" if ns >= 1e9 else f"{ns * 1e-6:.1f} ms"


class Clocks:
    """The sums of the same intervals by a device's clock and by ours."""

    LATE_S = 0.1
    RATE = 0.02
    """Readings may wait for `LATE_S` [s], and the clocks' rates may differ by `RATE`: resonators are within 1 %."""

    def __init__(self) -> None:
        self._reported_s = self._lived_s = 0.0
        self._reported_on_time_s = self._on_time_s = 0.0

    def apart(self, reported_s: float, lived_s: float, *, late: bool) -> str | None:
        """Add an interval [s]; returns a text with the clocks' difference if it is impossible, else None.

        late : the servo stalled. Some reports of the device from that time may be lost, and the rest comes later.
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
