"""The force on the device: its difference from another run's, how it steps, and how much it buzzes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array
from hapnet.recording.samples import Columns, Recording

BUZZ_HZ = 20.0
"""No hand moves faster than this: force above this frequency comes from the coupling."""

_SEGMENT_S = 1.0
_OVERLAPS = 4  # segments that cover each instant: with Hann windows all instants then have equal weight


def force_error(recording: Recording, ideal: Recording) -> tuple[float, float | None] | None:
    """(root mean square of the difference between the forces on the device [N], the same in % of `ideal`'s peak force).

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
    rms = float(np.sqrt(np.mean(np.sum((ours["force_N"][both] - wanted[both]) ** 2, axis=1))))
    peak = float(np.linalg.norm(theirs["force_N"], axis=1).max())
    return rms, 100.0 * rms / peak if peak > 0.0 else None


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

    counts : (N,) the samples over which the mean is taken; None: all. Where `wanted` is NaN it is not known, and the
        sample does not count. None without any that counts, and no percentage where `wanted` is always 0.
    """
    known = np.isfinite(wanted).all(axis=1)
    chosen = known if counts is None else known & counts
    if not chosen.any():
        return None, None
    rms = float(np.sqrt(np.mean(np.sum((device["force_N"][chosen] - wanted[chosen]) ** 2, axis=1))))
    peak = float(np.linalg.norm(wanted[known], axis=1).max())
    return rms, 100.0 * rms / peak if peak > 0.0 else None


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
