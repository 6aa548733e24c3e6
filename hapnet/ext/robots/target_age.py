"""The age of a leader's set-points at a robot, by this machine's clock only; the times are arguments.

A set-point is too old if none came for the watchdog's time. A link that was interrupted may deliver its delayed
messages all at once; then they have just come, but their transit is longer than it was. So a set-point is also too old
if its transit exceeds the shortest of the last seconds by more than the watchdog's time. A path that became longer for
good is used again after these seconds.
"""

from __future__ import annotations

import math

from hapnet.side.content import NANO

WINDOW_S = 2.0
"""The shortest transit is that of the last one to two windows [s]."""


class TargetAge:
    """The times of the leader's set-points, and whether it leads.

    Attributes
    ----------
    stopped : whether it was stopped for good.
    """

    def __init__(self) -> None:
        self.stopped: bool = False
        self._leads, self._released_ns = True, -1
        self._ago_s = self._transit_s = math.inf
        self._shortest = [math.inf, math.inf]
        self._ends_s = -math.inf

    def lead(self, leads: bool) -> None:
        """Enter whether the leader leads, as it reports."""
        self._leads, self._released_ns = leads, -1

    def hear(self, now_ns: int, came_ns: int, took_ns: int) -> None:
        """Enter when the newest set-point came, and the time that it took [ns]; below 0: none came yet."""
        if not self._leads:  # nothing is used of a released leader, so what is used is another leader's
            self._leads = -1 < self._released_ns != came_ns
            self._released_ns = came_ns
        now_s = now_ns * NANO
        if now_s >= self._ends_s:
            self._ends_s = now_s + WINDOW_S
            self._shortest = [self._shortest[1], math.inf]
        if took_ns < 0:
            self._ago_s = math.inf
            return
        self._ago_s, self._transit_s = (now_ns - came_ns) * NANO, took_ns * NANO
        self._shortest[1] = min(self._shortest[1], self._transit_s)

    def why(self, watchdog_s: float) -> str:
        """Why the robot must not follow the newest set-point; empty: it may."""
        if self.stopped:
            return "holds: it was stopped"
        if not self._leads:
            return "holds: its leader has released it"
        if self._ago_s > watchdog_s:
            return "holds: its leader is silent"
        late_s = self._transit_s - min(self._shortest)
        return "holds: its leader's set-points are late" if late_s > watchdog_s else ""
