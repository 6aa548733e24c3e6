"""Limits on the set-position before PSPM: its largest step, and its behaviour while the network is silent.

Both only choose another y(k), so they cannot break passivity.
"""

from __future__ import annotations

from typing import Literal

from hapnet.records.record import Floats, Reals, Record, equation
from hapnet.records.vectors import distance

OnSilence = Literal["hold", "release"]


@equation
def limit_step(n: int, start: Reals, goal: Floats, maximum: float) -> None:
    """Replace `goal` by the point towards it that is at most `maximum` [m] away from `start`.

    With ``maximum = dF_max / lambda_max(K)`` around ybar(k-1), the spring's force steps by at most dF_max: PSPM's
    projection is non-expansive, so a limit on the step of y also holds for ybar.
    """
    far = distance(n, goal, start)
    if far <= maximum:
        return
    share = maximum / far
    for i in range(n):
        goal[i] = start[i] + share * (goal[i] - start[i])


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
