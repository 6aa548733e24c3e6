"""A check of a device's clock against ours: the intervals that it reports must add up to the time that has passed."""

from __future__ import annotations


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
