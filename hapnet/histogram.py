"""A histogram of fixed size, for quantiles of values that are measured for hours."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from itertools import accumulate
from operator import sub


class Histogram:
    """Counts of non-negative integers in a fixed number of bins, 32 to an octave: a quantile is at most 1/32 too high.

    Values below 64 have a bin each. Values of 2^42 and above (73 minutes in ns) share the last bin; `max` stays exact.
    """

    _SUB_BITS = 5
    _MAX_BITS = 42

    def __init__(self, counts: Sequence[int] = (), highest: int = 0) -> None:
        self._counts = list(counts) or [0] * (self._index((1 << self._MAX_BITS) - 1) + 1)
        self.max: int = highest

    @classmethod
    def _index(cls, value: int) -> int:
        shift = value.bit_length() - cls._SUB_BITS - 1
        return (shift << cls._SUB_BITS) + (value >> shift) if shift > 0 else value

    @classmethod
    def _highest(cls, index: int) -> int:
        """Highest value that falls in the bin."""
        shift = max(0, (index >> cls._SUB_BITS) - 1)
        return ((index - (shift << cls._SUB_BITS) + 1) << shift) - 1

    def add(self, value: int) -> None:
        """Count one value; a negative one counts as 0."""
        index = self._index(value) if value > 0 else 0
        counts = self._counts
        counts[index if index < len(counts) else -1] += 1
        if value > self.max:
            self.max = value

    def since(self, earlier: Histogram) -> Histogram:
        """The values counted since `earlier`, a `copy` of this histogram; `max` is that of all values."""
        return Histogram(list(map(sub, self.counts, earlier.counts)), self.max)

    def copy(self) -> Histogram:
        """An independent copy."""
        return Histogram(self._counts, self.max)

    @property
    def counts(self) -> list[int]:
        """The present counts of all bins."""
        return self._counts.copy()

    def bins(self) -> tuple[tuple[int, int], ...]:
        """(highest value, count) of every bin that is not empty, ascending."""
        counts = self._counts.copy()
        last = len(counts) - 1
        return tuple((self.max if i == last else min(self._highest(i), self.max), n) for i, n in enumerate(counts) if n)

    @property
    def total(self) -> int:
        """How many values were counted."""
        return sum(self._counts)

    def quantile(self, q: float) -> int | None:
        """Smallest bin edge that at least a share `q` of the values does not exceed (None if there is no value)."""
        seen = list(accumulate(self._counts.copy()))
        total = seen[-1]
        if total == 0:
            return None
        index = bisect_left(seen, max(1, q * total))
        return self.max if index >= len(seen) - 1 else min(self._highest(index), self.max)
