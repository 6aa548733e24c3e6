"""Metrics of walls and solids: how stiff they feel, how hard they push, and how late a contact is felt."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hapnet.checks import Array
from hapnet.couplings.registry import ideal_stiffness
from hapnet.ext.metrics.measured import Mask, Measured, metric, scaled, tenths
from hapnet.ext.metrics.obstacles import WallOrSolid
from hapnet.recording.durations import durations_s, quantile
from hapnet.recording.samples import Columns, Recording

_SETTLED_S = 0.1  # shortest settled contact for which a slope is computed
_AWAY_S = 0.1
"""A return into the wall counts as a new touch after this time outside [s]; a quicker return is a tremble."""
_BEFORE_S = 0.1
_MORE, _MIN_N = 0.1, 0.1
"""A contact is felt when the force exceeds the force of the last 100 ms by this share of it and by this amount [N]:
people notice about a tenth (Weber's fraction of force)."""

_LASTING_S = 0.15
"""The average force over this time must exceed it too [s], as an oscillation at 4 Hz or more is not felt as a wall."""


@metric("rendered stiffness", "%", "nearer 100", over="time in settled contact")
def stiffness_percent(run: Measured) -> float | None:
    """Least-squares slope of the resisting force over the device's penetration, through the wall's surface, after a
    visit has settled (a round trip and two of the world's longest steps after it began), in % of the stiffness of
    the given springs and the wall in series: two springs for pspm, zoh, popc and eba, only device.stiffness for the
    others. A law whose rule softens its spring has a lower value."""
    if run.walls is None or run.delay_s is None:
        return None
    wall = pressed_wall(run.device, run.walls)
    rendered = rendered_stiffness(run.recording, run.walls, run.delay_s)
    if wall is None or not run.scalar or rendered is None:
        return None
    return 100.0 * rendered / ideal_stiffness(run.params, wall.stiffness)


@metric("felt stiffness", "N/m", "higher", over="time in settled contact")
def felt_N_per_m(run: Measured) -> float | None:
    """The rendered stiffness itself: the slope of the resisting force over the penetration in settled contact. No wall
    can be felt stiffer than it is, nor stiffer than the device renders without a network."""
    if run.walls is None or run.delay_s is None or pressed_wall(run.device, run.walls) is None:
        return None
    return rendered_stiffness(run.recording, run.walls, run.delay_s)


@metric("stiffness, worst tenth", "%", "nearer 100", over="time in settled contact of a tenth of the run")
def stiffness_worst_percent(run: Measured) -> float | None:
    """The rendered stiffness in each tenth of the run, in % of the stiffness of the springs and the wall in series; of
    the tenths with 0.1 s of settled contact the value farthest from 100. If no tenth has 0.1 s, as with taps shorter
    than a round trip, all contact counts. Walls may move."""
    if run.wanted is None or not run.scalar or run.delay_s is None:
        return None
    shares = rendered_by_tenths(run.recording, run.wanted, run.delay_s, run.params.duration_s)
    return 100.0 * max(shares, key=lambda share: abs(share - 1.0)) if shares else None


@metric("first felt contact", "ms", "lower", missed="first_contact_missed", over="the first contact")
def first_contact_ms(run: Measured) -> float | None:
    """Time from the device's first crossing of the wall's surface until the contact is felt, less the median delays of
    both links; below 0: felt before an answer could arrive. Felt: the resisting force exceeds, by 10 % and by 0.1 N,
    the largest force of the 100 ms before the crossing, also on average over the next 150 ms, unlike an oscillation."""
    return None if (found := run.once(_latency)) is None else _finite_ms(found.first_s)


@metric("first contact missed", "", "lower", over="the first contact")
def first_contact_missed(run: Measured) -> float | None:
    """1: the first contact was not felt until a round trip after the device left. 0: it was. None: no wall was
    entered deep enough for an ideal local spring to reach 0.1 N."""
    found = run.once(_latency)
    return None if found is None or found.first_s is None else float(math.isinf(found.first_s))


@metric("later contacts", "ms", "lower", missed="later_contacts_missed", over="contacts after the first")
def later_contact_ms(run: Measured) -> float | None:
    """Median over all contacts after the first of the time until they are felt, from the time at which an ideal local
    spring would reach 0.1 N. A contact that is not felt counts as infinite."""
    return None if (found := run.once(_latency)) is None else _finite_ms(found.later_s)


@metric("later contacts", "", "higher", over="the whole run")
def later_contacts(run: Measured) -> float | None:
    """Number of contacts after the first."""
    return None if (found := run.once(_latency)) is None else float(found.touches)


@metric("later contacts missed", "", "lower", over="contacts after the first")
def later_contacts_missed(run: Measured) -> float | None:
    """Number of contacts after the first that were not felt."""
    return None if (found := run.once(_latency)) is None else float(found.touches - found.felt)


def _latency(run: Measured) -> Latency | None:
    walls, delay_s = run.walls, run.delay_s
    wall = None if walls is None else pressed_wall(run.device, walls)
    if delay_s is None or walls is None or not (wall is None or run.scalar):
        return None
    stiffness = 0.0 if wall is None else ideal_stiffness(run.params, wall.stiffness)
    return latency(touches(run.recording, walls, stiffness, delay_s), delay_s)


def _finite_ms(seconds: float | None) -> float | None:
    return None if seconds is None or math.isinf(seconds) else scaled(seconds, 1e3)


def rendered_stiffness(recording: Recording, walls: Sequence[WallOrSolid], round_trip_s: float) -> float | None:
    """Slope of the resisting force over the device's penetration of the wall in which it was deepest [N/m].

    This is the least-squares slope through the wall's surface, ``sum(F p) / sum(p^2)`` over the time of settled
    contact. A visit has settled when the wall acts on the device's spring: a round trip of the link plus two of the
    world's longest steps after the device entered. Before that the force is the force of free space. A slope with a
    free intercept would depend on those samples, and on the damper's force during entry and exit. None with less than
    0.1 s of settled contact: there is no wall, or the visits are too short.
    """
    settled = _settled_contact(recording, walls, round_trip_s)
    if settled is None:
        return None
    p, resistance, lasting = settled
    return float(np.sum(resistance * p * lasting) / np.sum(p * p * lasting))


def contact_force(recording: Recording, walls: Sequence[WallOrSolid], round_trip_s: float) -> float | None:
    """Median of the resisting force in settled contact [N]; settled, and None, as in `rendered_stiffness`."""
    settled = _settled_contact(recording, walls, round_trip_s)
    return None if settled is None else quantile(settled[1], settled[2], 0.5)


def rendered_by_tenths(recording: Recording, wanted: Array, round_trip_s: float, lasts_s: float) -> list[float]:
    """The share of the true environment's stiffness that is rendered in each tenth of a run with settled contact.

    This is ``sum(F . W) / sum(W . W)`` over the time of settled contact, with F the force on the device and W =
    `wanted` (N, n) the force of the true environment [N] (`environment_force`): for a wall the slope of
    `rendered_stiffness` over the stiffness of springs and wall in series. In contact W is not zero; contact must be
    settled, and at least 0.1 s long in a tenth (`rendered_stiffness`). If no tenth has 0.1 s, all contact counts.
    """
    device, world = recording.device, recording.world
    if device is None or world is None:
        return []
    inside = (wanted != 0.0).any(axis=1)
    settled = _settled(device, inside, round_trip_s + 2.0 * float(world["step_s"].max()))
    parts, lasting = tenths(device["time_s"], lasts_s), durations_s(device)
    work, square = (np.sum(force * wanted, axis=1) * lasting for force in (device["force_N"], wanted))
    for contact in (settled, inside):
        chosen = [contact & part for part in parts]
        long = [samples for samples in chosen if _is_long(lasting[samples])]
        if long:
            return [float(work[samples].sum() / square[samples].sum()) for samples in long]
    return []


def pressed_wall(device: Columns | None, walls: Sequence[WallOrSolid]) -> WallOrSolid | None:
    """The wall or solid in which the device's depth, summed over time, is largest; None: it entered none."""
    if device is None or not walls:
        return None
    lasting = durations_s(device)
    depths = [float(np.maximum(wall.depths(device["position_m"]), 0.0) @ lasting) for wall in walls]
    return walls[int(np.argmax(depths))] if max(depths) > 0.0 else None


def depth_and_resistance(device: Columns | None, walls: Sequence[WallOrSolid]) -> tuple[Array, Array] | None:
    """The device's penetration of `pressed_wall` [m], and the outward force on the device along its normal [N]."""
    wall = pressed_wall(device, walls)
    if device is None or wall is None:
        return None
    positions = device["position_m"]
    return wall.depths(positions), -np.einsum("ij,ij->i", device["force_N"], wall.normals(positions))


def _settled_contact(
    recording: Recording, walls: Sequence[WallOrSolid], round_trip_s: float
) -> tuple[Array, Array, Array] | None:
    """Depth [m], resisting force [N] and duration [s] of the samples of settled contact; None with less than 0.1 s."""
    device, world = recording.device, recording.world
    found = depth_and_resistance(device, walls)
    if device is None or world is None or found is None:
        return None
    depth, resistance = found
    settled = _settled(device, depth > 0.0, round_trip_s + 2.0 * float(world["step_s"].max()))
    lasting = durations_s(device)[settled]
    return (depth[settled], resistance[settled], lasting) if _is_long(lasting) else None


def _settled(device: Columns, inside: Mask, after_s: float) -> Mask:
    """True for samples in the wall, in visits that began more than `after_s` earlier."""
    times = device["time_s"]
    outside_last = np.maximum.accumulate(np.where(inside, -np.inf, times))
    return np.asarray(inside & (times - outside_last > after_s) & np.isfinite(outside_last))


def _is_long(lasting: Array) -> bool:
    """Whether these samples last long enough for a slope [s]."""
    return float(lasting.sum()) >= _SETTLED_S * (1.0 - 1e-9)


class WallContact(NamedTuple):
    """A visit to a wall; times since the recording's origin [s].

    entered_s : when the device crossed the surface. ideal_s : when a local spring without delay would reach 0.1 N.
    felt_s : when the contact was felt; None: it was not felt.
    """

    entered_s: float
    ideal_s: float
    felt_s: float | None


def touches(
    recording: Recording, walls: Sequence[WallOrSolid], stiffness: float, round_trip_s: float
) -> list[WallContact]:
    """Every touch of the wall that was pressed most, in order of time.

    A contact is felt when the outward force along the wall's normal exceeds, by 10 % and by 0.1 N, the largest force
    of the 100 ms before the device crossed the surface, and does so on average over the next 150 ms. The search ends a
    round trip after the device left, or when it enters again. A visit too shallow for an ideal local spring of
    `stiffness` [N/m] to reach 0.1 N is no touch, and neither is a visit that began before the first sample. Empty: no
    wall was entered.
    """
    device = recording.device
    found = depth_and_resistance(device, walls)
    if device is None or found is None:
        return []
    depth, resistance = found
    times = device["time_s"]
    inside = np.flatnonzero(depth > 0.0)
    after_gap = np.flatnonzero(
        (np.diff(times[inside]) > _AWAY_S) & (np.diff(inside) > 1)
    )  # a gap without samples does not show that it left
    first, last = inside[np.r_[0, after_gap + 1]], inside[np.r_[after_gap, len(inside) - 1]]
    ends_s = np.minimum(times[last] + round_trip_s, np.r_[times[first[1:]], np.inf])
    lasting = durations_s(device)
    total, age = np.r_[0.0, np.cumsum(resistance * lasting)], np.r_[0.0, np.cumsum(lasting)]
    result = []
    for enter, leave, end_s in zip(first, last, ends_s, strict=True):
        stiff = enter + np.flatnonzero(stiffness * depth[enter : leave + 1] >= _MIN_N)
        if enter == 0 or not len(stiff):
            continue
        since = min(int(np.searchsorted(times, times[enter] - _BEFORE_S)), enter - 1)
        before = max(float(resistance[since:enter].max()), 0.0)
        end = np.searchsorted(times, end_s)
        felt = enter + np.flatnonzero(resistance[enter:end] > (level := before + max(_MORE * before, _MIN_N)))
        until = np.searchsorted(times, times[felt] + _LASTING_S)
        felt = felt[total[until] - total[felt] > level * (age[until] - age[felt])]
        felt_s = float(times[felt[0]]) if len(felt) else None
        result.append(WallContact(float(times[enter]), float(times[stiff[0]]), felt_s))
    return result


class Latency(NamedTuple):
    """The delay until contacts were felt [s]: infinite for a contact that was not felt, None without any touch.

    first_s : of the first touch, beyond the median round trip. later_s : median of the later ones, beyond the time of
        an ideal local spring. touches, felt : the number of later touches, and of felt ones among them.
    """

    first_s: float | None
    later_s: float | None
    touches: int
    felt: int


def latency(found: Sequence[WallContact], round_trip_s: float) -> Latency:
    """The delays until these touches were felt."""
    late = [
        np.inf if touch.felt_s is None else touch.felt_s - since_s
        for k, touch in enumerate(found)
        for since_s in [touch.ideal_s if k else touch.entered_s + round_trip_s]
    ]
    later = sorted(late[1:])
    middle = len(later) // 2
    median = None if not later else later[middle] if len(later) % 2 else 0.5 * (later[middle - 1] + later[middle])
    return Latency(late[0] if late else None, median, len(later), sum(np.isfinite(later).tolist()))
