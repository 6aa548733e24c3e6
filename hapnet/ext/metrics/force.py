"""Metrics of the force on the device: its error, its steps and buzz, and its oscillation while the hand rests."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array
from hapnet.ext.metrics.measured import Measured, metric
from hapnet.recording.durations import durations_s, rms
from hapnet.recording.poses import of_point
from hapnet.recording.samples import Columns, Recording

BUZZ_HZ = 20.0
"""No hand moves faster than this [Hz]: force above this frequency comes from the coupling."""

_SEGMENT_S = 1.0
_OVERLAPS = 4  # segments that cover each instant, so that with Hann windows all instants have equal weight

FROM_S, UNTIL_S = 1.0, 3.0
"""The oscillation is measured from this long to this long after the hand's reference has stopped [s]."""

LIMIT_CYCLE_N = 0.02
"""An oscillation below this [N] is no limit cycle, as it cannot be felt."""

_STILL_M = 1e-9


@metric("force error", "N", "lower", over="time in which both runs have begun")
def force_error_N(run: Measured) -> float | None:
    """Root mean square over time of the difference between the force on the device and the force in the same run over
    an ideal link without deadband."""
    return None if (found := run.once(_force_error)) is None else found[0]


@metric("force error", "%", "lower", over="time in which both runs have begun")
def force_error_percent(run: Measured) -> float | None:
    """The force error in % of the ideal run's peak force."""
    return None if (found := run.once(_force_error)) is None else found[1]


@metric("true force error", "N", "lower", over="time")
def true_force_error_N(run: Measured) -> float | None:
    """Root mean square over time of the difference between the force on the device and the force of the true
    environment at the device's place: the walls, rendered locally and at once through the given springs in series, and
    zero in free space (transparency: Lawrence 1993). Drag, lag and softness all count. With friction, or a tool that
    turns, no spring gives this force: then the difference is taken from the force at the same time in the same run over
    an ideal link, with a world that steps at 1 kHz."""
    return None if (wanted := run.once(_true_force)) is None else rms_difference(run.device, wanted)[0]


@metric("true force error", "%", "lower", over="time")
def true_force_error_percent(run: Measured) -> float | None:
    """The true force error in % of the true environment's peak force in this run."""
    return None if (wanted := run.once(_true_force)) is None else rms_difference(run.device, wanted)[1]


@metric("true force error, last minute", "%", "lower", over="time in the last minute")
def true_force_error_last_percent(run: Measured) -> float | None:
    """The true force error over the last minute before the hand comes to rest, in a run of 120 s or more; in % of the
    whole run's peak."""
    wanted, (_, last) = run.once(_true_force), run.windows
    if wanted is None or last is None:
        return None
    return rms_difference(run.device, wanted, last.holds(run.device["time_s"]))[1]


@metric("residual oscillation", "N", "lower", over="time from 1 to 3 s after a stop")
def swing_N(run: Measured) -> float | None:
    """Root mean square of the force without its mean, from 1 to 3 s after the hand's reference has stopped; the
    largest if it stops more than once. None: it never stops for 3 s (see operator_model.end_hold_s)"""
    return residual_oscillation(run.recording)


@metric("buzz", "N²", "lower", over="time, in windows of 1 s")
def buzz_N2(run: Measured) -> float | None:
    """Power of the force on the device above 20 Hz, summed over the axes: Welch's spectrum with Hann windows of one
    second that overlap by three quarters, each without its mean."""
    return buzz(run.device)


@metric("peak force", "N", "lower", over="extreme over the recorded ticks")
def peak_force_N(run: Measured) -> float | None:
    """Largest force on the device."""
    return run.summary["motion"]["peak_force_N"]


@metric("largest force step", "N", "lower", over="extreme over neighbouring ticks")
def force_step_N(run: Measured) -> float | None:
    """The largest change of the force on the device from one servo tick to the next."""
    return largest_step(run.device)


def _force_error(run: Measured) -> tuple[float, float | None] | None:
    return None if run.ideal is None else force_error(run.recording, of_point(run.ideal))


def _true_force(run: Measured) -> Array | None:
    """The true environment's force on the device (N, n) [N]; with friction, from the run over an ideal link."""
    if not run.scalar or run.local is None:
        return run.wanted if run.scalar else None
    return force_meanwhile(run.recording, of_point(run.local))


def force_error(recording: Recording, ideal: Recording) -> tuple[float, float | None] | None:
    """(rms of the difference between the forces on the device [N], this difference in % of `ideal`'s peak force).

    The forces are compared at the same time since control of the device began, which is when the simulated hand begins
    to move. The force of `ideal` is interpolated at this run's sample times. The percentage is None if the force in
    `ideal` is always zero; the result is None without samples of both devices.
    """
    ours, theirs = recording.device, ideal.device
    if ours is None or theirs is None:
        return None
    wanted = force_meanwhile(recording, ideal)
    both = np.isfinite(wanted[:, 0])
    if not both.any():
        return None
    apart = rms(np.linalg.norm(ours["force_N"][both] - wanted[both], axis=1), durations_s(ours)[both])
    if apart is None:
        return None
    peak = float(np.linalg.norm(theirs["force_N"], axis=1).max())
    return apart, 100.0 * apart / peak if peak > 0.0 else None


