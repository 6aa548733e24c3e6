"""Limits on the set-position before PSPM: its largest step, and its behaviour while the network is silent.

Both only choose another y(k), so they cannot break passivity.
"""

from __future__ import annotations

import math
from typing import Literal

from hapnet.records.record import Floats, Reals, Record, equation

OnSilence = Literal["hold", "release"]


@equation
def limit_step(n: int, start: Reals, moved: Reals, goal: Floats, maximum: float) -> bool:
    """Replace `goal` by the nearest point that is at most `maximum` away from the line from start to start + moved.

    For set-positions, start is ybar(k-1), and `moved` the own motion since then [m]. At one end of the line ybar stays,
    and the force changes by what the own motion causes; at the other end ybar moves along, and the force stays. So with
    ``maximum = dF_max / lambda_max(K)`` the rest of the force's change is at most dF_max, at any speed of the hand.
    PSPM's projection is non-expansive, so a limit on the step of y also holds for ybar: beyond the line with one axis;
    with several, a modulated ybar may be beside the line, and is at most ``maximum + |moved|`` from start.
    For forces [N], start is the force before, and `moved` its change by the own motion. Returns whether goal changed.
    """
    along = square = 0.0
    for i in range(n):
        along += (goal[i] - start[i]) * moved[i]
        square += moved[i] * moved[i]
    share = min(max(along / square, 0.0), 1.0) if square > 0.0 else 0.0
    far = 0.0
    for i in range(n):
        off = goal[i] - (start[i] + share * moved[i])
        far += off * off
    if far <= maximum * maximum:
        return False
    kept = maximum / math.sqrt(far)
    for i in range(n):
        nearest = start[i] + share * moved[i]
        goal[i] = nearest + kept * (goal[i] - nearest)
    return True


class Silence(Record):
    """Chooses y while the peer is silent: ``hold`` keeps y, ``release`` lets it follow the device.

    policy : "hold" or "release".
    after : the peer is silent after this time without a sample [s].
    """

    after: float
    elapsed: float
    releases: int

    def __init__(self, policy: OnSilence, after: float) -> None:
        super().__init__()
        self.policy = policy
        self.releases, self.after = int(policy == "release"), after

    def step(self, dt: float, *, fresh: bool) -> bool:
        """Advance by dt seconds. Returns True if y must be released (ramped to x under the step limit)."""
        return releases(self, dt, fresh)


@equation
def releases(silence: Silence, dt: float, fresh: bool) -> bool:
    """Advance by dt seconds; returns whether y must be released: `Silence.step`."""
    silence.elapsed = 0.0 if fresh else silence.elapsed + dt
    return silence.releases != 0 and silence.elapsed > silence.after
