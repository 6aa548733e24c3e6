"""The link's delays that a law is tuned for: the values that a designer would know in advance."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from netem import LinkProfile
from netem.trace import CapacityTrace


class Delays(NamedTuple):
    """The delays of the link that a law is tuned for."""

    one_way_s: float
    """Typical delay, the mean of both directions."""
    round_trip_bound_s: float
    """Rarely exceeded bound. A recorded link exceeds it a tenth of the time in each direction: outages do not count."""


_RECORDED = (0.5, 0.9)
"""The quantiles over time that count as a recorded link's typical delay and as its bound."""


def delays(up: LinkProfile, down: LinkProfile, path_s: float = 0.0) -> Delays:
    """Delays of the emulated link, with its jitter's tail. `path_s`: round trip of the real network under it [s]."""
    typical, bound = np.sum([_one_way_s(profile) for profile in (up, down)], axis=0).tolist()
    return Delays((typical + path_s) / 2.0, bound + path_s)


@lru_cache
def _one_way_s(profile: LinkProfile) -> tuple[float, float]:
    """Typical delay and its bound [s]."""
    delay, jitter = profile.delay_ns * 1e-9, profile.jitter_ns * 1e-9
    recorded = [0.0, 0.0]
    if isinstance(profile.trace, CapacityTrace):  # a rate over time counts as a rate does: not at all
        times = profile.trace.times_ns
        gaps = np.diff(times, prepend=0) * 1e-9
        recorded = [_wait_s(gaps, share) for share in _RECORDED]
    if profile.csv is not None:
        held = np.diff(profile.csv.times_ns, append=profile.csv.period_ns)
        recorded = [
            r + _quantile(profile.csv.delays_ns, held, share) * 1e-9
            for r, share in zip(recorded, _RECORDED, strict=True)
        ]
    resends = 0.0 if profile.resend is None else profile.resend.times * profile.resend.after_ns * 1e-9
    tail = jitter * (1.0 if profile.distribution == "uniform" else 3.0)
    for _, mean_ns, spread_ns in [one.expected() for one in profile.others]:
        delay, tail = delay + mean_ns * 1e-9, tail + 3e-9 * spread_ns
    return delay + recorded[0], delay + recorded[1] + tail + resends


def _wait_s(gaps: ArrayLike, share: float) -> float:
    """Quantile `share` of the wait for the next event [s], from a random instant; the events are `gaps` apart [s].

    The wait exceeds w for the fraction sum max(0, gap - w) / sum gap of all time.
    """
    maximum = -np.sort(-np.asarray(gaps, dtype=float))
    together = np.cumsum(maximum)
    beyond = (1.0 - share) * together[-1]
    count = np.searchsorted(together - np.arange(1, len(maximum) + 1) * maximum, beyond, side="right")
    return float((together[count - 1] - beyond) / count)


def _quantile(values: ArrayLike, weights: ArrayLike, share: float) -> float:
    """The weighted quantile `share` of `values`."""
    values, weights = np.asarray(values, dtype=float), np.asarray(weights, dtype=float)
    order = np.argsort(values)
    reached = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(reached, share * reached[-1])])
