"""A stream of messages sent through a link in virtual time, and what became of it."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from netem.link import Link
from netem.profile import LinkProfile
from netem.stats import LinkStats


@dataclass(frozen=True, slots=True)
class Survey:
    """The link's `stats`, and the delays (ms) of what was delivered, in the order it was sent.

    `counts` is their histogram over the bins between `edges_ms`. A burst of losses is a run of messages that did not
    arrive, whatever the reason. `delays_ms` has one value a message sent, NaN where it did not arrive.
    """

    stats: LinkStats
    delays_ms: NDArray[np.float64]
    delay_correlation: float | None
    longest_loss: int
    mean_loss_burst: float | None
    edges_ms: list[float]
    counts: list[int]

    def as_dict(self) -> dict[str, object]:
        """All fields but the single delays by name, as JSON has them; the link's counters at the top."""
        names = [field.name for field in fields(self) if field.name not in ("stats", "delays_ms")]
        return self.stats.as_dict() | {name: getattr(self, name) for name in names}


def run(profile: LinkProfile, seed: int, count: int, interval_ns: int, size: int, bins: int = 20) -> Survey:
    """Send `count` messages of `size` bytes, one every `interval_ns`, and wait for all that arrive.

    The messages are plain numbers, so there is nothing to corrupt.
    """
    link: Link[int] = Link(profile, seed)
    delays = np.full(count, -1, dtype=np.int64)
    for number in range(count):
        link.send(number * interval_ns, number, size)
        for due_ns, arrived in link.poll(number * interval_ns):
            delays[arrived] = due_ns - arrived * interval_ns
    while (next_ns := link.next_due_ns) is not None:
        for due_ns, arrived in link.poll(next_ns):
            delays[arrived] = due_ns - arrived * interval_ns
    return _evaluate(link.stats, delays, bins)


def _evaluate(stats: LinkStats, delays: NDArray[np.int64], bins: int) -> Survey:
    gone = delays < 0
    arrived_ms = delays[~gone].astype(np.float64) * 1e-6
    edges = np.flatnonzero(np.diff(np.concatenate(([False], gone, [False])).astype(np.int8)))
    bursts = edges[1::2] - edges[::2]
    varies = len(arrived_ms) > 0 and bool(np.ptp(arrived_ms) > 0)
    counts, limits = np.histogram(arrived_ms, bins=bins) if varies else (np.zeros(0), np.zeros(0))
    return Survey(
        stats=stats,
        delays_ms=np.where(gone, np.nan, delays * 1e-6),
        delay_correlation=lag_1_correlation(arrived_ms),
        longest_loss=int(bursts.max(initial=0)),
        mean_loss_burst=float(bursts.mean()) if len(bursts) else None,
        edges_ms=limits.tolist(),
        counts=counts.astype(int).tolist(),
    )


def lag_1_correlation(series: NDArray[np.float64]) -> float | None:
    """Pearson's correlation of successive values; None for a constant or a short series."""
    if len(series) < 3 or np.ptp(series[1:]) == 0 or np.ptp(series[:-1]) == 0:
        return None
    return float(np.corrcoef(series[:-1], series[1:])[0, 1])