def force_meanwhile(recording: Recording, other: Recording) -> Array:
    """The force on the device of `other` (N, n) [N] at the times of this run's samples, since the hand began to move.

    NaN where `other` has not begun, or has ended. Both have a device's samples.
    """
    ours, theirs = recording.device, other.device
    assert ours is not None, "this run has a device's samples"
    assert theirs is not None, "the other run has a device's samples"
    times, reference = _hand_s(recording, ours), _hand_s(other, theirs)
    forces = [np.interp(times, reference, axis, left=np.nan, right=np.nan) for axis in theirs["force_N"].T]
    return np.column_stack(forces)


def rms_difference(
    device: Columns, wanted: Array, counts: NDArray[np.bool_] | None = None
) -> tuple[float | None, float | None]:
    """(rms of the difference between the force on the device and `wanted` (N, n) [N], in % of the peak of `wanted`).

    counts : (N,) the samples over which the mean is taken; None: all. A sample with NaN in `wanted`, which is not
        known there, does not count. None without a sample that counts; no percentage if `wanted` is always 0.
    """
    known = np.isfinite(wanted).all(axis=1)
    chosen = known if counts is None else known & counts
    if not chosen.any():
        return None, None
    apart = rms(np.linalg.norm(device["force_N"][chosen] - wanted[chosen], axis=1), durations_s(device)[chosen])
    if apart is None:
        return None, None
    peak = float(np.linalg.norm(wanted[known], axis=1).max())
    return apart, 100.0 * apart / peak if peak > 0.0 else None


def largest_step(device: Columns) -> float | None:
    """The largest change of the force from one sample to the next [N]; None with fewer than two samples."""
    changes = np.linalg.norm(np.diff(device["force_N"], axis=0), axis=1)
    return float(changes.max()) if len(changes) else None


def buzz(device: Columns) -> float | None:
    """Power of the force from `BUZZ_HZ` to half the sampling rate, summed over the axes [N^2].

    A sine of amplitude a in this range has the power a^2/2. This is Welch's spectrum (1967) with Hann windows of one
    second, each without its mean. They overlap by three quarters, so that all instants have equal weight except in the
    first and last second. None for a recording that is shorter than a window, unevenly sampled, or sampled at 40 Hz or
    less.
    """
    times, force = device["time_s"], device["force_N"]
    steps = np.diff(times)
    if not len(steps) or np.ptp(steps) > 0.5 * (period := float(np.median(steps))) or 1.0 / period <= 2.0 * BUZZ_HZ:
        return None
    length = round(_SEGMENT_S / period)
    if len(force) < length:
        return None
    hop = max(1, length // _OVERLAPS)
    segments = np.lib.stride_tricks.sliding_window_view(force, length, axis=0)[::hop]
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(length) / length)
    spectrum = np.fft.rfft((segments - segments.mean(axis=-1, keepdims=True)) * window, axis=-1)
    power = np.abs(spectrum) ** 2 / (length * np.sum(window**2))
    power[..., 1 : (length + 1) // 2] *= 2.0  # the negative frequencies
    fast = np.fft.rfftfreq(length, period) > BUZZ_HZ
    return float(power[..., fast].sum(axis=-1).mean(axis=0).sum())


def _hand_s(recording: Recording, device: Columns) -> Array:
    """Times since control of the device began [s]."""
    meta = recording.meta
    return np.asarray((device["time_ns"] - int(meta.get("device_origin_ns", meta["origin_ns"]))) / 1e9)


def residual_oscillation(recording: Recording) -> float | None:
    """Root mean square of the force without its mean, from 1 to 3 s after the hand's reference has stopped [N].

    All axes count together. A reference that rests from the start stopped at the start. If it stops for 3 s more than
    once, the largest value counts. None if it never does, or if the recording has no reference.
    """
    return max((_swing(recording, stop, FROM_S, UNTIL_S) for stop in _stops(recording)), default=None)


def limit_cycles(recording: Recording, until_s: float = UNTIL_S) -> bool | None:
    """Whether the force continues to oscillate after the hand has stopped.

    It does if the force without its mean is at least `LIMIT_CYCLE_N` (rms) in the last second before `until_s`, which
    counts from a stop, and at least half of its value from 1 to 2 s, as an oscillation that decays faster is a
    transient. The longer `until_s`, the slower the oscillation may decay. None without a stop of `until_s`.
    """
    found = None
    for stop in _stops(recording, until_s):
        before, after = (_swing(recording, stop, since, since + 1.0) for since in (FROM_S, until_s - 1.0))
        found = found or (after >= LIMIT_CYCLE_N and after >= 0.5 * before)
    return found


def _stops(recording: Recording, until_s: float = UNTIL_S) -> list[float]:
    """The times at which the hand's reference came to rest for at least `until_s` [s]."""
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
    force, lasting = recording.device["force_N"][first:end], durations_s(recording.device)[first:end]
    middle = np.average(force, axis=0, weights=lasting) if lasting.any() else 0.0
    return rms(np.linalg.norm(force - middle, axis=1), lasting) or 0.0
