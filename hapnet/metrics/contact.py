"""How stiff a wall feels, and how hard it pushes. What is said of walls holds for solids too (`obstacles`)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hapnet.checks import Array
from hapnet.metrics.obstacles import Obstacle
from hapnet.metrics.windows import Mask, tenths
from hapnet.recording.samples import Columns, Recording

_LEAST_S = 0.1  # shortest settled contact for which a slope is computed


def rendered_stiffness(recording: Recording, walls: Sequence[Obstacle], round_trip_s: float) -> float | None:
    """Slope of the resisting force over the device's penetration of the wall where it was deepest [N/m].

    It is the least-squares slope through the wall's surface, ``sum(F p) / sum(p^2)`` over the samples of settled
    contact. A visit has settled when the wall acts on the device's spring: a round trip of the link plus two of the
    world's longest steps after the device entered. Before that the force is that of free space. A slope with a free
    intercept would depend on those samples, and on the damper's force during entry and exit. None with less than 0.1 s
    of settled contact: there is no wall, or the visits are too short.
    """
    settled = _settled_contact(recording, walls, round_trip_s)
    if settled is None:
        return None
    p, resistance = settled
    return float(resistance @ p / (p @ p))


def contact_force(recording: Recording, walls: Sequence[Obstacle], round_trip_s: float) -> float | None:
    """Median of the resisting force in settled contact [N], as `rendered_stiffness` says; None as it says."""
    settled = _settled_contact(recording, walls, round_trip_s)
    return None if settled is None else float(np.median(settled[1]))


def rendered_by_tenths(recording: Recording, wanted: Array, round_trip_s: float, lasts_s: float) -> list[float]:
    """The share of the true environment's stiffness that is rendered in each tenth of a run with settled contact.

    It is ``sum(F . W) / sum(W . W)`` over settled contact, with F the force on the device and W = `wanted` (N, n) that
    of the true environment [N] (`environment_force`): for a wall the slope of `rendered_stiffness` over the stiffness
    of springs and wall in series. Contact is where W is not zero, settled and at least 0.1 s long in a tenth as
    `rendered_stiffness` says. If no tenth has that, as with taps shorter than a round trip, all contact counts.
    """
    device, world = recording.device, recording.world
    if device is None or world is None:
        return []
    inside = (wanted != 0.0).any(axis=1)
    settled = _settled(device, inside, round_trip_s + 2.0 * float(world["step_s"].max()))
    parts = tenths(device["time_s"], lasts_s)
    for contact in (settled, inside):
        chosen = [contact & part for part in parts]
        long = [one for one in chosen if np.count_nonzero(one) * _period_s(device) >= _LEAST_S]
        if long:
            return [float(np.sum(device["force_N"][one] * wanted[one]) / np.sum(wanted[one] ** 2)) for one in long]
    return []


def pressed_wall(device: Columns | None, walls: Sequence[Obstacle]) -> Obstacle | None:
    """The wall or solid where the device's depth, summed over all samples, is greatest; None: it entered none."""
    if device is None or not walls:
        return None
    depths = [float(np.maximum(wall.depths(device["position_m"]), 0.0).sum()) for wall in walls]
    return walls[int(np.argmax(depths))] if max(depths) > 0.0 else None


def depth_and_resistance(device: Columns | None, walls: Sequence[Obstacle]) -> tuple[Array, Array] | None:
    """The device's penetration of `pressed_wall` [m], and the outward force on the device along its normal [N]."""
    wall = pressed_wall(device, walls)
    if device is None or wall is None:
        return None
    positions = device["position_m"]
    return wall.depths(positions), -np.einsum("ij,ij->i", device["force_N"], wall.normals(positions))


def _settled_contact(
    recording: Recording, walls: Sequence[Obstacle], round_trip_s: float
) -> tuple[Array, Array] | None:
    """Depth [m] and resisting force [N] in the samples of settled contact; None with less than 0.1 s of them."""
    device, world = recording.device, recording.world
    found = depth_and_resistance(device, walls)
    if device is None or world is None or found is None:
        return None
    depth, resistance = found
    settled = _settled(device, depth > 0.0, round_trip_s + 2.0 * float(world["step_s"].max()))
    if np.count_nonzero(settled) * _period_s(device) < _LEAST_S:
        return None
    return depth[settled], resistance[settled]


def _settled(device: Columns, inside: Mask, after_s: float) -> Mask:
    """Samples in the wall whose visit began more than `after_s` earlier."""
    times = device["time_s"]
    outside_last = np.maximum.accumulate(np.where(inside, -np.inf, times))
    return np.asarray(inside & (times - outside_last > after_s) & np.isfinite(outside_last))


def _period_s(device: Columns) -> float:
    times = device["time_s"]
    return float(times[-1] - times[0]) / max(len(times) - 1, 1)
