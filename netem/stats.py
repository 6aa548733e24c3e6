"""A link's statistics: counters, and delay percentiles from a histogram of fixed size."""

from __future__ import annotations

import math
from dataclasses import dataclass
from operator import mul
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

_PER_OCTAVE = 64  # a bin is 1.1 % wide
_FEWEST = 8  # bins_ms never joins to fewer than this many filled bins
_FLOOR_NS, _OCTAVES = 1000, 40  # 1 us to 10^6 s; values outside count in the outermost bins
BINS = _PER_OCTAVE * _OCTAVES


@dataclass(frozen=True, slots=True)
class LinkStats:
    """A snapshot: offered = delivered + lost + lost_down + dropped_limit + in_flight, always.

    `offered` counts the copies that `duplicate` makes too, and `duplicated` only them. `profile` is the active one, in
    tc-netem's syntax. `lost` counts the messages lost by the loss model or a trace and not recovered by resends, and
    `loss_bursts` their runs. `resent` counts the resends, `recovered` the messages that a resend delivers; both count
    when the message is offered. `lost_down` counts messages offered to a link that was down (these are not resent),
    `dropped_limit` those that found the link full. `reordered` counts messages delivered after one that was sent later
    (RFC 4737, section 3.3), whatever the cause. With ``reorder 5%`` and a long queue these are nearly all messages,
    because nearly all are overtaken; `sent_ahead` counts only the messages that `reorder` itself sent ahead. Delays are
    from the offer to the release by the profile, None before the first; the percentiles are read from bins 1.1 % wide.
    `late_max_ms` is the longest time that a message stayed after its release because the link was not polled.
    `netem.expect` computes the figures to expect.

    `delay_histogram_ms` is ready to draw, as (edge, count): a bin reaches from the previous edge to its own, and holds
    `count` delays. A count of 0 is a gap; so is the first entry, which only marks the begin of the first bin.
    """

    profile: str
    offered: int
    delivered: int
    lost: int
    loss_bursts: int
    resent: int
    recovered: int
    lost_down: int
    dropped_limit: int
    corrupted: int
    duplicated: int
    reordered: int
    sent_ahead: int
    in_flight: int
    delay_mean_ms: float | None
    delay_std_ms: float | None
    delay_p50_ms: float | None
    delay_p99_ms: float | None
    late_max_ms: float
    delay_histogram_ms: tuple[tuple[float, int], ...]

    @property
    def loss(self) -> float | None:
        """The share lost and not recovered, of the messages offered while the link was up; None without any."""
        offered = self.offered - self.lost_down
        return self.lost / offered if offered else None

    @property
    def mean_loss_burst(self) -> float | None:
        """The mean length of a run of messages lost by the loss model; None if there is none."""
        return self.lost / self.loss_bursts if self.loss_bursts else None

    def as_dict(self) -> dict[str, object]:
        """All fields by name, as JSON has them."""
        plain = {name: getattr(self, name) for name in self.__slots__}
        return plain | {"delay_histogram_ms": [list(pair) for pair in self.delay_histogram_ms]}


class Delays(NamedTuple):
    """The statistics of a `DelayHistogram`, of at least one delay."""

    total_ns: int
    total_square: int
    """The sum of the delays' squares [ns^2]."""
    min_ns: int
    most_ns: int
    counts: NDArray[np.int64]
    """The number of delays in each of the `BINS`; see `bin_of`."""


def bin_of(delays_ns: ArrayLike) -> NDArray[np.intp]:
    """The bin that each of these delays counts in."""
    octaves = np.log2(np.maximum(delays_ns, _FLOOR_NS) / _FLOOR_NS)
    return np.minimum((octaves * _PER_OCTAVE).astype(np.intp), BINS - 1)


