"""Limits on the set-position before PSPM: how far it may step, and what to do when the network is silent.

Both only choose another y(k), so they cannot break passivity.
"""

from __future__ import annotations

import math
from operator import sub
from typing import Literal

from hapnet.checks import Vector

OnSilence = Literal["hold", "release"]
ON_SILENCE: tuple[OnSilence, ...] = ("hold", "release")


def step_towards(start: Vector, goal: Vector, longest: float) -> Vector:
    """The point towards `goal` [m] that is at most `longest` [m] away from `start`.

    With ``longest = dF_max / lambda_max(K)`` around ybar(k-1), the spring's force steps by at most dF_max: PSPM's
    projection is non-expansive, so ybar keeps the limit that y kept.
    """
    if len(start) == 1 and abs(goal[0] - start[0]) <= longest:
        return goal
    way = tuple(map(sub, goal, start))
    distance = math.hypot(*way)
    if distance <= longest:
        return goal
    share = longest / distance
    return tuple([a + share * d for a, d in zip(start, way, strict=True)])


class Silence:
    """Chooses y when nothing has arrived for a while: ``hold`` keeps it, ``release`` lets it follow the device.

    Parameters
    ----------
    policy : "hold" or "release".
    after : the peer is silent after this time without a sample [s].
    """

    __slots__ = ("after", "elapsed", "policy")

    def __init__(self, policy: OnSilence, after: float) -> None:
        self.policy = policy
        self.after: float = after
        self.elapsed: float = 0.0

    @property
    def is_silent(self) -> bool:
        """Is the peer silent?"""
        return self.elapsed > self.after

    def step(self, dt: float, *, fresh: bool) -> bool:
        """Advance by dt seconds. Returns True if y is to be released (ramped to x under the step limit)."""
        self.elapsed = 0.0 if fresh else self.elapsed + dt
        return self.policy == "release" and self.is_silent
