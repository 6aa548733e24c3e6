"""When to retransmit: the estimator of RFC 6298, in integer nanoseconds.

Three constants deviate from the RFC. There the floor and the first value are 1 s (equations 2.4 and 2.1), for bulk
transfers that share a congested path. Here a message has some 40 bytes, messages come at a bounded rate, the stream of
positions beside them is many times as heavy, and a person feels a second without energy. In the RFC the optional
ceiling is at least 60 s (2.5); here a side must notice soon that a link has come back after an outage.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from hapnet.errors import InvalidParameter

FLOOR_NS = 20_000_000  # RFC 6298: 1 s
INITIAL_NS = 250_000_000  # RFC 6298: 1 s
CEILING_NS = 1_500_000_000  # RFC 6298: none, or at least 60 s
GRANULARITY_NS = 1_000_000  # of the coarsest timer that a runtime may have: an event loop counts whole milliseconds


class RtoState(NamedTuple):
    """The timeout without back-off, how often it was doubled, SRTT (None: no sample yet) and RTTVAR."""

    base_ns: int
    backed_off: int
    srtt_ns: int | None
    rttvar_ns: int


class RtoEstimator:
    """Retransmission timeout `rto_ns` from measured round trips.

    The caller keeps Karn's rule (RFC 6298, section 3): no sample from a message that was sent more than once.

    Raises
    ------
    InvalidParameter : unless 0 < floor_ns <= initial_ns <= ceiling_ns.
    """

    def __init__(self, *, floor_ns: int = FLOOR_NS, initial_ns: int = INITIAL_NS, ceiling_ns: int = CEILING_NS) -> None:
        if not 0 < floor_ns <= initial_ns <= ceiling_ns:
            raise InvalidParameter("initial_ns", initial_ns, f"0 < {floor_ns} (floor) to {ceiling_ns} (ceiling)")
        self.floor_ns: Final = floor_ns
        self.ceiling_ns: Final = ceiling_ns
        self._base_ns = initial_ns
        self._backed_off = 0
        self.srtt_ns: int | None = None
        self.rttvar_ns: int = 0

    @property
    def rto_ns(self) -> int:
        """The timeout to set now, back-off included."""
        return min(self._base_ns << self._backed_off, self.ceiling_ns)

    def sample(self, rtt_ns: int) -> None:
        """Learn from one round trip; clears the back-off."""
        rtt_ns = max(0, rtt_ns)
        if self.srtt_ns is None:
            self.srtt_ns, self.rttvar_ns = rtt_ns, rtt_ns // 2  # (2.2)
        else:
            self.rttvar_ns = (3 * self.rttvar_ns + abs(self.srtt_ns - rtt_ns)) // 4  # (2.3), before SRTT
            self.srtt_ns = (7 * self.srtt_ns + rtt_ns) // 8
        rto_ns = self.srtt_ns + max(GRANULARITY_NS, 4 * self.rttvar_ns)
        self._base_ns = min(max(rto_ns, self.floor_ns), self.ceiling_ns)
        self._backed_off = 0

    def back_off(self) -> None:
        """The timer expired: double the timeout, up to the ceiling (5.5)."""
        if self.rto_ns < self.ceiling_ns:
            self._backed_off += 1

    def state(self) -> RtoState:
        """What `restore` takes."""
        return RtoState(self._base_ns, self._backed_off, self.srtt_ns, self.rttvar_ns)

    def restore(self, state: RtoState) -> None:
        """Go on from there."""
        self._base_ns, self._backed_off, self.srtt_ns, self.rttvar_ns = state
