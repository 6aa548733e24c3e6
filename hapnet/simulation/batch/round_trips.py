"""Round trips in many scenarios at once: the messages that are being timed, and `hapnet.wire.rto`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hapnet.simulation.batch.arrays import Index, Whole
from hapnet.wire.energy_channel import MAX_TIMED
from hapnet.wire.rto import GRANULARITY_NS, RtoEstimator, RtoState

_FEW = np.arange(2)  # messages that are acknowledged together, most often


class RtoEstimators:
    """The estimators of one side, with the same floor and ceiling."""

    def __init__(self, estimators: list[RtoEstimator]) -> None:
        self.ceiling_ns, self._floor_ns = estimators[0].ceiling_ns, estimators[0].floor_ns
        states = [estimator.state() for estimator in estimators]
        self._base_ns = np.array([s.base_ns for s in states], dtype=np.int64)
        self._backed_off = np.array([s.backed_off for s in states], dtype=np.int64)
        self._srtt_ns = np.array([-1 if s.srtt_ns is None else s.srtt_ns for s in states], dtype=np.int64)
        self._rttvar_ns = np.array([s.rttvar_ns for s in states], dtype=np.int64)

    def write_back(self, i: int, estimator: RtoEstimator) -> None:
        """Write scenario i's state back."""
        base_ns, backed_off, srtt_ns, rttvar_ns = (
            int(values[i]) for values in (self._base_ns, self._backed_off, self._srtt_ns, self._rttvar_ns)
        )
        estimator.restore(RtoState(base_ns, backed_off, None if srtt_ns < 0 else srtt_ns, rttvar_ns))

    def rto_ns(self, at: Index) -> Whole:
        """`RtoEstimator.rto_ns`."""
        rto_ns: Whole = np.minimum(self._base_ns[at] << self._backed_off[at], self.ceiling_ns)
        return rto_ns

    def back_off(self, at: Index) -> None:
        """`RtoEstimator.back_off`."""
        self._backed_off[at] += self.rto_ns(at) < self.ceiling_ns

    def sample(self, at: Index, rtt_ns: Whole) -> None:
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
        self._base_ns[at] = np.minimum(np.maximum(rto_ns, self._floor_ns), self.ceiling_ns)
        self._backed_off[at] = 0


class TimedMessages:
    """The messages whose round trip is being measured, (total, time of sending) each, the oldest first.

    A ring a scenario, message number k at k modulo its length.
    """

    def __init__(self, timed: Sequence[Sequence[tuple[int, int]]]) -> None:
        self._total_nJ = np.zeros((MAX_TIMED, len(timed)), dtype=np.int64)
        self._sent_ns = np.zeros((MAX_TIMED, len(timed)), dtype=np.int64)
        self._first = np.zeros(len(timed), dtype=np.int64)
        self._last = np.array([len(messages) for messages in timed], dtype=np.int64)
        for i, messages in enumerate(timed):
            for k, message in enumerate(messages):
                self._total_nJ[k, i], self._sent_ns[k, i] = message

    def of(self, i: int) -> list[tuple[int, int]]:
        """Those of scenario i."""
        row = np.arange(self._first[i], self._last[i]) % MAX_TIMED
        return list(zip(self._total_nJ[row, i].tolist(), self._sent_ns[row, i].tolist(), strict=True))

    def append(self, at: Index, total_nJ: Whole, now_ns: Whole) -> None:
        """One more each; where there is no room, the oldest goes."""
        last = self._last[at]
        row = last % MAX_TIMED
        self._total_nJ[row, at], self._sent_ns[row, at] = total_nJ, now_ns
        self._last[at] = last + 1
        self._first[at] = np.maximum(self._first[at], last + 1 - MAX_TIMED)

    def forget_repeated(self, at: Index, total_nJ: Whole) -> None:
        """The newest, where it says this total: it is sent again, and its acknowledgement could belong to either."""
        last = self._last[at]
        repeated = (last > self._first[at]) & (self._total_nJ[(last - 1) % MAX_TIMED, at] == total_nJ)
        self._last[at[repeated]] -= 1

    def take(self, at: Index, acked_nJ: Whole) -> tuple[Whole, Whole]:
        """Take out those with totals up to `acked_nJ`: (total, time of sending) of the newest of them, 0 if none."""
        total_nJ, sent_ns = np.zeros_like(acked_nJ), np.zeros_like(acked_nJ)
        left = np.arange(len(at))
        while left.size:
            which = at[left]
            first, last = self._first[which], self._last[which]
            row = (first + _FEW[:, None]) % MAX_TIMED
            covered = (self._total_nJ[row, which] <= acked_nJ[left]) & (first + _FEW[:, None] < last)
            taken = covered.sum(axis=0)  # totals increase: what is covered comes first
            self._first[which] = first + taken
            some = taken.nonzero()[0]
            newest = row[taken[some] - 1, some]
            total_nJ[left[some]] = self._total_nJ[newest, which[some]]
            sent_ns[left[some]] = self._sent_ns[newest, which[some]]
            left = left[taken == len(_FEW)]
        return total_nJ, sent_ns

    def clear(self, at: Index) -> None:
        """Forget all."""
        self._first[at] = self._last[at]
