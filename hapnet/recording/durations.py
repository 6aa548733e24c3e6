"""The duration of each sample of a recording, and means and quantiles over time.

A servo that stalls makes no samples, and a world's steps vary in length, so a mean over samples would leave out
stalls. Here each sample counts for the time until the next sample, as a held force does. A gap counts in full for the
sample before it: it is time of the run. Only a pause does not count: nothing moves and nothing is recorded in it. The
last sample counts for the median duration.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array
from hapnet.recording.samples import Columns

EVEN = 1e-6
"""Steps are even if they differ by less than this share of their median."""


def durations_s(columns: Columns, cuts: Iterable[tuple[int, int]] = ()) -> Array:
    """The duration of each of these samples (N,) [s]; of several samples at the same time only the last has one.

    cuts : begin and end [ns] of intervals that do not count, such as pauses (`hapnet.recording.hand.left_out`).
    """
    times = np.asarray(columns["time_s"], dtype=float)
    if len(times) < 2:
        return np.ones(len(times))
    steps = np.maximum(np.diff(times), 0.0)
    for begin_ns, end_ns in cuts:
        since, until = columns["time_ns"][:-1], columns["time_ns"][1:]
        steps = steps - np.clip(np.minimum(until, end_ns) - np.maximum(since, begin_ns), 0, None) / 1e9
    return np.append(np.maximum(steps, 0.0), np.median(steps))


def rms(values: Array, durations: Array) -> float | None:
    """Root mean square over time of `values` (N,) with these durations [s]; None: the durations are zero."""
    return None if (square := mean(values**2, durations)) is None else float(np.sqrt(square))


def mean(values: Array, durations: Array) -> float | None:
    """Mean over time of `values` (N,); None: the durations are zero."""
    total = float(np.sum(durations))
    return float(np.sum(values * durations)) / total if total > 0.0 else None


def quantile(values: Array, durations: Array, share: float) -> float | None:
    """The value that is not exceeded for this share of the time, linear between values; None as for `mean`.

    With equal durations it is numpy's quantile.
    """
    standing = durations > 0.0
    if not standing.any():
        return None
    order = np.argsort(values[standing], kind="stable")
    ordered, weights = values[standing][order], durations[standing][order]
    middles = np.cumsum(weights) - 0.5 * weights
    return float(np.interp(middles[0] + share * (middles[-1] - middles[0]), middles, ordered))


def is_even(times: Array) -> bool:
    """Whether these times are evenly spaced."""
    steps = np.diff(times)
    return not len(steps) or bool(np.ptp(steps) <= EVEN * np.median(steps))


def evenly(columns: Columns, names: Iterable[str]) -> Columns:
    """These series on an even grid of the median step: positions are interpolated linearly, all other values are held.
    An even recording is returned unchanged."""
    times = columns["time_s"]
    if is_even(times):
        return columns
    step_s = float(np.median(np.diff(times)))
    at = times[0] + step_s * np.arange(int((times[-1] - times[0]) / step_s) + 1)
    held: NDArray[np.intp] = np.searchsorted(times, at, side="right") - 1
    found: Columns = {"time_s": at}
    for name in names:
        values = columns[name]
        if name == "position_m":
            found[name] = np.column_stack([np.interp(at, times, axis) for axis in values.T])
        else:
            found[name] = values[held]
    return found
