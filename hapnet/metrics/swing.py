"""What the force still does when the hand holds still."""

from __future__ import annotations

import numpy as np

from hapnet.recording.samples import Recording

FROM_S, UNTIL_S = 1.0, 3.0
"""The swing is measured from this long to this long after the hand's reference has stopped [s]."""

LIMIT_CYCLE_N = 0.02
"""A swing below this [N] is no limit cycle: nobody feels it."""

_STILL_M = 1e-9


def residual_swing(recording: Recording) -> float | None:
    """Root mean square of the force without its mean, from 1 to 3 s after the hand's reference has stopped [N].

    All axes count together. A reference that rests from the start has stopped then. If it stops more than once for as
    long as that, the greatest counts. None if it never does, or if the recording has no reference.
    """
    return max((_swing(recording, stop, FROM_S, UNTIL_S) for stop in _stops(recording)), default=None)


def limit_cycles(recording: Recording, until_s: float = UNTIL_S) -> bool | None:
    """Does the force go on to swing after the hand has stopped?

    It does if the force without its mean is at least `LIMIT_CYCLE_N` (rms) in the last second before `until_s`, which
    counts from a stop, and not less than half of what it was from 1 to 2 s: what decays faster is the end of a
    transient. The longer, the slower may it decay. None without a stop of `until_s`.
    """
    found = None
    for stop in _stops(recording, until_s):
        before, after = (_swing(recording, stop, since, since + 1.0) for since in (FROM_S, until_s - 1.0))
        found = found or (after >= LIMIT_CYCLE_N and after >= 0.5 * before)
    return found


def _stops(recording: Recording, until_s: float = UNTIL_S) -> list[float]:
    """When the hand's reference came to rest for at least so long [s]."""
    device = recording.device
    if device is None or "operator_target_m" not in device:
        return []
    times, target = device["time_s"], device["operator_target_m"]
    moves = np.abs(np.diff(target, axis=0)).max(axis=1, initial=0.0)
    stops = np.flatnonzero(np.r_[True, ~(moves <= _STILL_M)])  # an unknown reference moves
    ends = np.r_[stops[1:], len(times)]
    rests = (times[ends - 1] - times[stops] >= until_s) & np.isfinite(target[stops]).all(axis=1)
    return [float(start) for start in times[stops[rests]]]


def _swing(recording: Recording, stop_s: float, since_s: float, until_s: float) -> float:
    assert recording.device is not None
    first, end = np.searchsorted(recording.device["time_s"], [stop_s + since_s, stop_s + until_s])
    force = recording.device["force_N"][first:end]
    return float(np.sqrt(np.mean(np.sum((force - force.mean(axis=0)) ** 2, axis=1))))
