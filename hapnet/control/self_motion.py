"""y for a world that cannot send planes: its position, plus the device's own motion since the time of that position.

    y = y_w + sigma (x(t) - x(t - R)),      sigma = max(0, 1 - |y_w - x(t - R)| / distance)

sigma is near 1 while the proxy follows (free motion), and goes to 0 in contact. Both parts are low-passed.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque

from hapnet import checks
from hapnet.checks import Vector
from hapnet.control.smoothing import low_passed


class SelfMotion:
    """Computes y from the world's positions and the device's own positions.

    distance : at which sigma becomes 0 [m]. smoothing : time constant [s]. history : maximum of R [s].
    """

    def __init__(self, *, distance: float = 0.015, smoothing: float = 0.02, history: float = 2.0) -> None:
        self.distance: float = checks.positive("distance", distance)
        self.smoothing: float = checks.positive("smoothing", smoothing)
        self.history: float = checks.positive("history", history)
        self.reset(())

    def reset(self, position: Vector) -> None:
        """Start again at `position` [m]."""
        self._past: deque[tuple[float, Vector]] = deque()
        self._now = 0.0
        self._base = position
        self._sigma = 0.0
        self._target: tuple[Vector, float] = (position, 0.0)

    def observe(self, dt: float, x: Vector) -> None:
        """Store the device's position x [m], `dt` seconds after the last call."""
        self._now += dt
        past = self._past
        past.append((self._now, x))
        while past[0][0] < self._now - self.history:
            past.popleft()

    def receive(self, position: Vector, age_s: float) -> None:
        """Take in the world's position [m], which holds for the own position `age_s` ago."""
        then = self.own(age_s)
        sigma = max(0.0, 1.0 - math.dist(position, then) / self.distance)
        self._target = tuple([y - sigma * x for y, x in zip(position, then, strict=True)]), sigma

    def own(self, ago: float) -> Vector:
        """The own position `ago` seconds ago [m], or the oldest that is stored."""
        past = self._past
        since = bisect_left(past, self._now - ago, key=lambda one: one[0])
        return past[min(since, len(past) - 1)][1]

    def at(self, x: Vector) -> Vector:
        """y for the own position x [m] now."""
        return tuple([b + self._sigma * a for b, a in zip(self._base, x, strict=True)])

    def step(self, dt: float, x: Vector, lead: Vector) -> Vector:
        """y [m], `dt` seconds after the last step; `lead`, weighted by sigma, is added."""
        base, sigma = self._target
        self._base = low_passed(dt, self.smoothing, self._base, base)
        (self._sigma,) = low_passed(dt, self.smoothing, (self._sigma,), (sigma,))
        return tuple([b + self._sigma * (a + c) for b, a, c in zip(self._base, x, lead, strict=True)])
