"""Send a stream of messages through a link in virtual time, and evaluate losses and delays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from netem.expectation import expect
from netem.link import Link
from netem.profile import LinkProfile
from netem.stats import LinkStats

_REPORT_EVERY = 10_000


@dataclass(frozen=True, slots=True)
class Survey:
    """The link's `stats`, and the delays of the messages in the order in which they were sent.

    `delays_ms` has one value per message sent, its copies left out, NaN if it did not arrive. `counts` is their
    histogram over the bins between `edges_ms`. A burst of losses is a run of messages that did not arrive, for any
    reason.
    """

    stats: LinkStats
    delays_ms: NDArray[np.float64]
    delay_correlation: float | None
    max_loss: int
    mean_loss_burst: float | None
    edges_ms: list[float]
    counts: list[int]

    def as_dict(self) -> dict[str, object]:
        """All fields except `delays_ms` by name, as in JSON; the link's counters come first."""
        names = [field.name for field in fields(self) if field.name not in ("stats", "delays_ms")]
        return self.stats.as_dict() | {name: getattr(self, name) for name in names}


def run(
    profile: LinkProfile,
    seed: int,
    count: int,
    interval_ns: int,
    size: int,
    bins: int = 20,
    *,
    progress: Callable[[float], None] | None = None,
) -> Survey:
    """Send `count` messages of `size` bytes, one every `interval_ns`, and wait for all that arrive.

    The messages are plain numbers, so a corrupted one is only counted. `progress` is called from time to time with the
    share sent, 0 to 1.
    """
    link: Link[int] = Link(profile, seed, flip=lambda number, _: number)
    delays = np.full(count, -1, dtype=np.int64)
    for number in range(count):
        if progress is not None and number % _REPORT_EVERY == 0:
            progress(number / count)
        link.send(number * interval_ns, number, size)
        _note(link.poll(number * interval_ns), delays, interval_ns)
    while (next_ns := link.next_due_ns) is not None:
        _note(link.poll(next_ns), delays, interval_ns)
    return _evaluate(link.stats, delays, bins)


def _note(arrived: list[tuple[int, int]], delays: NDArray[np.int64], interval_ns: int) -> None:
    """The first arrival counts if a message arrives twice."""
    for due_ns, number in arrived:
        if delays[number] < 0:
            delays[number] = due_ns - number * interval_ns


def _evaluate(stats: LinkStats, delays: NDArray[np.int64], bins: int) -> Survey:
    lost = delays < 0
    arrived_ms = delays[~lost].astype(np.float64) * 1e-6
    edges = np.flatnonzero(np.diff(np.concatenate(([False], lost, [False])).astype(np.int8)))
    bursts = edges[1::2] - edges[::2]
    varies = len(arrived_ms) > 0 and bool(np.ptp(arrived_ms) > 0)
    counts, limits = np.histogram(arrived_ms, bins=bins) if varies else (np.zeros(0), np.zeros(0))
    return Survey(
        stats=stats,
        delays_ms=np.where(lost, np.nan, delays * 1e-6),
        delay_correlation=lag_1_correlation(arrived_ms),
        max_loss=int(bursts.max(initial=0)),
        mean_loss_burst=float(bursts.mean()) if len(bursts) else None,
        edges_ms=limits.tolist(),
        counts=counts.astype(int).tolist(),
    )


def lines(profile: LinkProfile, result: Survey) -> list[str]:
    """A survey for people: the expected and the achieved figures, and the histogram of delays."""
    stats, expected = result.stats, expect(profile)
    out: list[str] = []
    out.append(f"profile    {stats.profile or '(nothing)'}")
    out.append(f"offered    {stats.offered}")
    share = 100.0 / stats.offered
    out.append(f"delivered  {stats.delivered} ({stats.delivered * share:.2f} %)")
    burst = "" if result.mean_loss_burst is None else f", bursts of {result.mean_loss_burst:.2f} on average"
    out.append(
        f"lost       {stats.lost} ({stats.lost * share:.2f} %, expected {100 * expected.loss:.2f} %){burst}, "
        f"longest {result.max_loss}"
    )
    if profile.resend is not None:
        out.append(f"resent     {stats.resent} times, recovered {stats.recovered} ({stats.recovered * share:.2f} %)")
    if profile.corrupt:
        expectation = f"expected {100 * expected.corrupted:.2f} %"
        out.append(f"corrupted  {stats.corrupted} ({stats.corrupted * share:.2f} % of the offered, {expectation})")
    if stats.duplicated:
        expectation = f"expected {100 * expected.duplicated:.2f} %"
        out.append(f"duplicated {stats.duplicated} ({stats.duplicated * share:.2f} % of the offered, {expectation})")
    if stats.dropped_limit:
        over = f"over limit {profile.limit}" + (f" or {profile.limit_bytes} bytes" if profile.limit_bytes else "")
        out.append(f"dropped    {stats.dropped_limit} ({stats.dropped_limit * share:.2f} %): {over}")
    ahead = f", {stats.sent_ahead} sent ahead (expected {100 * expected.sent_ahead:.2f} %)" if profile.reorder else ""
    out.append(f"reordered  {stats.reordered} ({stats.reordered * share:.2f} %){ahead}")
    if stats.delivered:
        held = profile.resend is not None and profile.resend.ordered
        queued = held or bool(profile.rate_bit_s or profile.trace or profile.slot)
        out.append(
            f"delay      mean {stats.delay_mean_ms:.3f} ms, standard deviation {stats.delay_std_ms:.3f} ms, "
            f"p50 {stats.delay_p50_ms:.3f} ms, p99 {stats.delay_p99_ms:.3f} ms"
        )
        out.append(
            f"           expected {expected.delay_mean_ms:.3f} ms and {expected.delay_std_ms:.3f} ms"
            + (", without the delay that rate, trace, slot or ordered resends add" if queued else "")
        )
        out.append(f"           lag-1 correlation {result.delay_correlation or 0.0:.3f}")
    if len(result.edges_ms) > 2:
        most = max(result.counts)
        for low, number in zip(result.edges_ms, result.counts, strict=False):
            out.append(f"{low:10.3f} ms {'#' * round(50 * number / most):<50} {number}")
    return out


def lag_1_correlation(series: NDArray[np.float64]) -> float | None:
    """Pearson's correlation of successive values; None for a constant or too short series."""
    if len(series) < 3 or np.ptp(series[1:]) == 0 or np.ptp(series[:-1]) == 0:
        return None
    return float(np.corrcoef(series[:-1], series[1:])[0, 1])
