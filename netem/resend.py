"""Resends, as link layers make them (the retries of IEEE 802.11, HARQ of LTE and NR), without clock or I/O.

A message's resends are decided when it is offered. The loss model treats them as further messages after a lost one.
With independent losses of probability p, all N resends of a lost message are lost with p^N, so p^(N+1) of the messages
stay lost. With bursts, all are lost as often as a burst lasts that long. The resends do not change the model's own
states, so the same messages are lost at their first offer with and without resends.
"""

from __future__ import annotations

from netem.effects import Loss, Resend
from netem.loss_chain import lost_again
from netem.trace import ConditionTrace


class Resends:
    """Decides how many resends each lost message takes.

    `luck` is one draw in [0, 1) per message: k resends in a row are lost iff it is below the probability of that. So
    whether a resend is lost does not depend on how many more are allowed.
    """

    def __init__(self, resend: Resend | None, loss: Loss | None) -> None:
        self.times, self.after_ns, self.ordered = 0, 0, False
        if resend is not None:
            self.times, self.after_ns, self.ordered = resend.times, resend.after_ns, resend.ordered
        self._lost_again = () if resend is None else lost_again(loss, resend.times)
        self.ascending = self._lost_again[::-1]

    def taken_under(self, luck: float, conditions: ConditionTrace, elapsed_ns: int) -> tuple[int, bool]:
        """The result of `taken` with a trace's loss added at each resend's time; `elapsed_ns` is the message's time."""
        chance, before = 1.0, 1.0
        for k, again in enumerate(self._lost_again, start=1):
            model = again / before if before else 0.0
            trace = conditions.at(elapsed_ns + k * self.after_ns)[1]
            chance, before = chance * (1.0 - (1.0 - model) * (1.0 - trace)), again
            if luck >= chance:
                return k, False
        return self.times, True


def taken(resends: Resends, luck: float) -> tuple[int, bool]:
    """(number of resends of a lost message, whether it is lost for good)."""
    lost = resends.times
    while lost and resends.ascending[resends.times - lost] <= luck:
        lost -= 1
    return min(lost + 1, resends.times), lost == resends.times
