"""Digital waves over packets that jitter and get lost (P. Berestesky, N. Chopra, M. W. Spong, 2004): their replay.

The discrete line is passive if the sum of u_out^2 never exceeds the sum of u_in^2. So nothing waits for a jitter
buffer: what has arrived is played at once, over a time that is fixed then.
"""

from __future__ import annotations

from math import sqrt

from hapnet.checks import Vector
from hapnet.control.coupling import Wave

LOUDEST = 2.0
"""1/n is at most this: a burst is energy as well, but a hand should not get it at once."""


class Replay:
    """What has arrived and was not played yet, as one wave over one time.

    Whenever waves have arrived they are spread, with what was not played before, over the next N seconds: S seconds
    of waves whose mean is u go out as ``u/sqrt(n)``, ``n = N/S``. That is no more energy than they had (Cauchy and
    Schwarz), it is fixed when they are received, and is played or lost but never exceeded. While waves come as fast as
    they are played n tends to 1; after one that is late or lost n > 1, and what is missing is lost for good.

    Parameters
    ----------
    dof : of a wave. spread : N [s], for no losses the longest time between two arrivals and not shorter than a slot.
    """

    def __init__(self, dof: int, spread: float) -> None:
        self._zero = (0.0,) * dof
        self._spread = spread
        self.clear()

    def clear(self) -> None:
        self._arrived = list(self._zero)  # integral of what has arrived since the last slot
        self._arrived_s = 0.0  # over this time
        self._playing = self._zero
        self._left_s = 0.0

    def push(self, wave: Wave) -> None:
        value, span = wave
        self._arrived_s += span
        for i, component in enumerate(value):
            self._arrived[i] += component * span

    def take(self, dt: float) -> Vector:
        left, playing = self._left_s, self._playing
        if self._arrived_s > 0.0:
            content = self._arrived_s + left
            scale = sqrt(min(content / self._spread, LOUDEST)) / content
            playing = tuple([(new + old * left) * scale for new, old in zip(self._arrived, playing, strict=True)])
            self._arrived, self._arrived_s = list(self._zero), 0.0
            self._playing, left = playing, self._spread
        played = min(left, dt)
        self._left_s = left - played
        share = played / dt
        return tuple([wave * share for wave in playing])
