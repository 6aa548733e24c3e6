"""For how long each sample of a recording stands, and means and quantiles over time.

A servo that stalls makes no samples, and a world's steps are as long as they take, so a mean over samples leaves out
what was not served. Here each sample counts for the time until the next one, as a held force does. A gap counts in
full, for the sample before it: it is time of the run. Only a pause is none, in which nothing moves and nothing is
recorded. The last sample counts for as long as the median one.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array
from hapnet.recording.samples import Columns

EVEN = 1e-6
"""Steps that differ by a smaller share of their median are even."""


def durations_s(columns: Columns, cuts: Iterable[tuple[int, int]] = ()) -> Array:
    """(N,) for how long each of these samples stands [s]; of samples at one time all but the last for no time.

    cuts : begin and end [ns] of what is no time of the run, such as pauses (`hapnet.recording.hand.left_out`).
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
    """Root mean square over time of `values` (N,), each of which stands for so long [s]; None: for no time."""
    return None if (square := mean(values**2, durations)) is None else float(np.sqrt(square))


def mean(values: Array, durations: Array) -> float | None:
    """Mean over time of `values` (N,); None: they stand for no time."""
    total = float(np.sum(durations))
    return float(np.sum(values * durations)) / total if total > 0.0 else None


def quantile(values: Array, durations: Array, share: float) -> float | None:
    """The value that is not exceeded for so large a share of the time, linear between values; None as `mean`.

    Where all stand equally long it is numpy's.
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
    """These series on an even grid of the median step: places between two samples lie on the line between them, all
    else is held. A recording that is even stays as it is."""
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
