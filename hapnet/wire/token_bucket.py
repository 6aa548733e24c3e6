"""How much energy is credited to a peer: a token bucket in watts, with a burst in joules.

A limit per update would limit nothing, since every message of the peer causes an update. The bucket belongs to the
session and not to the pair, so that a peer earns no fresh burst by restarting.
"""

from __future__ import annotations

from math import isfinite
from typing import Final, NamedTuple

from hapnet.errors import InvalidParameter

REPEATED_NS = 2_000_000_000
"""A sender repeats a total without acknowledgement within this time [ns]: its timer is at most 1.5 s."""

_AJ_PER_NJ = 1_000_000_000


class BucketState(NamedTuple):
    """The tokens, and when they were last counted; None: not yet."""

    level_aJ: int
    filled_ns: int | None


class TokenBucket:
    """A token bucket that starts full. The level is kept in whole attojoules: 1 nW for 1 ns.

    Parameters
    ----------
    power_W : the power that is credited in the long run [W], 1e-9 to 1e9.
    burst_J : the energy that is credited at once [J], 1e-9 to 1e9.

    Raises
    ------
    InvalidParameter : one of them is out of its range.
    """

    def __init__(self, power_W: float, burst_J: float) -> None:
        for name, value, unit in (("admission_W", power_W, "W"), ("admission_burst_J", burst_J, "J")):
            if not (isfinite(value) and 1e-9 <= value <= 1e9):
                raise InvalidParameter(name, value, f"1e-9 to 1e9 {unit}")
        self.rate_nW: Final = round(power_W * 1e9)
        self.burst_aJ: Final = round(burst_J * 1e9) * _AJ_PER_NJ
        self._level_aJ = self.burst_aJ
        self._filled_ns: int | None = None

    @property
    def most_waiting_nJ(self) -> int:
        """How much may wait for tokens: what the tokens can pay before the sender repeats its total."""
        return (self.burst_aJ + self.rate_nW * REPEATED_NS) // _AJ_PER_NJ

    def take(self, wanted_nJ: int, now_ns: int) -> int:
        """Take up to `wanted_nJ` from the bucket, as far as the tokens go; returns what was taken [nJ]."""
        if self._filled_ns is None:
            self._filled_ns = now_ns
        if now_ns > self._filled_ns:
            self._level_aJ = min(self.burst_aJ, self._level_aJ + self.rate_nW * (now_ns - self._filled_ns))
            self._filled_ns = now_ns
        taken_nJ = min(wanted_nJ, self._level_aJ // _AJ_PER_NJ)
        self._level_aJ -= taken_nJ * _AJ_PER_NJ
        return taken_nJ

    def due_ns(self, wanted_nJ: int, step_ns: int) -> int:
        """When to take next: tokens for all of `wanted_nJ` are there, or `step_ns` of power if that is sooner."""
        step_nJ = max(1, self.rate_nW * step_ns // _AJ_PER_NJ)
        lacking_aJ = min(wanted_nJ * _AJ_PER_NJ, self.burst_aJ, step_nJ * _AJ_PER_NJ) - self._level_aJ
        return (self._filled_ns or 0) + max(0, -(-lacking_aJ // self.rate_nW))

    def state(self) -> BucketState:
        """What `restore` takes."""
        return BucketState(self._level_aJ, self._filled_ns)

    def restore(self, state: BucketState) -> None:
        """Go on from there."""
        self._level_aJ, self._filled_ns = state
