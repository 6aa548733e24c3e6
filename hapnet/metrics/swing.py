"""What the force still does when the hand holds still."""

from __future__ import annotations

import numpy as np

from hapnet.recording.samples import Recording

FROM_S, UNTIL_S = 1.0, 3.0
"""The swing is measured from this long to this long after the hand's reference has stopped [s]."""

_STILL_M = 1e-9


def residual_swing(recording: Recording) -> float | None:
    """Root mean square of the force without its mean, from 1 to 3 s after the hand's reference has stopped [N].

    All axes count together. A reference that rests from the start has stopped then. If it stops more than once for as
    long as that, the greatest counts. None if it never does, or if the recording has no reference.
    """
    device = recording.device
    if device is None or "operator_target_m" not in device:
        return None
    times, target = device["time_s"], device["operator_target_m"]
    moves = np.abs(np.diff(target, axis=0)).max(axis=1, initial=0.0)
    stops = np.flatnonzero(np.r_[True, ~(moves <= _STILL_M)])  # an unknown reference moves
    found = []
    for first, end in zip(stops, np.r_[stops[1:], len(times)], strict=True):
        if times[end - 1] - times[first] < UNTIL_S or not np.isfinite(target[first]).all():
            continue
        window = slice(*np.searchsorted(times, [times[first] + FROM_S, times[first] + UNTIL_S]))
        force = device["force_N"][window]
        found.append(float(np.sqrt(np.mean(np.sum((force - force.mean(axis=0)) ** 2, axis=1)))))
    return max(found, default=None)
