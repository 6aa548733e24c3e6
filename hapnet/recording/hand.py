"""The recorded hand: its targets, or the device's positions if a person held a real device."""

from __future__ import annotations

import hashlib
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array
from hapnet.errors import InvalidParameter
from hapnet.file_content import MCAP, begins_with, read_bytes
from hapnet.params import Params, is_simulated
from hapnet.plant.operating_range import check_motion
from hapnet.plant.operator import Followed, Impedance
from hapnet.recording.missing import missing
from hapnet.recording.samples import Recording
from netem.files import read_once

PAUSED = "paused"
"""Text of the event of kind "pause" when a pause begins."""

LATE_NS = 500_000_000
"""A recording began late if its first sample comes more than this after the session's start [ns]."""

_LARGEST = 1 << 30  # of a file that is read again [bytes]
_PAUSED_WITHIN_NS = 200_000_000  # a pause reaches a servo in another process a little later


def is_recording(name: str) -> bool:
    """Whether this operator is a recording of a run."""
    return name.endswith(".mcap") or begins_with(name, MCAP)


@read_once
def recorded_hand(name: str, dof: int, impedance: Impedance, reach: float = math.inf) -> Followed:
    """The hand that follows the motion recorded in the file `name` once.

    reach : the largest distance of the motion from the origin [m].

    Raises RecordingError: the file is not a recording. InvalidParameter: it contains no such motion.
    """
    from hapnet.recording.mcap import read_recording  # here, since no other hand needs it

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
    check_motion(name, path, reach)
    return Followed(times, path, impedance, missing(name, recording))


def knows_hand(recording: Recording) -> bool:
    """Whether the recording contains the hand's targets. It does not if a person held a real device."""
    return recording.device is not None and bool(np.isfinite(recording.device["operator_target_m"]).any())


def hand_times(recording: Recording) -> Array:
    """The times of the device's samples [s] (N,), on the hand's clock, which starts with the device's control.

    That clock stands still during intervals that a replay leaves out (`left_out`). A simulated device advances by whole
    periods of its servo, independently of the real clock; so its times are rounded to these periods.
    """
    device, own = recording.device, _own(recording)
    assert device is not None
    since_s = replay_ns(recording, device["time_ns"]) / 1e9
    if not knows_hand(recording):
        return np.asarray(since_s)
    try:
        hz = float(own["params"]["device"]["servo_hz"])
    except (KeyError, TypeError):
        hz = Params().device.servo_hz
    return np.asarray(np.round(since_s * hz) / hz)


def replay_ns(recording: Recording, times_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """The times in a replay [ns] that correspond to `times_ns` on the clock of the device's recording."""
    own = _own(recording)
    since_ns = times_ns - int(own.get("device_origin_ns", own["origin_ns"]))
    for begin_ns, end_ns in left_out(recording):
        since_ns = since_ns - np.clip(times_ns - begin_ns, 0, end_ns - begin_ns)
    return since_ns


def left_out(recording: Recording) -> list[tuple[int, int]]:
    """The intervals that a replay leaves out: begin and end [ns], on the clock of the device's recording.

    The first is the time from the session's start to a recording that began late. The others are pauses, in which a
    simulated hand stands still and nothing is recorded.
    """
    device, own = recording.device, _own(recording)
    if device is None or own.get("clock") == "virtual":
        return []
    times, origin_ns = device["time_ns"], int(own["origin_ns"])
    spacing_ns = int(np.median(np.diff(times))) if len(times) > 1 else 0
    found = set[tuple[int, int]]()
    if times[0] - origin_ns > LATE_NS + 2 * spacing_ns:
        found.add((origin_ns, int(times[0])))
    if not is_simulated(own.get("params", {}).get("hardware", "simulated")):
        return sorted(found)  # a real hand keeps moving during a pause
    gaps = np.diff(times)
    for event in recording.events:
        if (event.kind, event.text) != ("pause", PAUSED):
            continue
        near = (times[:-1] >= event.time_ns - 2 * spacing_ns) & (times[:-1] <= event.time_ns + _PAUSED_WITHIN_NS)
        if near.any() and gaps[at := int(np.argmax(np.where(near, gaps, 0)))] > 2 * spacing_ns:
            found.add((int(times[at]) + spacing_ns, int(times[at + 1])))
    return sorted(found)


def begins_late(recording: Recording) -> bool:
    """Whether the recording began in the middle of its session."""
    cuts = left_out(recording)
    return bool(cuts) and cuts[0][0] == int(_own(recording)["origin_ns"])


def _own(recording: Recording) -> dict[str, Any]:
    """The settings of the device's own recording."""
    meta = recording.meta
    own: dict[str, Any] = (meta.get("sides") or {}).get("device", meta)
    return own


def fingerprint(operator: str) -> str | None:
    """SHA-256 of the file from which the operator is read; None for any other operator."""
    try:
        return hashlib.sha256(read_bytes(operator, _LARGEST)).hexdigest()
    except (OSError, ValueError):
        return None
