"""Wave variables over a line that delays (G. Niemeyer, J.-J. E. Slotine, 2004): the delay line's receiving end.

Waves wait in a queue and are each used once, for as long as they were sent for, whatever the periods of the two sides.
So the energy that has come out never exceeds what has arrived. Where periods are irregular the queue becomes, after
the longest of them, an exact delay: a jitter buffer.
"""

from __future__ import annotations

from collections import deque
from math import sqrt

from hapnet.checks import Vector
from hapnet.control.coupling import Wave

WINDOW_S = 2.0
"""A wait that was not needed in so long a time is shortened."""
SLACK_S = 0.005
"""A wait as short as this may stay."""
MOST = 1024
"""So many waves may wait."""


class DelayLine:
    """A queue of waves.

    Parameters
    ----------
    dof : of a wave.
    longest : wait [s]; of what makes it longer the oldest is dropped.
    hold : where a wave is missing the last one stands for it, which is not passive; else zero does, which is.
    """

    def __init__(self, dof: int, longest: float, *, hold: bool = False) -> None:
        self._zero = (0.0,) * dof
        self._longest = longest
        self._hold = hold
        self.clear()

    def clear(self) -> None:
        self._queue: deque[tuple[Vector, float]] = deque()
        self._last = self._zero
        self.waiting = 0.0
        """How much time of waves is in the queue [s]."""
        self._pace = 1.0
        self._least = self._watched = 0.0

    def push(self, wave: Wave) -> None:
        self._queue.append(wave)
        self.waiting += wave.span
        while self.waiting > self._longest or len(self._queue) > MOST:
            self.waiting -= self._queue.popleft()[1]

    def take(self, dt: float) -> Vector:
        """The mean wave over the next `dt` seconds.

        A queue that has been too long for a window's time is played faster for as long, at most twice as fast, and the
        waves of S seconds in dt < S go out as their mean times sqrt(S/dt): no more energy than they had, by Cauchy and
        Schwarz.
        """
        total, took = self._next(dt * self._pace)
        if took < dt and self._hold:
            total = [part + last * (dt - took) for part, last in zip(total, self._last, strict=True)]
        self._watch(dt)
        scale = 1.0 / (dt if took <= dt else sqrt(took * dt))
        return tuple([part * scale for part in total])

    def _next(self, wanted: float) -> tuple[list[float], float]:
        """Integral of the oldest waves over at most `wanted` seconds, and over how many."""
        queue = self._queue
        total, took = list(self._zero), 0.0
        while queue and took < wanted:
            value, span = queue.popleft()
            part = wanted - took
            if span > part:
                queue.appendleft((value, span - part))
                span = part
            took += span
            self._last = value
            for i, component in enumerate(value):
                total[i] += component * span
        self.waiting = self.waiting - took if queue else 0.0
        return total, took

    def _watch(self, dt: float) -> None:
        self._least = min(self._least, self.waiting)
        self._watched += dt
        if self._watched >= WINDOW_S:
            excess = max(0.0, self._least - SLACK_S)
            self._pace = 1.0 + min(1.0, excess / WINDOW_S)
            self._least, self._watched = self.waiting, 0.0