class DelayHistogram:
    """Counts delays [ns] in a fixed number of log-spaced bins. Append to `pending`; `fold` at `PENDING` or before."""

    PENDING = 256

    def __init__(self) -> None:
        self._counts = np.zeros(BINS, dtype=np.int64)
        self._total_ns, self._total_square, self._min_ns, self._most_ns = 0, 0, 0, 0
        self._count = 0
        self.pending: list[int] = []

    def fold(self) -> None:
        """Move the pending delays into the bins, which costs less for many at once."""
        if not (delays := self.pending):
            return
        square = sum(map(mul, delays, delays))
        counts = np.bincount(bin_of(delays), minlength=BINS)
        self.add(Delays(sum(delays), square, min(delays), max(delays), counts))
        delays.clear()

    def add(self, delays: Delays) -> None:
        """Count these delays too."""
        self._min_ns = min(self._min_ns, delays.min_ns) if self._count else delays.min_ns
        self._most_ns = max(self._most_ns, delays.most_ns) if self._count else delays.most_ns
        self._total_ns += delays.total_ns
        self._total_square += delays.total_square
        self._count += int(delays.counts.sum())
        self._counts += delays.counts

    def mean_ms(self) -> float | None:
        """Mean delay in ms; None if nothing was counted."""
        self.fold()
        return self._total_ns / self._count * 1e-6 if self._count else None

    def std_ms(self) -> float | None:
        """Standard deviation of the delays in ms; None if nothing was counted."""
        self.fold()
        if not self._count:
            return None
        # in whole numbers, so that no digits cancel
        return math.sqrt(self._count * self._total_square - self._total_ns**2) / self._count * 1e-6

    def quantile_ms(self, fraction: float) -> float | None:
        """The delay in ms that the share `fraction` of all delays does not exceed; None if nothing was counted."""
        self.fold()
        if not self._count:
            return None
        rank = max(1, math.ceil(fraction * self._count))
        index = int(np.searchsorted(np.cumsum(self._counts), rank))
        middle = _FLOOR_NS * 2.0 ** ((index + 0.5) / _PER_OCTAVE)
        return float(min(max(middle, self._min_ns), self._most_ns)) * 1e-6

    def bins_ms(self, most: int = 60) -> tuple[tuple[float, int], ...]:
        """(edge, count) as in `LinkStats.delay_histogram_ms`; neighbours are joined until few enough bins are filled.

        At most `most` bins are filled, and at most the square root of the count: a finer histogram shows only noise.
        """
        self.fold()
        counts, most = self._counts, min(most, max(_FEWEST, math.isqrt(self._count)))
        while np.count_nonzero(counts) > most:
            counts = counts.reshape(-1, 2).sum(axis=1)
        joined = len(self._counts) // len(counts)
        out: list[tuple[float, int]] = []
        reached = -1
        for index in np.flatnonzero(counts).tolist():
            if index != reached:
                out.append((_edge_ms(index * joined), 0))
            reached = index + 1
            out.append((_edge_ms(reached * joined), int(counts[index])))
        return tuple(out)


class Counters:
    """A link's counters; the names are those of `LinkStats`.

    newest : number of the newest message delivered. last_lost : number of the last message lost.
    late_max_ns : see `LinkStats.late_max_ms`. delays : those of the delivered messages.
    """

    __slots__ = (
        "corrupted", "delays", "dropped_limit", "duplicated", "last_lost", "late_max_ns", "loss_bursts", "lost",
        "lost_down", "newest", "offered", "recovered", "reordered", "resent", "sent_ahead",
    )  # fmt: skip

    def __init__(self) -> None:
        self.offered = self.lost = self.lost_down = self.dropped_limit = self.corrupted = 0
        self.duplicated = 0
        self.loss_bursts, self.last_lost = 0, -1
        self.reordered = self.sent_ahead = self.resent = self.recovered = 0
        self.newest = self.late_max_ns = 0
        self.delays = DelayHistogram()

    def snapshot(self, profile: str, in_flight: int) -> LinkStats:
        """The link's statistics so far."""
        not_delivered = self.lost + self.lost_down + self.dropped_limit
        return LinkStats(
            profile=profile,
            offered=self.offered,
            delivered=self.offered - not_delivered - in_flight,
            lost=self.lost,
            loss_bursts=self.loss_bursts,
            resent=self.resent,
            recovered=self.recovered,
            lost_down=self.lost_down,
            dropped_limit=self.dropped_limit,
            corrupted=self.corrupted,
            duplicated=self.duplicated,
            reordered=self.reordered,
            sent_ahead=self.sent_ahead,
            in_flight=in_flight,
            delay_mean_ms=self.delays.mean_ms(),
            delay_std_ms=self.delays.std_ms(),
            delay_p50_ms=self.delays.quantile_ms(0.50),
            delay_p99_ms=self.delays.quantile_ms(0.99),
            late_max_ms=self.late_max_ns * 1e-6,
            delay_histogram_ms=self.delays.bins_ms(),
        )


def _edge_ms(index: int) -> float:
    """The begin of a bin [ms]; the first begins at 0, because smaller values count in it."""
    return _FLOOR_NS * 2.0 ** (index / _PER_OCTAVE) * 1e-6 if index else 0.0
