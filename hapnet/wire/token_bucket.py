"""Limit the energy that is credited to a peer: a token bucket in watts, with a burst in joules.

A limit per update would have no effect, since every message of the peer causes an update. The bucket belongs to the
session and not to the pair, so that a peer gets no fresh burst by restarting.
"""

from __future__ import annotations

from math import isfinite

from hapnet.errors import InvalidParameter
from hapnet.records.record import Record, equation

REPEATED_NS = 2_000_000_000
"""A sender repeats a total without acknowledgement within this time [ns]: its timer is at most 1.5 s."""

_AJ_PER_NJ = 1_000_000_000


class TokenBucket(Record):
    """A token bucket that starts full. The level is kept in whole attojoules: 1 nW for 1 ns.

    power_W : the power that is credited in the long run [W], 1e-9 to 1e9.
    burst_J : the energy that is credited at once [J], 1e-9 to 1e9.

    Attributes
    ----------
    level_aJ, filled_ns : the tokens, and when they were last counted.
    most_waiting_nJ : the energy that may wait for tokens: as much as they can pay before the sender repeats its total.

    Raises InvalidParameter: one of them is out of its range.
    """

    rate_nW: int
    burst_aJ: int
    most_waiting_nJ: int
    level_aJ: int
    filled_ns: int

    def __init__(self, power_W: float, burst_J: float) -> None:
        for name, value, unit in (("admission_W", power_W, "W"), ("admission_burst_J", burst_J, "J")):
            if not (isfinite(value) and 1e-9 <= value <= 1e9):
                raise InvalidParameter(name, value, f"1e-9 to 1e9 {unit}")
        super().__init__()
        self.rate_nW = round(power_W * 1e9)
        self.level_aJ = self.burst_aJ = round(burst_J * 1e9) * _AJ_PER_NJ
        self.most_waiting_nJ = (self.burst_aJ + self.rate_nW * REPEATED_NS) // _AJ_PER_NJ

    @equation
    def take(self, wanted_nJ: int, now_ns: int) -> int:
        """Take up to `wanted_nJ` from the bucket, as far as the tokens suffice; returns the energy taken [nJ]."""
        passed_ns = now_ns - self.filled_ns
        if passed_ns > 0:
            if passed_ns > (self.burst_aJ - self.level_aJ) // self.rate_nW:  # their product might not fit 64 bits
                self.level_aJ = self.burst_aJ
            else:
                self.level_aJ += self.rate_nW * passed_ns
            self.filled_ns = now_ns
        taken_nJ = min(wanted_nJ, self.level_aJ // _AJ_PER_NJ)
        self.level_aJ -= taken_nJ * _AJ_PER_NJ
        return taken_nJ

    @equation
    def due_ns(self, wanted_nJ: int, step_ns: int) -> int:
        """The time to take next, when there are tokens for all of `wanted_nJ`, or for `step_ns` of power."""
        step_nJ = max(1, self.rate_nW * step_ns // _AJ_PER_NJ)
        lacking_aJ = min(wanted_nJ, min(self.burst_aJ // _AJ_PER_NJ, step_nJ)) * _AJ_PER_NJ - self.level_aJ
        return self.filled_ns + max(0, -(-lacking_aJ // self.rate_nW))


take, due_ns = TokenBucket.take, TokenBucket.due_ns
"""These methods as functions, for calls from equations."""
