"""How stiff a wall feels, and how late its contact is felt."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array
from hapnet.plant.worlds.walls import Wall
from hapnet.recording.samples import Columns, Recording

_LEAST_S = 0.1  # shortest settled contact for which a slope is computed
_AWAY_S = 0.1
"""A device that returns into the wall later than this makes a new visit [s]; earlier, it only trembles."""
_MORE, _LEAST_N = 0.1, 0.1
"""A contact is felt when the force exceeds the earlier force by this share of it and by this much [N]."""


def rendered_stiffness(recording: Recording, walls: Sequence[Wall], round_trip_s: float) -> float | None:
    """Slope of the resisting force over the device's penetration of the wall where it was deepest [N/m].

    It is the least-squares slope through the wall's surface, ``sum(F p) / sum(p^2)`` over the samples of settled
    contact. A visit has settled when the wall acts on the device's spring: a round trip of the link plus two of the
    world's longest steps after the device entered. Before that the force is that of free space. A slope with a free
    intercept would depend on those samples, and on the damper's force during entry and exit. None with less than 0.1 s
    of settled contact: there is no wall, or the visits are too short.
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
    """Time from the device's first crossing of the surface until its contact is felt, less a round trip [s].

    A contact is felt when the outward force along the wall's normal exceeds, by 10 % and by 0.1 N, the greatest force
    before the world's answer to the crossing could arrive. That earlier force is drag, which keeps growing until then.
    The contact must be felt during the visit or within a round trip after it; later forces are drag. With several
    walls, the one where the device was deepest counts. None: no wall was entered, or no contact was felt.
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
    answer_s = times[inside[0]] + round_trip_s
    answered, end = np.searchsorted(times, [answer_s, leaving_s + round_trip_s])
    before = max(float(resistance[:answered].max()), 0.0)
    felt = np.flatnonzero(resistance[answered:end] > before + max(_MORE * before, _LEAST_N))
    return float(times[answered + felt[0]] - answer_s) if len(felt) else None


def pressed_wall(device: Columns | None, walls: Sequence[Wall]) -> Wall | None:
    """The wall where the device's penetration, summed over all samples, is greatest; None if it entered no wall."""
    if device is None or not walls:
        return None
    depths = [float(np.maximum(_depth(device, wall), 0.0).sum()) for wall in walls]
    return walls[int(np.argmax(depths))] if max(depths) > 0.0 else None


def _deepest(device: Columns | None, walls: Sequence[Wall]) -> tuple[Array, Array] | None:
    """The device's penetration of `pressed_wall` [m], and the outward force on the device along its normal [N]."""
    wall = pressed_wall(device, walls)
    if device is None or wall is None:
        return None
    return _depth(device, wall), -np.asarray(device["force_N"] @ np.array(wall.normal))


def _depth(device: Columns, wall: Wall) -> Array:
    return np.asarray(device["position_m"] @ np.array(wall.normal) - wall.offset)


def _settled(device: Columns, depth: Array, after_s: float) -> NDArray[np.bool_]:
    """Samples in the wall whose visit began more than `after_s` earlier."""
    times, inside = device["time_s"], depth > 0.0
    outside_last = np.maximum.accumulate(np.where(inside, -np.inf, times))
    return np.asarray(inside & (times - outside_last > after_s) & np.isfinite(outside_last))


def _period_s(device: Columns) -> float:
    times = device["time_s"]
    return float(times[-1] - times[0]) / max(len(times) - 1, 1)
