"""The margin of both ports together, from the recordings of both sides."""

from __future__ import annotations

import math

import numpy as np

from hapnet.recording.samples import Columns, Recording


def total_margin(recording: Recording) -> Columns | None:
    """The sum of both sides' margins over time: ``time_s`` and ``margin_J`` at every sample of either side.

    The other side contributes its last sample up to that time. So energy that went in and out again between two samples
    does not show. The sum covers the time in which both sides are recorded. None if they are not on one clock: a
    difference of clocks that was only measured may be wrong by milliwatts times milliseconds, and proves nothing.
    """
    device, world = recording.device, recording.world
    meta = recording.meta
    if device is None or world is None or not meta.get("aligned", True) or "clock_difference" in meta:
        return None
    of_device, of_world = device["time_s"], world["time_s"]
    times = np.union1d(of_device, of_world)
    times = times[(times >= max(of_device[0], of_world[0])) & (times <= min(of_device[-1], of_world[-1]))]
    if not len(times):
        return None
    halves = [side["margin_J"][np.searchsorted(side["time_s"], times, side="right") - 1] for side in (device, world)]
    return {"time_s": times, "margin_J": halves[0] + halves[1]}


def least_total_margin(recording: Recording, since_s: float = -math.inf) -> float | None:
    """The least value of `total_margin` from `since_s` on [J]; None if it is unknown."""
    total = total_margin(recording)
    margin = np.array([]) if total is None else total["margin_J"][total["time_s"] >= since_s]
    known = margin[np.isfinite(margin)]
    return float(known.min()) if len(known) else None
