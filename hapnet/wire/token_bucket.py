"""How much energy a peer may hand in: a token bucket in watts, with a burst in joules.

A limit per update would be none, since every message of the peer triggers an update. The bucket belongs to the session
and not to the pair, so that a peer does not earn a fresh burst by restarting.
"""

from __future__ import annotations

from math import isfinite

from hapnet.errors import InvalidParameter

REPEATED_NS = 2_000_000_000
"""A sender repeats a total that is not acknowledged within that, and 1.5 s is its timer's longest [ns]."""

_AJ_PER_NJ = 1_000_000_000


class Admission:
    """Token bucket that starts full. The level is kept in whole attojoules: 1 nW for 1 ns.

    Parameters
    ----------
    power_W : what flows in at length [W], 1e-9 to 1e9.
    burst_J : what may come at once [J], 1e-9 to 1e9.

    Raises
    ------
    InvalidParameter : outside these.
    """

    def __init__(self, power_W: float, burst_J: float) -> None:
        for name, value, unit in (("admission_W", power_W, "W"), ("admission_burst_J", burst_J, "J")):
            if not (isfinite(value) and 1e-9 <= value <= 1e9):
                raise InvalidParameter(name, value, f"1e-9 to 1e9 {unit}")
        self._rate_nW = round(power_W * 1e9)
        self._burst_aJ = round(burst_J * 1e9) * _AJ_PER_NJ
        self._level_aJ = self._burst_aJ
        self._filled_ns: int | None = None

    @property
    def most_waiting_nJ(self) -> int:
        """How much may wait for tokens: what they pay until the sender says it again, whatever its timer."""
        return (self._burst_aJ + self._rate_nW * REPEATED_NS) // _AJ_PER_NJ

    def take(self, wanted_nJ: int, now_ns: int) -> int:
        """Up to `wanted_nJ`, as far as the tokens go at `now_ns`."""
        if self._filled_ns is None:
            self._filled_ns = now_ns
        if now_ns > self._filled_ns:
            self._level_aJ = min(self._burst_aJ, self._level_aJ + self._rate_nW * (now_ns - self._filled_ns))
            self._filled_ns = now_ns
        taken_nJ = min(wanted_nJ, self._level_aJ // _AJ_PER_NJ)
        self._level_aJ -= taken_nJ * _AJ_PER_NJ
        return taken_nJ

    def due_ns(self, wanted_nJ: int, step_ns: int) -> int:
        """When to take again: all of `wanted_nJ` is there, or what comes in `step_ns`, if that is sooner."""
        step_nJ = max(1, self._rate_nW * step_ns // _AJ_PER_NJ)
        lacking_aJ = min(wanted_nJ * _AJ_PER_NJ, self._burst_aJ, step_nJ * _AJ_PER_NJ) - self._level_aJ
        return (self._filled_ns or 0) + max(0, -(-lacking_aJ // self._rate_nW))
