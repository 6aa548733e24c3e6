"""The hand of a recording: where it wanted to be or, of a person with a real device, where the device was."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np

from hapnet.checks import Array
from hapnet.errors import InvalidParameter
from hapnet.mcap_file import is_mcap, read_recording
from hapnet.params import Params
from hapnet.plant.operator import Followed, Impedance
from hapnet.record import Recording


def is_recording(name: str) -> bool:
    """Is this operator a recording of a run?"""
    return name.endswith(".mcap") or is_mcap(name)


def recorded_hand(name: str, dof: int, impedance: Impedance) -> Followed:
    """The hand that follows the motion recorded in the file `name`, once.

    Raises
    ------
    RecordingError : the file is no recording. InvalidParameter : there is no such motion in it.
    """
    recording = read_recording(name)
    if recording.device is None:
        raise InvalidParameter("operator", name, "a recording with the device's side: the world's has no hand")
    path = recording.device["operator_target_m" if knows_hand(recording) else "position_m"]
    known = np.isfinite(path).all(axis=1)
    times, path = hand_times(recording)[known], path[known]
    if path.shape[1] != dof:
        raise InvalidParameter("operator", name, f"a recording with {dof} axes, as the scene has")
    if len(times) < 2 or not np.all(np.diff(times) > 0.0):
        raise InvalidParameter("operator", name, "a recording with at least two samples, one after the other")
    return Followed(times, path, impedance)


def knows_hand(recording: Recording) -> bool:
    """Does it say where the hand wanted to be? Not of a person who held a real device."""
    return recording.device is not None and bool(np.isfinite(recording.device["operator_target_m"]).any())


def hand_times(recording: Recording) -> Array:
    """When the device's samples were taken [s], on the hand's clock: it starts with the control of the device.

    A simulated device lives in whole periods of its servo, whatever the clock said when it was read.
    """
    meta, device = recording.meta, recording.device
    assert device is not None
    sides: dict[str, Any] = meta.get("sides") or {}
    own = sides.get("device", meta)
    since_s = (device["time_ns"] - int(own.get("device_origin_ns", own["origin_ns"]))) / 1e9
    if not knows_hand(recording):
        return np.asarray(since_s)
    try:
        hz = float(own["params"]["device"]["servo_hz"])
    except (KeyError, TypeError):
        hz = Params().device.servo_hz
    return np.asarray(np.round(since_s * hz) / hz)


def fingerprint(operator: str) -> str | None:
    """SHA-256 of the file that the operator is read from; None for any other operator."""
    try:
        return hashlib.sha256(Path(operator).read_bytes()).hexdigest()
    except (OSError, ValueError):
        return None
