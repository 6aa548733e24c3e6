"""Do a running device's force and its handle still agree? They were checked at the start (`ActuatorCheck`).

Two things show without pushing: a handle that accelerates against its force for long, as behind a reversed motor, where
the spring drives it away; and positions that do not change at all while the force does. No clock: times are arguments.
"""

from __future__ import annotations

import math
from collections import deque

from hapnet.checks import Vector

LONG_S = 0.1
"""A hand can accelerate a handle against its force, but not for so long, so much."""
MIN_N, AGAINST, AS_IF = 1.5, -0.8, 3.0
"""The force's root mean square; its correlation with the acceleration; the mass that both make, over the handle's."""
STILL_N, STILL_S = 1.0, 0.3
"""A position that stays the same to the last digit while its force changes by so much, for so long."""
_BLOCK_S = 0.01
GAP_S = 0.05
"""After a longer time without a reading nothing is known of it: the device was silent, or the servo away."""


class Agreement:
    """Watches force and position. mass : the handle's, the smallest of several axes' [kg]; None: not known."""

    def __init__(self, mass: float | None) -> None:
        self._mass = mass
        self._blocks: deque[tuple[float, Vector, Vector]] = deque(maxlen=2 + round(LONG_S / _BLOCK_S))
        self._age_s = 0.0
        self._impulse: list[float] = []
        self._still: tuple[Vector, Vector] | None = None
        self._still_s = self._most_N = 0.0

    def wrong(self, dt: float, acted: Vector, x: Vector) -> str:
        """Take a reading, and the force that acted for `dt` seconds before it; says what is wrong, or nothing."""
        if dt > GAP_S:
            self._blocks.clear()
            self._age_s, self._impulse, self._still = 0.0, [], None
            return ""
        return self._stands_still(dt, acted, x) or self._runs_away(dt, acted, x)

    def _stands_still(self, dt: float, acted: Vector, x: Vector) -> str:
        if self._still is None or x != self._still[0]:
            self._still, self._still_s, self._most_N = (x, acted), 0.0, 0.0
            return ""
        self._still_s += dt
        self._most_N = max(self._most_N, math.dist(acted, self._still[1]))
        if self._still_s < STILL_S or self._most_N < STILL_N:
            return ""
        return f"it reads the same position while its force changes by {self._most_N:.2g} N: is its encoder connected?"

    def _runs_away(self, dt: float, acted: Vector, x: Vector) -> str:
        if self._mass is None:
            return ""
        if not self._impulse:
            self._impulse = [0.0] * len(x)
        self._age_s += dt
        self._impulse = [total + f * dt for total, f in zip(self._impulse, acted, strict=True)]
        if self._age_s < _BLOCK_S:
            return ""
        force = tuple([total / self._age_s for total in self._impulse])
        blocks = self._blocks
        blocks.append((self._age_s, force, x))
        self._age_s, self._impulse = 0.0, [0.0] * len(x)
        if len(blocks) < (blocks.maxlen or 0):
            return ""
        along = forces = accelerations = 0.0
        for (_, _, a), (h, first, b), (k, second, c) in zip(blocks, list(blocks)[1:], list(blocks)[2:], strict=False):
            for p, q, r, f, g in zip(a, b, c, first, second, strict=True):
                acceleration = 2.0 * ((r - q) / k - (q - p) / h) / (h + k)
                mean = 0.5 * (f + g)
                along += acceleration * mean
                forces += mean * mean
                accelerations += acceleration * acceleration
        count = len(blocks) - 2
        if math.sqrt(forces / count) < MIN_N or along > AGAINST * math.sqrt(forces * accelerations):
            return ""
        if math.sqrt(forces) > AS_IF * self._mass * math.sqrt(accelerations):
            return ""
        return f"its handle accelerates against its force for {LONG_S * 1e3:g} ms: is the motor reversed?"
