"""What a designer would know of a link: the delays that a law is tuned for."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from netem import LinkProfile


class Delays(NamedTuple):
    """Of the link that a law is tuned for."""

    one_way_s: float
    """The mean of both ways."""
    round_trip_bound_s: float
    """Hardly ever exceeded; of a recorded link, whose outages nobody tunes for, a tenth of the time each way."""


_RECORDED = (0.5, 0.9)
"""What of a recorded delay is typical, and what its bound: quantiles over time."""


def delays(up: LinkProfile, down: LinkProfile, path_s: float = 0.0) -> Delays:
    """What a designer would know of the link: its delays, and the jitter's tail. `path_s`: round trip below it."""
    typical, bound = np.sum([_one_way_s(profile) for profile in (up, down)], axis=0).tolist()
    return Delays((typical + path_s) / 2.0, bound + path_s)


def _one_way_s(profile: LinkProfile) -> tuple[float, float]:
    """Typical delay and its bound [s]."""
    delay, jitter = profile.delay_ns * 1e-9, profile.jitter_ns * 1e-9
    recorded = [0.0, 0.0]
    if profile.trace is not None:
        times = profile.trace.times_ns
        recorded = [_wait_s(np.diff(times, prepend=0) * 1e-9, share) for share in _RECORDED]
    if profile.csv is not None:
        held = np.diff(profile.csv.times_ns, append=profile.csv.period_ns)
        recorded = [
            r + _quantile(profile.csv.delays_ns, held, share) * 1e-9
            for r, share in zip(recorded, _RECORDED, strict=True)
        ]
    resends = 0.0 if profile.resend is None else profile.resend.times * profile.resend.after_ns * 1e-9
    tail = jitter * (1.0 if profile.distribution == "uniform" else 3.0)
    return delay + recorded[0], delay + recorded[1] + tail + resends


def _wait_s(gaps: ArrayLike, share: float) -> float:
    """How long one waits at most, this share of the time, for the next of events that are `gaps` apart [s].

    One waits longer than w for the fraction sum max(0, gap - w) / sum gap of all time.
    """
    longest = -np.sort(-np.asarray(gaps, dtype=float))
    together = np.cumsum(longest)
    beyond = (1.0 - share) * together[-1]
    count = np.searchsorted(together - np.arange(1, len(longest) + 1) * longest, beyond, side="right")
    return float((together[count - 1] - beyond) / count)


def _quantile(values: ArrayLike, weights: ArrayLike, share: float) -> float:
    """The least value that this share of the weight does not exceed."""
    values, weights = np.asarray(values, dtype=float), np.asarray(weights, dtype=float)
    order = np.argsort(values)
    reached = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(reached, share * reached[-1])])
