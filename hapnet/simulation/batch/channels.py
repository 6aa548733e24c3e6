"""One side's energy channels in many scenarios at once: `hapnet.wire.energy_channel`.

All values are whole numbers, so the order of operations does not matter here.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from hapnet.checks import Array
from hapnet.simulation.batch.arrays import NEVER, Index, Whole
from hapnet.simulation.batch.round_trips import RtoEstimators, TimedMessages
from hapnet.simulation.batch.token_buckets import TokenBuckets
from hapnet.wire.energy_channel import ADMISSION_STEP_NS, ChannelState, EnergyChannel


class Channels:
    """The channels of one side; `next_due_ns` says when each must be polled.

    `shift_ns`: time on a scenario's own clock when the batch's clock shows 0.
    """

    def __init__(self, channels: list[EnergyChannel], shift_ns: Whole) -> None:
        self._spacing_ns, self._ack_delay_ns = channels[0].spacing_ns, channels[0].ack_delay_ns
        self._buckets = TokenBuckets([channel.admission for channel in channels], shift_ns)
        self._rto = RtoEstimators([channel.rto for channel in channels])
        states = [channel.state() for channel in channels]

        def whole(values: Iterable[int]) -> Whole:
            return np.array(list(values), dtype=np.int64)

        def moments(values: Iterable[int | None]) -> Whole:
            """Times may lie before the load, so `NEVER` stands for none."""
            return whole(NEVER if t is None else t - s for t, s in zip(values, shift_ns.tolist(), strict=True))

        self._shift_ns = shift_ns
        self.sent_nJ = whole(s.sent_nJ for s in states)
        self.acked_nJ = whole(s.acked_nJ for s in states)
        self.credited_nJ = whole(s.credited_nJ for s in states)
        self._shown_nJ = self.credited_nJ.copy()
        """The credited energy that messages acknowledge: less than was credited, while a window is deferred."""
        self._announced_nJ = whole(s.announced_nJ for s in states)
        self._claimed_nJ = whole(s.claimed_nJ for s in states)
        self._residue_J = np.array([s.residue_J for s in states])
        self._spaced_ns = moments(s.spaced_ns for s in states)
        self._retransmit_ns = moments(s.retransmit_ns for s in states)
        self._ack_ns = moments(s.ack_ns for s in states)
        asked = [s.asked or (None, -1) for s in states]
        self._asked_ns, self._asked_nJ = moments(at for at, _ in asked), whole(nJ for _, nJ in asked)
        shifts = shift_ns.tolist()
        timed = [[(nJ, at - shift) for nJ, at in s.timed] for s, shift in zip(states, shifts, strict=True)]
        self._timed = TimedMessages(timed)
        self.next_due_ns = np.full(len(channels), NEVER, dtype=np.int64)
        self.plan(np.arange(len(channels)))

    def write_back(self, i: int, channel: EnergyChannel) -> None:
        """Give scenario i's state back."""
        shift = int(self._shift_ns[i])

        def moment(values: Whole) -> int | None:
            return None if values[i] == NEVER else int(values[i]) + shift

        asked_ns = moment(self._asked_ns)
        channel.restore(
            ChannelState(
                sent_nJ=int(self.sent_nJ[i]),
                acked_nJ=int(self.acked_nJ[i]),
                credited_nJ=int(self.credited_nJ[i]),
                residue_J=float(self._residue_J[i]),
                announced_nJ=int(self._announced_nJ[i]),
                claimed_nJ=int(self._claimed_nJ[i]),
                timed=tuple((nJ, at + shift) for nJ, at in self._timed.of(i)),
                spaced_ns=int(self._spaced_ns[i]) + shift,
                retransmit_ns=moment(self._retransmit_ns),
                ack_ns=moment(self._ack_ns),
                asked=None if asked_ns is None else (asked_ns, int(self._asked_nJ[i])),
            )
        )
        self._buckets.write_back(i, channel.admission)
        self._rto.write_back(i, channel.rto)

    def shuffle(self, at: Index, energy_J: Array) -> None:
        """`EnergyChannel.send`."""
        held_J = self._residue_J[at] + energy_J
        whole_nJ = np.floor(held_J * 1e9)
        whole_nJ -= whole_nJ / 1e9 > held_J
        self.sent_nJ[at] += whole_nJ.astype(np.int64)
        self._residue_J[at] = held_J - whole_nJ / 1e9

    def receive(self, at: Index, total_nJ: Whole, acked_nJ: Whole, now_ns: Whole) -> Whole:
        """Receive one message per scenario. Returns the energy credited now [nJ]."""
        self._acknowledge(at, acked_nJ, now_ns)
        asking = total_nJ > 0
        self._owe_ack(at[asking], now_ns[asking])
        most = self.credited_nJ[at] + self._buckets.most_waiting_nJ
        self._claimed_nJ[at] = np.maximum(self._claimed_nJ[at], np.minimum(total_nJ, most))
        return self.admit(at, now_ns)

    def admit(self, at: Index, now_ns: Whole) -> Whole:
        """`EnergyChannel.admit`."""
        waiting_nJ = self._claimed_nJ[at] - self.credited_nJ[at]
        some = waiting_nJ.nonzero()[0]
        credit_nJ = np.zeros(len(at), dtype=np.int64)
        if not some.size:
            return credit_nJ
        which, now_ns = at[some], now_ns[some]
        taken = credit_nJ[some] = self._take(which, waiting_nJ[some], now_ns)
        self._shown_nJ[which] = self.credited_nJ[which]
        owing = taken > 0
        self._owe_ack(which[owing], now_ns[owing])
        return credit_nJ

    def plentiful(self, total_nJ: Whole) -> bool:
        """True if totals as high as these would be credited at once in every scenario."""
        enough = self._buckets.hold(total_nJ - self.credited_nJ)
        return bool((enough & (self._claimed_nJ == self.credited_nJ)).all())

    def foresee(self, at: Index, total_nJ: Whole, now_ns: Whole) -> Whole:
        """Do the part of `receive` that affects the coupling ahead of time. Returns what will be credited [nJ]."""
        more: Whole = np.maximum(total_nJ - self._claimed_nJ[at], 0)
        self._claimed_nJ[at] += more
        some = more.nonzero()[0]
        more[some] = self._take(at[some], more[some], now_ns[some])
        return more

    def catch_up(self, at: Index, total_nJ: Whole, acked_nJ: Whole, credit_nJ: Whole, now_ns: Whole) -> None:
        """Do the other part of `receive` at its proper time."""
        self._acknowledge(at, acked_nJ, now_ns)
        owing = ((total_nJ > 0) | (credit_nJ > 0)).nonzero()[0]
        self._owe_ack(at[owing], now_ns[owing])
        self._shown_nJ[at] += credit_nJ

    def _take(self, which: Index, waiting_nJ: Whole, now_ns: Whole) -> Whole:
        """`TokenBucket.take`, and credit the energy taken."""
        taken = self._buckets.take(which, waiting_nJ, now_ns)
        self.credited_nJ[which] += taken
        return taken

    def poll(self, at: Index, now_ns: Whole) -> tuple[Index, Whole, Whole]:
        """(which of `at` send now, their total_nJ, their acked_nJ)."""
        announced, sent = self._announced_nJ[at], self.sent_nJ[at]
        news = sent > announced
        expired = self._retransmit_ns[at] <= now_ns
        leaving = expired | (news & (self._spaced_ns[at] <= now_ns))
        alone = ~leaving & (self._ack_ns[at] <= now_ns)
        if (gone := expired.nonzero()[0]).size:
            self._rto.back_off(at[gone])
        if (going := leaving.nonzero()[0]).size:
            which, leaving_ns = at[going], now_ns[going]
            fresh = news[going].nonzero()[0]
            self._announced_nJ[which[fresh]] = sent[going[fresh]]
            self._timed.append(which[fresh], sent[going[fresh]], leaving_ns[fresh])
            if fresh.size < going.size:
                repeating = which[~news[going]]
                self._timed.forget_repeated(repeating, self._announced_nJ[repeating])
            self._spaced_ns[which] = leaving_ns + self._spacing_ns
            self._retransmit_ns[which] = leaving_ns + self._rto.rto_ns(which)
            anew = (self._asked_nJ[which] != self.acked_nJ[which]).nonzero()[0]
            self._asked_ns[which[anew]] = leaving_ns[anew]
            self._asked_nJ[which[anew]] = self.acked_nJ[which[anew]]
        out = (leaving | alone).nonzero()[0]
        which = at[out]
        self._ack_ns[which] = NEVER
        total = np.where(alone[out], 0, self._announced_nJ[which])
        return out, total, self._shown_nJ[which]

    def plan(self, at: Index) -> None:
        """Compute when to poll next, after any change."""
        due = np.minimum(self._retransmit_ns[at], self._ack_ns[at])
        news = (self.sent_nJ[at] > self._announced_nJ[at]).nonzero()[0]
        if news.size:
            due[news] = np.minimum(due[news], self._spaced_ns[at[news]])
        waiting = (self._claimed_nJ[at] > self.credited_nJ[at]).nonzero()[0]
        if waiting.size:
            which = at[waiting]
            wanted = self._claimed_nJ[which] - self.credited_nJ[which]
            filled = self._buckets.due_ns(which, wanted, ADMISSION_STEP_NS)
            due[waiting] = np.minimum(due[waiting], filled)
        self.next_due_ns[at] = due

    def _acknowledge(self, at: Index, acked_nJ: Whole, now_ns: Whole) -> None:
        newer = (acked_nJ > self.acked_nJ[at]).nonzero()[0]
        if not newer.size:
            return
        at, acked_nJ, now_ns = at[newer], acked_nJ[newer], now_ns[newer]
        self.acked_nJ[at] = acked_nJ
        total_nJ, sent_ns = self._timed.take(at, acked_nJ)
        whole = total_nJ == acked_nJ
        self._rto.sample(at[whole], now_ns[whole] - sent_ns[whole])
        self._timed.clear(at[~whole])
        last_ns = self._spaced_ns[at] - self._spacing_ns
        due_ns = np.minimum(now_ns + self._rto.rto_ns(at), last_ns + self._rto.ceiling_ns)
        self._retransmit_ns[at] = np.where(self._announced_nJ[at] > acked_nJ, due_ns, NEVER)

    def _owe_ack(self, at: Index, now_ns: Whole) -> None:
        self._ack_ns[at] = np.minimum(self._ack_ns[at], now_ns + self._ack_delay_ns)
