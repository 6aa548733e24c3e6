"""Position drift: how fast device and proxy move apart while both are in free space."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hapnet.checks import Array
from hapnet.metrics.contact import pressed_wall
from hapnet.metrics.obstacles import Obstacle, normal_where_deepest
from hapnet.recording.samples import Columns, Recording

_TRAVELS_S = (0.1, 0.2, 0.4)
"""The lag is modelled as a weighted sum of the device's displacements in these times [s]: zero while it rests."""
_RATE_HZ = 100.0
_LEAST_S, _LEAST_SPAN_S = 2.0, 5.0
_ROUNDS = 30


def drift(recording: Recording, walls: Sequence[Obstacle]) -> float | None:
    """Slope over time of device minus proxy while both are outside all `walls` [m/s].

    It is measured along the normal of the wall or solid where the device was deepest; without one, along the axis on
    which it moved most. The model is ``apart(t) = offset + slope t + sum_i w_i (x(t) - x(t - s_i))``. Its last terms
    are the lag, which is periodic if the motion is. It is fitted by least absolute deviations, so that an outage does
    not look like drift (a very long outage still does). None if the two sides are not on one clock, or if free motion
    lasts less than 2 s in all or less than 5 s from first to last sample.
    """
    device, world = recording.device, recording.world
    if device is None or world is None or not recording.meta.get("aligned", True):
        return None
    direction = _direction(device, pressed_wall(device, walls))
    path, seconds = device["position_m"] @ direction, device["time_s"]
    first, last = max(seconds[0], world["time_s"][0]), min(seconds[-1], world["time_s"][-1])
    times = np.arange(first, last, 1.0 / _RATE_HZ)
    x = np.interp(times, seconds, path)
    apart = x - np.interp(times, world["time_s"], world["position_m"] @ direction)
    travels = [x - np.interp(times - span, seconds, path) for span in _TRAVELS_S]
    outside = np.ones(len(times), dtype=bool)
    for wall in walls:
        outside &= np.interp(times, seconds, wall.depths(device["position_m"])) <= 0.0
    outside &= world["penetration_m"][np.searchsorted(world["time_s"], times, side="right") - 1] <= 0.0
    free_s = times[outside]
    if len(free_s) < _LEAST_S * _RATE_HZ or free_s[-1] - free_s[0] < _LEAST_SPAN_S:
        return None
    terms = np.column_stack([np.ones(len(times)), times, *travels])[outside]
    slope = float(_least_absolute(terms, apart[outside])[1])
    return slope if np.isfinite(slope) else None


def _direction(device: Columns, wall: Obstacle | None) -> Array:
    if wall is not None:
        return np.array(normal_where_deepest(wall, device["position_m"]))
    extent = np.ptp(device["position_m"], axis=0)
    return np.asarray(np.eye(len(extent))[int(np.argmax(extent))])


def _least_absolute(terms: Array, values: Array) -> Array:
    """The weights (m,) with which `terms` (N, m) best fit `values` (N,), by iteratively reweighted least squares."""
    found = np.linalg.lstsq(terms, values, rcond=None)[0]
    floor = 1e-6 * float(np.abs(values).max()) + 1e-12
    for _ in range(_ROUNDS):
        root = 1.0 / np.sqrt(np.maximum(np.abs(values - terms @ found), floor))
        found = np.linalg.lstsq(terms * root[:, None], values * root, rcond=None)[0]
    return np.asarray(found)
