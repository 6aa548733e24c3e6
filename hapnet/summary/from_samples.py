"""Figures of a summary that come from the samples: tracking errors, peaks of force and depth, and the margin of both
ports.
"""

from __future__ import annotations

import math
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array
from hapnet.mechanics.pose import angles_between, wrench
from hapnet.recording.durations import durations_s, rms
from hapnet.recording.hand import left_out
from hapnet.recording.poses import of_point, of_turning
from hapnet.recording.samples import Columns, DeviceSample, Recording, Sample, WorldSample
from hapnet.units import METRES, POSE

START_S = 1.0
"""Time from which on the later minimum of the margin counts [s]: at the start the margin is d^2 in any case."""


class MotionFigures(TypedDict):
    """Tracking errors and peaks, see `motion`. A value is None if the recording does not contain it."""

    free_rms_m: float | None
    contact_rms_m: float | None
    peak_force_N: float | None
    peak_penetration_m: float | None
    contacts: int | None
    free_rms_rad: float | None
    contact_rms_rad: float | None
    peak_torque_Nm: float | None


def motion(recording: Recording) -> MotionFigures:
    """Position errors, peaks and the number of contacts; a value is None if the recording does not contain it.

    The position error is the Euclidean distance between device and proxy [m]. The proxy is interpolated linearly at the
    device's sample times; device samples before the proxy's first or after its last are left out. A sample is in
    contact if the latest world sample has a positive penetration. Means are over time (`hapnet.recording.durations`).

    Returns
    -------
    free_rms_m, contact_rms_m : root mean square of the position error outside contact and in contact [m]; None without
        both sides, without any such sample, or if the two sides' clocks could not be aligned.
    peak_force_N : largest Euclidean norm of the coupling's force on the device [N].
    peak_penetration_m : largest depth of the proxy in a wall [m]; 0 if it never entered one.
    contacts : number of separate visits to a wall, including one that had begun before the start.
    free_rms_rad, contact_rms_rad, peak_torque_Nm : for a tool that turns, the same figures of the angle between the
        orientations [rad] and of the torque [Nm]; the other figures are then those of its point. None without a tool.
    """
    point, turning = of_point(recording), of_turning(recording)
    device, world = point.device, point.world
    result = _NONE.copy()
    if device is not None:
        result["peak_force_N"] = _largest(device)
    if turning is not None and turning.device is not None:
        result["peak_torque_Nm"] = _largest(turning.device)
    if world is not None:
        inside = world["penetration_m"] > 0.0
        result["peak_penetration_m"] = _finite(max(world["penetration_m"].max(), 0.0))
        result["contacts"] = int(inside[0]) + int(np.count_nonzero(inside[1:] & ~inside[:-1]))
    if device is not None and world is not None and recording.meta.get("aligned", True):
        error, known = position_error(device, world)
        contact, lasting = touching(device, world)[known], durations_s(device, left_out(recording))[known]
        result["free_rms_m"] = _rms(error, lasting, ~contact)
        result["contact_rms_m"] = _rms(error, lasting, contact)
        if turning is not None and recording.device is not None and recording.world is not None:
            angles = angles_between(recording.device["position_m"][known], _proxy(recording.world, device, known))
            result["free_rms_rad"] = _rms(angles, lasting, ~contact)
            result["contact_rms_rad"] = _rms(angles, lasting, contact)
    return result


_NONE = MotionFigures(
    free_rms_m=None, contact_rms_m=None, peak_force_N=None, peak_penetration_m=None, contacts=None,
    free_rms_rad=None, contact_rms_rad=None, peak_torque_Nm=None,
)  # fmt: skip


def position_error(device: Columns, world: Columns) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Distance between device and proxy [m] where both are known, and a mask (N,) of these samples of the device."""
    known = (device["time_s"] >= world["time_s"][0]) & (device["time_s"] <= world["time_s"][-1])
    return np.linalg.norm(device["position_m"][known] - _proxy(world, device, known), axis=1), known


def touching(device: Columns, world: Columns) -> NDArray[np.bool_]:
    """(N,) whether the proxy was in a wall at the newest sample before each of the device's."""
    latest = np.maximum(np.searchsorted(world["time_s"], device["time_s"], side="right") - 1, 0)
    return np.asarray(world["penetration_m"][latest] > 0.0)


def _proxy(world: Columns, device: Columns, known: NDArray[np.bool_]) -> Array:
    """The proxy's coordinates at the device's samples."""
    times = device["time_s"][known]
    return np.column_stack([np.interp(times, world["time_s"], axis) for axis in world["position_m"].T])


def _largest(device: Columns) -> float | None:
    return _finite(np.linalg.norm(device["force_N"], axis=1).max())


def _rms(values: Array, lasting: Array, chosen: NDArray[np.bool_]) -> float | None:
    found = rms(values[chosen], lasting[chosen])
    return None if found is None else _finite(found)


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


