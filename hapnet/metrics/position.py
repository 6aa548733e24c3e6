"""How well the proxy followed the device, and how hard and deep the contacts were."""

from __future__ import annotations

from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from hapnet.recording.samples import Columns, Recording


class Motion(TypedDict):
    """Tracking errors and peaks, see `motion`. A value is None if the recording does not contain it."""

    free_rms_m: float | None
    contact_rms_m: float | None
    peak_force_N: float | None
    peak_penetration_m: float | None
    contacts: int | None


def motion(recording: Recording) -> Motion:
    """Position errors, peaks and the number of contacts; a value is None if the recording does not contain it.

    The position error is the Euclidean distance between device and proxy [m]. The proxy is interpolated linearly at the
    device's sample times; device samples before the proxy's first or after its last are left out. A sample is in
    contact if the latest world sample has a positive penetration.

    Returns
    -------
    free_rms_m, contact_rms_m : root mean square of the position error outside contact and in contact [m]; None without
        both sides, without any such sample, or if the two sides' clocks could not be aligned.
    peak_force_N : largest Euclidean norm of the coupling's force on the device [N].
    peak_penetration_m : largest depth of the proxy in a wall [m]; 0 if it never entered one.
    contacts : number of separate visits to a wall, including one that had begun before the start.
    """
    device, world = recording.device, recording.world
    result: Motion = {
        "free_rms_m": None,
        "contact_rms_m": None,
        "peak_force_N": None,
        "peak_penetration_m": None,
        "contacts": None,
    }
    if device is not None:
        result["peak_force_N"] = _finite(np.linalg.norm(device["force_N"], axis=1).max())
    if world is not None:
        inside = world["penetration_m"] > 0.0
        result["peak_penetration_m"] = _finite(max(world["penetration_m"].max(), 0.0))
        result["contacts"] = int(inside[0]) + int(np.count_nonzero(inside[1:] & ~inside[:-1]))
    if device is not None and world is not None and recording.meta.get("aligned", True):
        error, known = position_error(device, world)
        latest = np.searchsorted(world["time_s"], device["time_s"][known], side="right") - 1
        contact = world["penetration_m"][latest] > 0.0
        result["free_rms_m"] = _rms(error[~contact])
        result["contact_rms_m"] = _rms(error[contact])
    return result


def position_error(device: Columns, world: Columns) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Distance between device and proxy [m] where both are known, and (N,) at which of the device's samples that is."""
    known = (device["time_s"] >= world["time_s"][0]) & (device["time_s"] <= world["time_s"][-1])
    times, positions = device["time_s"][known], device["position_m"][known]
    proxy = np.column_stack([np.interp(times, world["time_s"], axis) for axis in world["position_m"].T])
    return np.linalg.norm(positions - proxy, axis=1), known


def _rms(values: NDArray[np.float64]) -> float | None:
    return _finite(np.sqrt(np.mean(values**2))) if len(values) else None


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
