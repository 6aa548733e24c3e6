"""The delays on one direction of the link in many scenarios at once: `netem.stats.DelayHistogram`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hapnet.simulation.batch.arrays import NEVER, Index, Whole
from netem.stats import BINS, DelayHistogram, Delays, bin_of


class DelayHistograms:
    """One for each of `count` scenarios."""

    def __init__(self, count: int) -> None:
        self._counts = np.zeros((count, BINS), dtype=np.int64)
        self._sums = np.zeros((4, count), dtype=np.int64)
        self._least_ns = np.full(count, NEVER, dtype=np.int64)
        self._most_ns = np.full(count, -1, dtype=np.int64)

    def add(self, at: Index, delay_ns: Whole, counted: NDArray[np.bool_]) -> None:
        """Those that are `counted`, a column for each of `at`. `delay_ns` is used up."""
        seen = delay_ns[counted]
        if not seen.size:
            return
        column, bins = counted.nonzero()[1], bin_of(seen)
        low, width = int(bins.min()), int(bins.max()) + 1 - int(bins.min())
        counts = np.bincount(column * width + bins - low, minlength=len(at) * width)
        self._counts[at, low : low + width] += counts.reshape(len(at), width)
        self._least_ns[at] = np.minimum(self._least_ns[at], np.where(counted, delay_ns, NEVER).min(axis=0))
        self._most_ns[at] = np.maximum(self._most_ns[at], np.where(counted, delay_ns, -1).max(axis=0))
        delay_ns *= counted
        high, rest = delay_ns >> 20, delay_ns & 0xFFFFF  # the square of a long delay takes more than 64 bits
        for total, term in zip(self._sums, (delay_ns, high * high, high * rest, rest * rest), strict=True):
            total[at] += term.sum(axis=0)

    def write_back(self, i: int, histogram: DelayHistogram) -> None:
        """Give scenario i's delays back."""
        if not self._counts[i].any():
            return
        total, high, mixed, low = self._sums[:, i].tolist()
        square = (high << 40) + (mixed << 21) + low
        histogram.add(Delays(total, square, int(self._least_ns[i]), int(self._most_ns[i]), self._counts[i]))