class LiveFigures:
    """The peaks of `motion` and the minima of the account, of one side's samples.

    Attributes
    ----------
    units : of the axes, as `hapnet.units` has them.
    margin_J, slack_J : the minimum so far. margin_end_J : the newest. margin_later_J : the minimum from `START_S` after
        the first on. All [J], and None before there is one.
    """

    def __init__(self, units: str = METRES) -> None:
        self._turns = units == POSE
        self.margin_J: float | None = None
        self.slack_J: float | None = None
        self.margin_end_J: float | None = None
        self.margin_later_J: float | None = None
        self._first_ns: int | None = None
        self._motion = _NONE.copy()
        self._inside = False

    def see(self, sample: Sample) -> None:
        """Take the next sample, on any thread; samples must come in the order of their times."""
        if isinstance(sample, DeviceSample):
            force = sample.force_N
            if self._turns:
                force, torque = wrench(sample.position_m, force)
                self._motion["peak_torque_Nm"] = _more(self._motion["peak_torque_Nm"], math.hypot(*torque))
            self._motion["peak_force_N"] = _more(self._motion["peak_force_N"], math.hypot(*force))
        elif isinstance(sample, WorldSample):
            inside = sample.penetration_m > 0.0
            depth = max(sample.penetration_m, 0.0)
            self._motion["peak_penetration_m"] = _more(self._motion["peak_penetration_m"], depth)
            self._motion["contacts"] = (self._motion["contacts"] or 0) + (inside and not self._inside)
            self._inside = inside
        else:
            return
        self.margin_J, self.slack_J = _less(self.margin_J, sample.margin_J), _less(self.slack_J, sample.slack_J)
        self.margin_end_J = sample.margin_J
        self._first_ns = sample.time_ns if self._first_ns is None else self._first_ns
        if sample.time_ns - self._first_ns >= START_S * 1e9:
            self.margin_later_J = _less(self.margin_later_J, sample.margin_J)

    def later_J(self, end_J: float | None) -> float | None:
        """The minimum from `START_S` on [J], including the margin `end_J` at the end, which may be in no sample."""
        return None if self.margin_later_J is None or end_J is None else min(self.margin_later_J, end_J)

    def motion(self) -> MotionFigures:
        """Return the figures of motion so far; tracking errors need both sides and are None."""
        return self._motion.copy()


def _more(most: float | None, value: float) -> float | None:
    return value if math.isfinite(value) and (most is None or value > most) else most


def _less(minimum: float | None, value: float) -> float | None:
    return value if math.isfinite(value) and (minimum is None or value < minimum) else minimum


def total_margin(recording: Recording) -> Columns | None:
    """The sum of both sides' margins over time: ``time_s`` and ``margin_J`` at every sample of either side.

    The other side contributes its last sample up to that time. So energy that went in and out again between two samples
    is not included. The sum covers the time in which both sides are recorded. None if they are not on one clock: a
    measured difference of clocks may cause an error of milliwatts times milliseconds, so it would prove nothing.
    """
    if (both := _on_one_clock(recording)) is None:
        return None
    device, world = both
    of_device, of_world = device["time_s"], world["time_s"]
    times = np.union1d(of_device, of_world)
    times = times[(times >= max(of_device[0], of_world[0])) & (times <= min(of_device[-1], of_world[-1]))]
    if not len(times):
        return None
    halves = [_at(side, "margin_J", times) for side in (device, world)]
    return {"time_s": times, "margin_J": halves[0] + halves[1]}


def two_port_margin(recording: Recording) -> float | None:
    """The minimum of d^2 and the energy put in at both ports, over the recorded time [J]; None: as of `total_margin`.

    The sum of both margins leaves out energy in flight. This minimum includes it, even if more was credited than sent.
    """
    total, both = total_margin(recording), _on_one_clock(recording)
    if total is None or both is None:
        return None
    sums = [_at(side, "sent_J", total["time_s"]) - _at(side, "credited_J", total["time_s"]) for side in both]
    margin = total["margin_J"] + sums[0] + sums[1]
    known = margin[np.isfinite(margin)]
    return float(known.min()) if len(known) else None


def credited_early(recording: Recording) -> tuple[float | None, float | None]:
    """The most that was credited before it was sent, from the device and from the world [J]; None: not known.

    Each sample of the receiver is compared with the sender's first sample after the receiver's next one, which can only
    be higher: a tick whose thread waits may credit energy sent after the tick began, but it ends before the next tick.
    """
    if (both := _on_one_clock(recording)) is None:
        return None, None
    device, world = both
    return _early(device, world), _early(world, device)


def _early(sender: Columns, receiver: Columns) -> float | None:
    following = np.searchsorted(sender["time_s"], receiver["time_s"][1:], side="left")
    seen = following < len(sender["time_s"])
    early = receiver["credited_J"][:-1][seen] - sender["sent_J"][following[seen]]
    known = early[np.isfinite(early)]
    return max(0.0, float(known.max())) if len(known) else None


def _at(side: Columns, name: str, times: Array) -> Array:
    return side[name][np.searchsorted(side["time_s"], times, side="right") - 1]


def _on_one_clock(recording: Recording) -> tuple[Columns, Columns] | None:
    device, world, meta = recording.device, recording.world, recording.meta
    if device is None or world is None or not meta.get("aligned", True) or "clock_difference" in meta:
        return None
    return device, world


def min_total_margin(recording: Recording, since_s: float = -math.inf) -> float | None:
    """The minimum of `total_margin` from `since_s` on [J]; None if it is unknown."""
    total = total_margin(recording)
    margin = np.array([]) if total is None else total["margin_J"][total["time_s"] >= since_s]
    known = margin[np.isfinite(margin)]
    return float(known.min()) if len(known) else None


def last_total_margin(recording: Recording) -> float | None:
    """The last `total_margin` [J]; None if it is unknown."""
    total = total_margin(recording)
    margin = np.array([]) if total is None else total["margin_J"]
    known = margin[np.isfinite(margin)]
    return float(known[-1]) if len(known) else None
