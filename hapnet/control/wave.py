"""Wave variables over a delaying line (G. Niemeyer, J.-J. E. Slotine, 2004): the delay line's receiving end.

Waves wait in a queue. Each is used once, for its own time span, whatever the periods of the two sides. So the energy
output never exceeds the energy that has arrived. With irregular periods the queue grows to the longest of them and is
then an exact delay, a jitter buffer. What the queue then drops, to be shorter again, may come out later (`Recovery`).
"""

from __future__ import annotations

from collections import deque
from math import sqrt

from hapnet.checks import Vector
from hapnet.control.coupling import Wave
from hapnet.control.wave_integral import Recovery

WINDOW_S = 2.0
"""A queue that was longer than needed for this time is shortened [s]."""
SLACK_S = 0.005
"""A queue this short is never shortened [s]."""
MOST = 1024
"""Largest number of waiting waves."""


class DelayLine:
    """A queue of waves.

    Parameters
    ----------
    dof : components of a wave.
    longest : longest wait [s]; when the queue grows beyond it, the oldest waves are dropped.
    hold : a missing wave is replaced by the last one, which is not passive; if false, by zero, which is passive.
    recovery : time constant with which displacement that the queue has lost comes out after all [s]; 0: never.
    """

    def __init__(self, dof: int, longest: float, *, hold: bool = False, recovery: float = 0.0) -> None:
        self._zero = (0.0,) * dof
        self._recovery = Recovery(dof, recovery)
        self._longest = longest
        self._hold = hold
        self.clear()

    def clear(self) -> None:
        self._queue: deque[Wave] = deque()
        self._last = self._zero
        self._recovery.clear()
        self.waiting: float = 0.0
        """Total time span of the waves in the queue [s]."""
        self._pace = 1.0
        self._least = self._watched = 0.0

    def push(self, wave: Wave) -> None:
        self._queue.append(wave)
        self.waiting += wave.span
        while self.waiting > self._longest or len(self._queue) > MOST:
            dropped = self._queue.popleft()
            self.waiting -= dropped.span
            self._recovery.lose(dropped)

    def take(self, dt: float) -> Vector:
        """The mean wave over the next `dt` seconds.

        A queue that was too long for a whole window is played faster during the next window, at most twice as fast.
        Waves of S seconds played in dt < S go out as their mean times sqrt(S/dt): no more energy than they had, by the
        Cauchy-Schwarz inequality.
        """
        total, squares, took = self._next(dt * self._pace)
        if took < dt and self._hold:
            total = [part + last * (dt - took) for part, last in zip(total, self._last, strict=True)]
        self._watch(dt)
        scale = 1.0 / (dt if took <= dt else sqrt(took * dt))
        return self._recovery.output(dt, tuple([part * scale for part in total]), total, squares)

    def _next(self, wanted: float) -> tuple[list[float], list[float], float]:
        """Integrals of the oldest waves and of their squares over at most `wanted` seconds, and the time they cover."""
        queue = self._queue
        total, squares, took = list(self._zero), list(self._zero), 0.0
        while queue and took < wanted:
            wave = queue.popleft()
            value, span = wave.value, wave.span
            part = wanted - took
            if span > part:
                queue.appendleft(Wave(value, span - part))
                span = part
            took += span
            self._last = value
            for i, component in enumerate(value):
                total[i] += component * span
                squares[i] += component * component * span
        self.waiting = self.waiting - took if queue else 0.0
        return total, squares, took

    def _watch(self, dt: float) -> None:
        self._least = min(self._least, self.waiting)
        self._watched += dt
        if self._watched >= WINDOW_S:
            excess = max(0.0, self._least - SLACK_S)
            self._pace = 1.0 + min(1.0, excess / WINDOW_S)
            self._least, self._watched = self.waiting, 0.0
