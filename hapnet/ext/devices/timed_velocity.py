"""Velocity from positions with times: of an encoder's counts, or of a sensor's samples.

The velocity is the slope of the longest line that begins at the newest position and passes all between within their
noise (first-order adaptive windowing: Janabi-Sharifi, Hayward and Chen, IEEE Trans. Control Systems Technology 8(6),
2000). So it is quick while the handle accelerates, and smooth while it does not. With the times of single counts slow
motion is not lost. Between counts the velocity is at most a count over the time since the last count.
"""

from __future__ import annotations

from collections import deque

_MOST = 16
"""The greatest number of positions in a fit."""


class TimedVelocity:
    """The velocity of one axis.

    count : the smallest change of a position [m]. noise : of the positions at their times, from peak to peak [m].
    """

    def __init__(self, count: float, noise: float) -> None:
        self._count, self._noise = count, noise
        self._points: deque[tuple[float, float]] = deque(maxlen=_MOST)

    def restart(self) -> None:
        """Forget all positions, as after a gap."""
        self._points.clear()

    def update(self, now: float, at: float | None, x: float, *, counted: bool = True) -> float:
        """The velocity [m/s] at the time `now` [s].

        at : when the handle was at `x` [m]; None: not known. counted : whether an encoder counted there, so that no
        count has come since `at`; a sensor that is sampled may have moved by many.
        """
        points = self._points
        if at is not None and (not points or at > points[-1][0]):
            points.append((at, x))
        if len(points) < 2:
            return 0.0
        newest, there = points[-1]
        least, most, velocity = float("-inf"), float("inf"), 0.0
        for k in range(len(points) - 2, -1, -1):
            t, x = points[k]
            slope = (there - x) / (newest - t)
            if not least <= slope <= most:
                break
            velocity = slope
            slack = self._noise / (newest - t)
            least, most = max(least, slope - slack), min(most, slope + slack)
        since = now - newest if counted else 0.0
        fastest = self._count / since if since > 0.0 else float("inf")
        return max(-fastest, min(fastest, velocity))
