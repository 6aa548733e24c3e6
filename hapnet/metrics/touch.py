"""When a contact is felt: the time from the device's entering a wall until its force says so."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hapnet.metrics.contact import depth_and_resistance
from hapnet.metrics.obstacles import Obstacle
from hapnet.recording.samples import Recording

_AWAY_S = 0.1
"""A device that returns into the wall later than this makes a new touch [s]; earlier, it only trembles."""
_BEFORE_S = 0.1
_MORE, _LEAST_N = 0.1, 0.1
"""A contact is felt when the force exceeds that of the last 100 ms by this share of it and by this much [N]: people
notice about a tenth (Weber's fraction of force)."""


_LASTING_S = 0.15
"""And it must exceed that on average for so long [s]: a swing at 4 Hz or more is not felt as a wall."""


class Touch(NamedTuple):
    """One visit to a wall; times since the recording's origin [s].

    entered_s : when the device crossed the surface. ideal_s : when a local spring without delay would take 0.1 N.
    felt_s : when the contact was felt; None: it was not.
    """

    entered_s: float
    ideal_s: float
    felt_s: float | None


def touches(recording: Recording, walls: Sequence[Obstacle], stiffness: float, round_trip_s: float) -> list[Touch]:
    """Every touch of the wall that was pressed most, in the order of time.

    A contact is felt when the outward force along the wall's normal exceeds, by 10 % and by 0.1 N, the greatest force
    of the 100 ms before the device crossed the surface, and does so on average over the next 150 ms. That is looked for
    until a round trip after the device left, or until it enters again. A visit too shallow for an ideal local spring of
    `stiffness` [N/m] to take 0.1 N is no touch; nor is one that had begun before the first sample. Empty: no wall was
    entered.
    """
    device = recording.device
    found = depth_and_resistance(device, walls)
    if device is None or found is None:
        return []
    depth, resistance = found
    times = device["time_s"]
    inside = np.flatnonzero(depth > 0.0)
    gone = np.flatnonzero(np.diff(times[inside]) > _AWAY_S)
    first, last = inside[np.r_[0, gone + 1]], inside[np.r_[gone, len(inside) - 1]]
    ends_s = np.minimum(times[last] + round_trip_s, np.r_[times[first[1:]], np.inf])
    total = np.r_[0.0, np.cumsum(resistance)]
    result = []
    for enter, leave, end_s in zip(first, last, ends_s, strict=True):
        stiff = enter + np.flatnonzero(stiffness * depth[enter : leave + 1] >= _LEAST_N)
        if enter == 0 or not len(stiff):
            continue
        before = max(float(resistance[np.searchsorted(times, times[enter] - _BEFORE_S) : enter].max()), 0.0)
        end = np.searchsorted(times, end_s)
        felt = enter + np.flatnonzero(resistance[enter:end] > (level := before + max(_MORE * before, _LEAST_N)))
        until = np.searchsorted(times, times[felt] + _LASTING_S)
        felt = felt[total[until] - total[felt] > level * (until - felt)]
        felt_s = float(times[felt[0]]) if len(felt) else None
        result.append(Touch(float(times[enter]), float(times[stiff[0]]), felt_s))
    return result


class Latency(NamedTuple):
    """How late contacts were felt. Delays are [s], infinite for a contact that was not felt, None without any touch.

    first_s : of the first touch, beyond the median round trip. later_s : median of the later ones, beyond the time of
        an ideal local spring. touches, felt : how many later touches there were, and how many of them were felt.
    """

    first_s: float | None
    later_s: float | None
    touches: int
    felt: int


def latency(found: Sequence[Touch], round_trip_s: float) -> Latency:
    """How late these touches were felt."""
    late = [
        np.inf if touch.felt_s is None else touch.felt_s - since_s
        for k, touch in enumerate(found)
        for since_s in [touch.ideal_s if k else touch.entered_s + round_trip_s]
    ]
    later = sorted(late[1:])
    middle = len(later) // 2
    median = None if not later else later[middle] if len(later) % 2 else 0.5 * (later[middle - 1] + later[middle])
    return Latency(late[0] if late else None, median, len(later), sum(np.isfinite(later).tolist()))
