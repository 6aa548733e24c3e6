"""Check that a running device's positions change at all. No clock: times are arguments.

Its force and its handle were checked at the start (`ActuatorCheck`), and are as long as it runs (`ForceProbe`).
"""

from __future__ import annotations

import math

from hapnet.checks import Vector

STILL_N, STILL_S = 1.0, 0.3
"""A position that stays the same to the last digit while its force changes by so much, for so long."""
GAP_S = 0.05
"""After a longer time without a reading nothing is known of it: the device was silent, or the servo away."""


class Agreement:
    """Watches force and position."""

    def __init__(self) -> None:
        self._still: tuple[Vector, Vector] | None = None
        self._still_s = self._most_N = 0.0

    def wrong(self, dt: float, acted: Vector, x: Vector) -> str:
        """Take a reading, and the force that acted for `dt` seconds before it; says what is wrong, or nothing."""
        if dt > GAP_S:
            self._still = None
            return ""
        if self._still is None or x != self._still[0]:
            self._still, self._still_s, self._most_N = (x, acted), 0.0, 0.0
            return ""
        self._still_s += dt
        self._most_N = max(self._most_N, math.dist(acted, self._still[1]))
        if self._still_s < STILL_S or self._most_N < STILL_N:
            return ""
        return f"it reads the same position while its force changes by {self._most_N:.2g} N: is its encoder connected?"
