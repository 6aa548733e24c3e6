"""A histogram of fixed size, for quantiles of values that are measured for hours."""

from __future__ import annotations

import math
from array import array
from bisect import bisect_left
from collections.abc import Sequence
from itertools import accumulate
from operator import sub
from typing import Annotated

from hapnet.records.record import Record, Wholes, equation

BINS = 1216
"""The number of bins, which cover values up to 2^42."""

FEW = 32
"""So many values are faster counted one by one."""


class Histogram(Record):
    """Counts of non-negative integers in a fixed number of bins, 32 per octave: a quantile is at most 1/32 too high.

    Values below 64 have a bin each. Values of 2^42 and above (73 minutes in ns) share the last bin; `max` stays exact.
    """

    tallies: Annotated[Wholes, (BINS,)]
    max: int

    def __init__(self, counts: Sequence[int] = (), highest: int = 0) -> None:
        self.tallies = array(
            "q", counts if len(counts) else bytes(8 * BINS)
        )  # no object for each count: it runs for days
        self.max = highest

    @equation
    def add(self, value: int) -> None:
        """Count one value; a negative one counts as 0."""
        if value > self.max:
            self.max = value
        shift = 0
        if value >= 64:
            shift = math.frexp(value)[1] - 6  # what remains has 6 bits
        elif value < 0:
            value = 0
        index = (shift << 5) + (value >> shift)
        self.tallies[index if index < BINS else BINS - 1] += 1

    def add_steps(self, value: int, step: int, count: int) -> None:
        """Count `count` values, ``value, value - step, ...``, none negative: millions take no longer than hundreds."""
        lowest = value - (count - 1) * step
        if count <= FEW:
            for one in range(lowest, value + 1, step):
                self.add(one)
            return
        self.max = max(self.max, value)
        index, counted = _index(lowest), 0
        while counted < count:
            upto = count if index >= BINS - 1 else min(count, max(0, (_highest(index) - lowest) // step + 1))
            self.tallies[min(index, BINS - 1)] += upto - counted
            index, counted = index + 1, upto

    def since(self, earlier: Histogram) -> Histogram:
        """The values counted since `earlier`, a `copy` of this histogram; `max` covers all values."""
        return Histogram(list(map(sub, self.counts, earlier.counts)), self.max)

    def copy(self) -> Histogram:
        """An independent copy."""
        return Histogram(self.counts, self.max)

    @property
    def counts(self) -> list[int]:
        """The present counts of all bins."""
        return list(self.tallies)

    def bins(self) -> tuple[tuple[int, int], ...]:
        """(highest value, count) of every non-empty bin, in ascending order."""
        counts = self.counts
        last = len(counts) - 1
        return tuple((self.max if i == last else min(_highest(i), self.max), n) for i, n in enumerate(counts) if n)

    @property
    def total(self) -> int:
        """The number of values counted."""
        return sum(self.tallies)

    def quantile(self, q: float) -> int | None:
        """The smallest bin edge that at least a share `q` of the values does not exceed; None: no values."""
        place = self._place(q)
        return None if place is None else self._edge(place[0])

    def interpolated(self, q: float, minimum: int) -> int | None:
        """As `quantile`, but unbiased: it assumes that the values of a bin are spread evenly.

        minimum : a lower bound of all values.
        """
        if (place := self._place(q)) is None:
            return None
        index, share = place
        high = self._edge(index)
        low = min(high, max(minimum, _highest(index - 1) + 1))
        return low + round((high - low) * share)

    def _place(self, q: float) -> tuple[int, float] | None:
        """The bin that contains the quantile, and the share of the bin's values up to the quantile."""
        seen = list(accumulate(self.counts))
        if seen[-1] == 0:
            return None
        rank = max(1, q * seen[-1])
        index = bisect_left(seen, rank)
        before = seen[index - 1] if index else 0
        return index, (rank - before) / (seen[index] - before)

    def _edge(self, index: int) -> int:
        return self.max if index == BINS - 1 else min(_highest(index), self.max)


def _index(value: int) -> int:
    """The bin of a non-negative value; from 2^42 on an index beyond the last bin."""
    shift = max(0, value.bit_length() - 6)
    return (shift << 5) + (value >> shift)


def _highest(index: int) -> int:
    """The highest value in the bin."""
    shift = max(0, (index >> 5) - 1)
    return ((index - (shift << 5) + 1) << shift) - 1


add = Histogram.add
"""`Histogram.add` for equations."""
