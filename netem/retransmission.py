"""The time after which TCP sends a segment again, as Linux computes it (``tcp_rtt_estimator`` in net/ipv4/tcp_input.c).

RFC 6298 with three changes of Linux:

* The minimum of 200 ms is that of the margin above the mean round trip: RTO = SRTT + max(200 ms, 4 RTTVAR). In RFC 6298
  it is that of the whole sum.
* The margin follows a larger deviation of the round trips at once, and a smaller one by a quarter each round trip.
* A round trip that is shorter than the mean by more than the mean deviation raises the deviation with an eighth of the
  gain, so that a delay that falls does not lengthen the time.
"""

from __future__ import annotations

from typing import Final

FIRST_S: Final = 1.0
"""The time before a round trip was measured [s]."""

MIN_MARGIN_S: Final = 0.2
"""The least margin above the mean round trip [s]: TCP_RTO_MIN."""

MAX_TIMER_S: Final = 120.0
"""The longest time [s], which doubling reaches: TCP_RTO_MAX."""


class RoundTrips:
    """The mean and the deviation of a connection's round trips [s].

    The deviation is four times the mean deviation, as RTO needs it. A period ends when everything that was sent until
    its begin is acknowledged, which takes a round trip.
    """

    def __init__(self) -> None:
        self._mean_s: float | None = None
        self._deviation_s = self._margin_s = self._largest_s = 0.0
        self._period_ends = 0

    def measure(self, trip_s: float, acknowledged: int, sent: int) -> None:
        """Enter a round trip of a segment that was sent once.

        acknowledged : all segments below this number have arrived. sent : the number of the next segment.
        """
        if self._mean_s is None:
            self._mean_s, self._deviation_s = trip_s, 2.0 * trip_s
            self._margin_s = self._largest_s = max(self._deviation_s, MIN_MARGIN_S)
            self._period_ends = sent
            return
        error_s = trip_s - self._mean_s
        self._mean_s += error_s / 8.0
        growth_s = abs(error_s) - self._deviation_s / 4.0
        self._deviation_s += growth_s / 8.0 if error_s < 0.0 < growth_s else growth_s
        self._largest_s = max(self._largest_s, self._deviation_s)
        self._margin_s = max(self._margin_s, self._largest_s)
        if acknowledged > self._period_ends:
            self._margin_s -= (self._margin_s - self._largest_s) / 4.0
            self._period_ends, self._largest_s = sent, MIN_MARGIN_S

    def timer_s(self, tries: int = 1) -> float:
        """The time after which a segment that was sent `tries` times is sent again [s]; it doubles at each try."""
        usual_s = FIRST_S if self._mean_s is None else self._mean_s + self._margin_s
        return min(usual_s * 2.0 ** min(tries - 1, 16), MAX_TIMER_S)
