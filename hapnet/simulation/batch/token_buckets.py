"""One side's token buckets in many scenarios at once: `hapnet.wire.token_bucket`, in whole numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hapnet.simulation.batch.arrays import Index, Whole
from hapnet.wire.token_bucket import BucketState, TokenBucket

_AJ_PER_NJ = 1_000_000_000


class TokenBuckets:
    """The buckets of one side, with the same rate and burst. shift_ns : time on their clocks at the batch's 0."""

    def __init__(self, buckets: list[TokenBucket], shift_ns: Whole) -> None:
        first = buckets[0]
        self._rate_nW, self._burst_aJ = first.rate_nW, first.burst_aJ
        self.most_waiting_nJ = first.most_waiting_nJ
        states = [bucket.state() for bucket in buckets]
        self._level_aJ = np.array([s.level_aJ for s in states], dtype=np.int64)
        self._filled_ns = np.array([s.filled_ns or 0 for s in states], dtype=np.int64) - shift_ns
        self._shift_ns = shift_ns

    def write_back(self, i: int, bucket: TokenBucket) -> None:
        """Write scenario i's state back."""
        bucket.restore(BucketState(int(self._level_aJ[i]), int(self._filled_ns[i] + self._shift_ns[i])))

    def hold(self, energy_nJ: Whole) -> NDArray[np.bool_]:
        """True where there are tokens for so much already."""
        return self._level_aJ // _AJ_PER_NJ >= energy_nJ

    def take(self, at: Index, wanted_nJ: Whole, now_ns: Whole) -> Whole:
        """`TokenBucket.take`."""
        level = self._level_aJ[at]
        passed = now_ns - self._filled_ns[at]
        # Compare before multiplying: a long pause would overflow.
        filling = passed < (self._burst_aJ - level) // self._rate_nW + 1
        level = np.where(filling, level + self._rate_nW * np.where(filling, passed, 0), self._burst_aJ)
        level = np.minimum(level, self._burst_aJ)
        self._filled_ns[at] = now_ns
        taken = np.minimum(wanted_nJ, level // _AJ_PER_NJ)
        self._level_aJ[at] = level - taken * _AJ_PER_NJ
        return taken

    def due_ns(self, at: Index, wanted_nJ: Whole, step_ns: int) -> Whole:
        """`TokenBucket.due_ns`."""
        step_nJ = max(1, self._rate_nW * step_ns // _AJ_PER_NJ)
        most = min(self._burst_aJ // _AJ_PER_NJ + 1, step_nJ)
        lacking = np.minimum(np.minimum(wanted_nJ, most) * _AJ_PER_NJ, self._burst_aJ) - self._level_aJ[at]
        due_ns: Whole = self._filled_ns[at] + np.maximum(0, -(-lacking // self._rate_nW))
        return due_ns
