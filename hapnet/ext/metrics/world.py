"""Metrics of the proxy's contact in the virtual world: the error of its force, chatter, and modulation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hapnet.checks import Array
from hapnet.ext.metrics.measured import Mask, Measured, metric, scaled
from hapnet.recording.samples import Columns, Recording
from hapnet.summary.tables import cut_share

_MODULATED_M = 1e-9
"""A set-position that is farther than this from the wanted one is modulated [m]; less is rounding."""


@metric("contact force error in the world", "%", "lower", over="time of the world's steps")
def world_force_error_percent(run: Measured) -> float | None:
    """Root mean square over time of the difference between the walls' force on the proxy and their force at rest with
    the device at its place in the middle of that step, through the spring between device and proxy and the wall in
    series; in % of the peak of the force at rest."""
    return contact_force_error(run.recording, run.proxy_force)


@metric("contacts per contact", "", "lower", over="the device's visits")
def contacts_ratio(run: Measured) -> float | None:
    """Visits of the proxy to a wall in the world, at its steps, per visit of the device, at each tick of the servo;
    neither is debounced. Above 1 the proxy chatters, and each impact costs energy."""
    if run.inside is None or run.world is None or not (by_hand := visits(run.inside)):
        return None  # if a proxy's penetration is not known, the walls are not known either
    return visits(run.world["penetration_m"] > 0.0) / by_hand


@metric("modulated at the world", "%", "lower", over="the world's updates")
def modulated_percent(run: Measured) -> float | None:
    """Share of the world's updates whose set-position in use differs from the wanted one by more than 1 nm; for a
    coupling with energy reservoirs."""
    known = run.sides[1]["reservoir_min_J"] is not None
    return 100.0 * modulated_share(run.world) if known and run.world is not None else None


@metric("modulated at the device", "%", "lower", over="the device's updates")
def modulated_device_percent(run: Measured) -> float | None:
    """The share of the device's updates that were modulated, as counted in the run's summary (modulated_share)"""
    return scaled(run.sides[0]["modulated_share"], 100.0)


@metric("ticks in which the motors held less", "%", "lower", over="the servo's ticks")
def force_cut_percent(run: Measured) -> float | None:
    """The share of the servo's ticks in which the motors could not hold its whole force, from the run's summary
    (cut_ticks); only a simulated arm's motors can hold less, each up to its own torque."""
    return scaled(cut_share(run.sides[0]), 100.0)


def visits(inside: Mask) -> int:
    """The number of visits to a wall, with one that began before the first sample. inside : (N,) True in a wall."""
    return int(inside[0]) + int(np.count_nonzero(inside[1:] & ~inside[:-1])) if len(inside) else 0


def contact_force_error(recording: Recording, true_force: Callable[[Array, Array], Array | None]) -> float | None:
    """Rms over time of the walls' force on the proxy minus the true force, in % of the true force's peak.

    The force of a step acts during the step, so it is compared with the true force at the device's place in the middle
    of that step; nothing is shifted. None if the two sides are not on one clock, or if the true force is always zero
    or not known.

    true_force : returns the force (N, n) [N] for positions (N, n) [m] and their times (N,) since the recording's origin
        [s]; None: it is not known.
    """
    device, world = recording.device, recording.world
    if device is None or world is None or not recording.meta.get("aligned", True):
        return None
    middle_s = world["time_s"] - 0.5 * world["step_s"]
    known = (middle_s >= device["time_s"][0]) & (middle_s <= device["time_s"][-1])
    if not known.any():
        return None
    times = middle_s[known]
    places = np.column_stack([np.interp(times, device["time_s"], axis) for axis in device["position_m"].T])
    wanted = true_force(places, times)
    if wanted is None:
        return None
    peak = float(np.linalg.norm(wanted, axis=1).max())
    apart = np.sum((world["contact_force_N"][known] - wanted) ** 2, axis=1)
    return 100.0 * float(np.sqrt(np.average(apart, weights=world["step_s"][known]))) / peak if peak > 0.0 else None


def modulated_share(world: Columns) -> float:
    """The share of the world's updates whose set-position in use differs from the wanted set-position."""
    apart = np.linalg.norm(world["set_position_m"] - world["target_m"], axis=1)
    return float(np.mean(apart > _MODULATED_M))
