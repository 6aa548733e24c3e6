"""One side's energy channels in many scenarios at once: `hapnet.wire.energy_channel`, with its RTO and its admission.

All values are whole numbers, so the order of operations does not matter here.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array
from hapnet.simulation.batch.couplings import Index
from hapnet.wire.energy_channel import ADMISSION_STEP_NS, MAX_TIMED, EnergyChannel
from hapnet.wire.rto import GRANULARITY_NS

Whole = NDArray[np.int64]

NEVER = 2**62
_AJ_PER_NJ = 1_000_000_000
_FEW = np.arange(2)  # messages that are acknowledged together, most often


class Channels:
    """The channels of one side; `next_due_ns` says when each must be polled.

    `shift_ns`: time on a scenario's own clock when the batch's clock shows 0.
    """

    def __init__(self, channels: list[EnergyChannel], shift_ns: Whole) -> None:
        first = channels[0]
        self._spacing_ns, self._ack_delay_ns = first._spacing_ns, first._ack_delay_ns
        admission, rto = first._admission, first.rto
        self._rate_nW, self._burst_aJ = admission._rate_nW, admission._burst_aJ
        self._floor_ns, self._ceiling_ns = rto._floor_ns, rto._ceiling_ns

        def whole(values: list[int]) -> Whole:
            return np.array(values, dtype=np.int64)

        self._shift_ns = shift_ns
        self.sent_nJ = whole([c.sent_nJ for c in channels])
        self.acked_nJ = whole([c.acked_nJ for c in channels])
        self.credited_nJ = whole([c.credited_nJ for c in channels])
        self._shown_nJ = self.credited_nJ.copy()
        """The credited energy that messages acknowledge: less than was credited, while a window is deferred."""
        self._told_nJ = whole([c._told_nJ for c in channels])
        self._most_waiting_nJ = channels[0]._most_waiting_nJ
        self._claimed_nJ = whole([c._claimed_nJ for c in channels])
        self._residue_J = np.array([c.residue_J for c in channels])
        self._level_aJ = whole([c._admission._level_aJ for c in channels])
        self._filled_ns = whole([(c._admission._filled_ns or 0) - s for c, s in zip(channels, shift_ns, strict=True)])
        self._base_ns = whole([c.rto._base_ns for c in channels])
        self._backed_off = whole([c.rto._backed_off for c in channels])
        self._srtt_ns = whole([-1 if c.rto.srtt_ns is None else c.rto.srtt_ns for c in channels])
        self._rttvar_ns = whole([c.rto.rttvar_ns for c in channels])
        # Times may lie before the load, so NEVER stands for none.
        self._spaced_ns = whole([c._spaced_ns for c in channels]) - shift_ns
        self._retransmit_ns = self._moments([c._retransmit_ns for c in channels])
        self._ack_ns = self._moments([c._ack_ns for c in channels])
        asked = [c._asked or (None, -1) for c in channels]
        self._asked_ns, self._asked_nJ = self._moments([at for at, _ in asked]), whole([nJ for _, nJ in asked])
        self._timed_nJ = np.zeros((MAX_TIMED, len(channels)), dtype=np.int64)
        self._timed_ns = np.zeros((MAX_TIMED, len(channels)), dtype=np.int64)
        self._first = np.zeros(len(channels), dtype=np.int64)
        self._last = whole([len(c._timed) for c in channels])
        for i, channel in enumerate(channels):
            for k, (total_nJ, at_ns) in enumerate(channel._timed):
                self._timed_nJ[k, i], self._timed_ns[k, i] = total_nJ, at_ns - shift_ns[i]
        self.next_due_ns = np.full(len(channels), NEVER, dtype=np.int64)
        self.plan(np.arange(len(channels)))

    def _moments(self, values: list[int | None]) -> Whole:
        shifts = self._shift_ns.tolist()
        return np.array([NEVER if t is None else t - s for t, s in zip(values, shifts, strict=True)], dtype=np.int64)

    def land(self, i: int, channel: EnergyChannel) -> None:
        """Give scenario i's state back."""
        shift = int(self._shift_ns[i])
        channel.sent_nJ, channel.acked_nJ = int(self.sent_nJ[i]), int(self.acked_nJ[i])
        channel.credited_nJ, channel.residue_J = int(self.credited_nJ[i]), float(self._residue_J[i])
        channel._told_nJ, channel._claimed_nJ = int(self._told_nJ[i]), int(self._claimed_nJ[i])
        channel._spaced_ns = int(self._spaced_ns[i]) + shift
        channel._retransmit_ns, channel._ack_ns = (
            None if at[i] == NEVER else int(at[i]) + shift for at in (self._retransmit_ns, self._ack_ns)
        )
        asked_nJ = int(self._asked_nJ[i])
        channel._asked = None if asked_nJ < 0 else (int(self._asked_ns[i]) + shift, asked_nJ)
        row = np.arange(self._first[i], self._last[i]) % MAX_TIMED
        timed = zip(self._timed_nJ[row, i].tolist(), (self._timed_ns[row, i] + shift).tolist(), strict=True)
        channel._timed = deque(timed, maxlen=MAX_TIMED)
        admission, rto = channel._admission, channel.rto
        admission._level_aJ, admission._filled_ns = int(self._level_aJ[i]), int(self._filled_ns[i]) + shift
        rto._base_ns, rto._backed_off = int(self._base_ns[i]), int(self._backed_off[i])
        rto.srtt_ns = None if self._srtt_ns[i] < 0 else int(self._srtt_ns[i])
        rto.rttvar_ns = int(self._rttvar_ns[i])

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
        most = self.credited_nJ[at] + self._most_waiting_nJ
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
        enough = self._level_aJ // _AJ_PER_NJ >= total_nJ - self.credited_nJ
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
        level = self._level_aJ[which]
        passed = now_ns - self._filled_ns[which]
        # Compare before multiplying: a long pause would overflow.
        filling = passed < (self._burst_aJ - level) // self._rate_nW + 1
        level = np.where(filling, level + self._rate_nW * np.where(filling, passed, 0), self._burst_aJ)
        level = np.minimum(level, self._burst_aJ)
        self._filled_ns[which] = now_ns
        taken = np.minimum(waiting_nJ, level // _AJ_PER_NJ)
        self._level_aJ[which] = level - taken * _AJ_PER_NJ
        self.credited_nJ[which] += taken
        return taken

    def poll(self, at: Index, now_ns: Whole) -> tuple[Index, Whole, Whole]:
        """(which of `at` send now, their total_nJ, their acked_nJ)."""
        announced, sent = self._told_nJ[at], self.sent_nJ[at]
        news = sent > announced
        expired = self._retransmit_ns[at] <= now_ns
        leaving = expired | (news & (self._spaced_ns[at] <= now_ns))
        alone = ~leaving & (self._ack_ns[at] <= now_ns)
        if (gone := expired.nonzero()[0]).size:
            which = at[gone]
            self._backed_off[which] += self._rto_ns(which) < self._ceiling_ns
        if (going := leaving.nonzero()[0]).size:
            which, leaving_ns = at[going], now_ns[going]
            fresh = news[going].nonzero()[0]
            self._time(which[fresh], sent[going[fresh]], leaving_ns[fresh])
            if fresh.size < going.size:
                self._untime(which[~news[going]])
            self._spaced_ns[which] = leaving_ns + self._spacing_ns
            self._retransmit_ns[which] = leaving_ns + self._rto_ns(which)
            anew = (self._asked_nJ[which] != self.acked_nJ[which]).nonzero()[0]
            self._asked_ns[which[anew]] = leaving_ns[anew]
            self._asked_nJ[which[anew]] = self.acked_nJ[which[anew]]
        out = (leaving | alone).nonzero()[0]
        which = at[out]
        self._ack_ns[which] = NEVER
        total = np.where(alone[out], 0, self._told_nJ[which])
        return out, total, self._shown_nJ[which]

    def plan(self, at: Index) -> None:
        """Compute when to poll next, after any change."""
        due = np.minimum(self._retransmit_ns[at], self._ack_ns[at])
        news = (self.sent_nJ[at] > self._told_nJ[at]).nonzero()[0]
        if news.size:
            due[news] = np.minimum(due[news], self._spaced_ns[at[news]])
        waiting = (self._claimed_nJ[at] > self.credited_nJ[at]).nonzero()[0]
        if waiting.size:
            which = at[waiting]
            wanted = self._claimed_nJ[which] - self.credited_nJ[which]
            step_nJ = max(1, self._rate_nW * ADMISSION_STEP_NS // _AJ_PER_NJ)
            most = min(self._burst_aJ // _AJ_PER_NJ + 1, step_nJ)
            lacking = np.minimum(np.minimum(wanted, most) * _AJ_PER_NJ, self._burst_aJ) - self._level_aJ[which]
            filled = self._filled_ns[which] + np.maximum(0, -(-lacking // self._rate_nW))
            due[waiting] = np.minimum(due[waiting], filled)
        self.next_due_ns[at] = due

    def _acknowledge(self, at: Index, acked_nJ: Whole, now_ns: Whole) -> None:
        newer = (acked_nJ > self.acked_nJ[at]).nonzero()[0]
        if not newer.size:
            return
        at, acked_nJ, now_ns = at[newer], acked_nJ[newer], now_ns[newer]
        self.acked_nJ[at] = acked_nJ
        total_nJ, sent_ns = np.zeros_like(acked_nJ), np.zeros_like(acked_nJ)
        left = np.arange(len(at))
        while left.size:
            which = at[left]
            first, last = self._first[which], self._last[which]
            row = (first + _FEW[:, None]) % MAX_TIMED
            covered = (self._timed_nJ[row, which] <= acked_nJ[left]) & (first + _FEW[:, None] < last)
            taken = covered.sum(axis=0)  # totals increase: what is covered comes first
            self._first[which] = first + taken
            some = taken.nonzero()[0]
            newest = row[taken[some] - 1, some]
            total_nJ[left[some]] = self._timed_nJ[newest, which[some]]
            sent_ns[left[some]] = self._timed_ns[newest, which[some]]
            left = left[taken == len(_FEW)]
        whole = total_nJ == acked_nJ
        self._sample(at[whole], now_ns[whole] - sent_ns[whole])
        self._first[at[~whole]] = self._last[at[~whole]]
        due_ns = np.minimum(now_ns + self._rto_ns(at), self._spaced_ns[at] - self._spacing_ns + self._ceiling_ns)
        self._retransmit_ns[at] = np.where(self._told_nJ[at] > acked_nJ, due_ns, NEVER)

    def _owe_ack(self, at: Index, now_ns: Whole) -> None:
        self._ack_ns[at] = np.minimum(self._ack_ns[at], now_ns + self._ack_delay_ns)

    def _time(self, at: Index, total_nJ: Whole, now_ns: Whole) -> None:
        self._told_nJ[at] = total_nJ
        last = self._last[at]
        row = last % MAX_TIMED
        self._timed_nJ[row, at], self._timed_ns[row, at] = total_nJ, now_ns
        self._last[at] = last + 1
        self._first[at] = np.maximum(self._first[at], last + 1 - MAX_TIMED)

    def _untime(self, at: Index) -> None:
        last = self._last[at]
        repeated = (last > self._first[at]) & (self._timed_nJ[(last - 1) % MAX_TIMED, at] == self._told_nJ[at])
        self._last[at[repeated]] -= 1

    def _rto_ns(self, at: Index) -> Whole:
        rto_ns: Whole = np.minimum(self._base_ns[at] << self._backed_off[at], self._ceiling_ns)
        return rto_ns

    def _sample(self, at: Index, rtt_ns: Whole) -> None:
        """`RtoEstimator.sample`."""
        if not at.size:
            return
        rtt_ns = np.maximum(0, rtt_ns)
        srtt, rttvar = self._srtt_ns[at], self._rttvar_ns[at]
        known = srtt >= 0
        rttvar = np.where(known, (3 * rttvar + np.abs(srtt - rtt_ns)) // 4, rtt_ns // 2)
        srtt = np.where(known, (7 * srtt + rtt_ns) // 8, rtt_ns)
        self._srtt_ns[at], self._rttvar_ns[at] = srtt, rttvar
        rto_ns = srtt + np.maximum(GRANULARITY_NS, 4 * rttvar)
        self._base_ns[at] = np.minimum(np.maximum(rto_ns, self._floor_ns), self._ceiling_ns)
        self._backed_off[at] = 0
