"""What a wall feels like: how stiff, and how late."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array
from hapnet.plant.worlds.walls import Wall
from hapnet.recording.samples import Columns, Recording

_LEAST_S = 0.1  # of settled contact, for a slope
_AWAY_S = 0.1
"""A device that comes back into the wall later than that makes another visit [s]; sooner, it trembles."""
_MORE, _LEAST_N = 0.1, 0.1
"""A contact is felt when the force exceeds what was felt before by this share of it, and by this much [N]."""


def rendered_stiffness(recording: Recording, walls: Sequence[Wall], round_trip_s: float) -> float | None:
    """Slope of the resisting force over the device's penetration of the wall that it was deepest in [N/m].

    Least squares through the wall's surface: ``sum(F p) / sum(p^2)`` over the samples of settled contact. A visit has
    settled when the spring knows the wall: a round trip of the link and two of the world's longest steps after the
    device has entered. Before that the force is that of free space, and so is its slope; a free intercept would read it
    from there, and from the damper's force on the way in and out. None where there is less than 0.1 s of settled
    contact: no wall, too short a visit.
    """
    device, world = recording.device, recording.world
    found = _deepest(device, walls)
    if device is None or world is None or found is None:
        return None
    depth, resistance = found
    settled = _settled(device, depth, round_trip_s + 2.0 * float(world["step_s"].max()))
    if np.count_nonzero(settled) * _period_s(device) < _LEAST_S:
        return None
    p = depth[settled]
    return float(resistance[settled] @ p / (p @ p))


def first_felt_s(recording: Recording, walls: Sequence[Wall], round_trip_s: float) -> float | None:
    """How much longer than a round trip after the device's first crossing of the surface its contact is felt [s].

    Felt: the force along the wall's normal, outwards, exceeds by 10 % and by 0.1 N the strongest one before word of the
    crossing could have come back, which is drag and goes on to grow until then. It must come within the visit, or a
    round trip after; what drag does later is no contact. Of several walls the one counts that the device was deepest
    in. None: never entered, or not felt.
    """
    device = recording.device
    found = _deepest(device, walls)
    if device is None or found is None:
        return None
    depth, resistance = found
    inside = np.flatnonzero(depth > 0.0)
    if inside[0] == 0:
        return None
    times = device["time_s"]
    gone = np.flatnonzero(np.diff(times[inside]) > _AWAY_S)
    leaving_s = times[inside[gone[0]] if len(gone) else inside[-1]]
    told_s = times[inside[0]] + round_trip_s
    told, end = np.searchsorted(times, [told_s, leaving_s + round_trip_s])
    before = max(float(resistance[:told].max()), 0.0)
    felt = np.flatnonzero(resistance[told:end] > before + max(_MORE * before, _LEAST_N))
    return float(times[told + felt[0]] - told_s) if len(felt) else None


def pressed_wall(device: Columns | None, walls: Sequence[Wall]) -> Wall | None:
    """The wall that the device was deepest in, over all its samples; None if it never was in one."""
    if device is None or not walls:
        return None
    depths = [float(np.maximum(_depth(device, wall), 0.0).sum()) for wall in walls]
    return walls[int(np.argmax(depths))] if max(depths) > 0.0 else None


def _deepest(device: Columns | None, walls: Sequence[Wall]) -> tuple[Array, Array] | None:
    """Of `pressed_wall`: the device's penetration [m] and the force on it, outwards along the normal [N]."""
    wall = pressed_wall(device, walls)
    if device is None or wall is None:
        return None
    return _depth(device, wall), -np.asarray(device["force_N"] @ np.array(wall.normal))


def _depth(device: Columns, wall: Wall) -> Array:
    return np.asarray(device["position_m"] @ np.array(wall.normal) - wall.offset)


def _settled(device: Columns, depth: Array, after_s: float) -> NDArray[np.bool_]:
    """Samples in the wall whose visit began more than `after_s` before."""
    times, inside = device["time_s"], depth > 0.0
    outside_last = np.maximum.accumulate(np.where(inside, -np.inf, times))
    return np.asarray(inside & (times - outside_last > after_s) & np.isfinite(outside_last))


def _period_s(device: Columns) -> float:
    times = device["time_s"]
    return float(times[-1] - times[0]) / max(len(times) - 1, 1)
