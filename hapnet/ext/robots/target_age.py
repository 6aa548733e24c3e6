"""The age of a leader's set-points at a robot, by this machine's clock only; the times are arguments.

A set-point is too old if none came for the watchdog's time. A link that was interrupted may deliver its delayed
messages all at once; then they have just come, but their transit is longer than it was. So a set-point is also too old
if its transit exceeds the shortest of the last seconds by more than the watchdog's time. A path that became longer for
good is used again after these seconds.
"""

from __future__ import annotations

import math

WINDOW_S = 2.0
"""The shortest transit is that of the last one to two windows [s]."""


class TargetAge:
    """What is known of the leader's set-points.

    Attributes
    ----------
    leads : whether the leader reports that it leads. stopped : whether it was stopped for good.
    """

    def __init__(self) -> None:
        self.leads, self.stopped = True, False
        self._ago_s = math.inf
        self._transit_s = math.nan
        self._shortest = [math.inf, math.inf]
        self._ends_s = -math.inf

    def hear(self, now_s: float, came_s: float, transit_s: float) -> None:
        """Enter when the newest set-point came [s], and its transit [s]; NaN: there is none yet."""
        self._ago_s = math.inf if math.isnan(transit_s) else now_s - came_s
        self._transit_s = transit_s
        if now_s >= self._ends_s:
            self._ends_s = now_s + WINDOW_S
            self._shortest = [self._shortest[1], math.inf]
        if transit_s < self._shortest[1]:
            self._shortest[1] = transit_s

    def why(self, watchdog_s: float) -> str:
        """Why the robot must not follow the newest set-point; empty: it may."""
        if self.stopped:
            return "holds: it was stopped"
        if not self.leads:
            return "holds: its leader has released it"
        if self._ago_s > watchdog_s:
            return "holds: its leader is silent"
        late_s = self._transit_s - min(self._shortest)
        return "holds: its leader's set-points are late" if late_s > watchdog_s else ""
