"""Resends, as link layers make them (the retries of IEEE 802.11, HARQ of LTE and NR), without clock or I/O.

A message's resends are decided when it is offered. To the loss model they are so many more messages that follow a lost
one: with independent losses of p, all N resends of a lost message are lost with p^N, so that p^(N+1) stay lost; with
bursts they are lost as often as a burst goes on for so long. The model's own course, and so which messages are lost
when first offered, is the same with resends and without.
"""

from __future__ import annotations

from bisect import bisect_right

import numpy as np
from numpy.typing import NDArray

from netem.effects import Loss, Resend
from netem.loss_chain import lost_again
from netem.trace import ConditionTrace


class Resends:
    """How many resends lost messages take.

    `luck` is a draw in [0, 1) a message: k resends in a row are lost iff it is below the chance of that, so that
    another number of resends leaves the fates of those that there are.
    """

    def __init__(self, resend: Resend, loss: Loss | None) -> None:
        self.after_ns, self.ordered = resend.after_ns, resend.ordered
        self._times = resend.times
        self._lost_again = lost_again(loss, resend.times)
        self._ascending = self._lost_again[::-1]

    def taken(self, luck: float) -> tuple[int, bool]:
        """(how often a lost message is offered again, is it lost for good?)."""
        lost = self._times - bisect_right(self._ascending, luck)
        return min(lost + 1, self._times), lost == self._times

    def taken_under(self, luck: float, conditions: ConditionTrace, elapsed_ns: int) -> tuple[int, bool]:
        """The same where a trace adds its loss, that of each resend's own time; `elapsed_ns` is the message's."""
        chance, before = 1.0, 1.0
        for k, again in enumerate(self._lost_again, start=1):
            model = again / before if before else 0.0
            trace = conditions.at(elapsed_ns + k * self.after_ns)[1]
            chance, before = chance * (1.0 - (1.0 - model) * (1.0 - trace)), again
            if luck >= chance:
                return k, False
        return self._times, True

    def taken_by_all(
        self, lost: NDArray[np.bool_], luck: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """`taken` of many, also of messages that are not lost when first offered."""
        failed = self._times - np.searchsorted(self._ascending, luck, side="right")
        return np.where(lost, np.minimum(failed + 1, self._times), 0), lost & (failed == self._times)
