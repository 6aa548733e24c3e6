"""The retransmission timer: the estimator of RFC 6298, in integer nanoseconds.

Three constants deviate from the RFC. There the floor and the first value are 1 s (equations 2.4 and 2.1), for bulk
transfers that share a congested path. Here a message has some 40 bytes, messages come at a bounded rate, the stream of
positions has many times their traffic, and a person feels a second without energy. In the RFC the optional
ceiling is at least 60 s (2.5); here a side must notice soon that a link has come back after an outage.
"""

from __future__ import annotations

from hapnet.errors import InvalidParameter
from hapnet.records.record import Record, equation

FLOOR_NS = 20_000_000  # RFC 6298: 1 s
INITIAL_NS = 250_000_000  # RFC 6298: 1 s
CEILING_NS = 1_500_000_000  # RFC 6298: none, or at least 60 s
GRANULARITY_NS = 1_000_000  # of the coarsest timer that a runtime may have: an event loop counts whole milliseconds


class RtoEstimator(Record):
    """Retransmission timeout `rto_ns` from measured round trips.

    The caller keeps Karn's rule (RFC 6298, section 3): no sample from a message that was sent more than once.

    Attributes
    ----------
    base_ns : the timeout without back-off. backed_off : how often it was doubled.
    smoothed_ns, rttvar_ns : SRTT, below 0 before the first sample, and RTTVAR.

    Raises InvalidParameter: unless 0 < floor_ns <= initial_ns <= ceiling_ns.
    """

    floor_ns: int
    ceiling_ns: int
    base_ns: int
    backed_off: int
    smoothed_ns: int
    rttvar_ns: int

    def __init__(self, *, floor_ns: int = FLOOR_NS, initial_ns: int = INITIAL_NS, ceiling_ns: int = CEILING_NS) -> None:
        if not 0 < floor_ns <= initial_ns <= ceiling_ns:
            raise InvalidParameter("initial_ns", initial_ns, f"0 < {floor_ns} (floor) to {ceiling_ns} (ceiling)")
        super().__init__()
        self.floor_ns, self.base_ns, self.ceiling_ns = floor_ns, initial_ns, ceiling_ns
        self.smoothed_ns = -1

    @property
    def srtt_ns(self) -> int | None:
        """SRTT; None before the first sample."""
        return None if self.smoothed_ns < 0 else self.smoothed_ns

    @property
    def rto_ns(self) -> int:
        """The timeout to set now, back-off included."""
        return timeout_ns(self)

    @equation
    def sample(self, rtt_ns: int) -> None:
        """Update the estimate from one round trip; clears the back-off."""
        rtt_ns = max(0, rtt_ns)
        if self.smoothed_ns < 0:
            self.smoothed_ns, self.rttvar_ns = rtt_ns, rtt_ns // 2  # (2.2)
        else:
            self.rttvar_ns = (3 * self.rttvar_ns + abs(self.smoothed_ns - rtt_ns)) // 4  # (2.3), before SRTT
            self.smoothed_ns = (7 * self.smoothed_ns + rtt_ns) // 8
        rto_ns = self.smoothed_ns + max(GRANULARITY_NS, 4 * self.rttvar_ns)
        self.base_ns = min(max(rto_ns, self.floor_ns), self.ceiling_ns)
        self.backed_off = 0

    @equation
    def back_off(self) -> None:
        """The timer expired: double the timeout, up to the ceiling (5.5)."""
        if timeout_ns(self) < self.ceiling_ns:
            self.backed_off += 1


@equation
def timeout_ns(rto: RtoEstimator) -> int:
    """The timeout to set now, back-off included [ns]: `RtoEstimator.rto_ns`."""
    doubled_ns = rto.base_ns << rto.backed_off
    return doubled_ns if doubled_ns < rto.ceiling_ns else rto.ceiling_ns


sample, back_off = RtoEstimator.sample, RtoEstimator.back_off
"""These methods as functions, for calls from equations."""
