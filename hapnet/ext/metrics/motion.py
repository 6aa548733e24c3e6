"""Metrics of motion: how closely the proxy follows in free space, the coupling's drag, and the drift between the two.

With a transparent coupling the proxy would be at the device's place, and there would be no drag (D. A. Lawrence 1993).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array
from hapnet.ext.metrics.contact import contact_force, pressed_wall
from hapnet.ext.metrics.measured import Measured, Span, metric, scaled
from hapnet.ext.metrics.obstacles import WallOrSolid, normal_where_deepest
from hapnet.recording.durations import durations_s, evenly, rms
from hapnet.recording.samples import Columns, Recording
from hapnet.summary.from_samples import position_error, touching

_MIN_DRAG_N = 0.01
"""The smallest drag with which forces are compared [N]: a smaller drag cannot be felt."""

_ALWAYS = Span(float("-inf"), float("inf"))


@metric("position error, free", "mm", "lower", over="time with the device in no wall")
def free_rms_mm(run: Measured) -> float | None:
    """Root mean square of the distance between device and proxy at the same time, while the device is in no wall. (In a
    run's summary, free_rms_m counts the time with the proxy in no wall)"""
    return _error_mm(run, _ALWAYS)


@metric("position error, free, first 10 s", "mm", "lower", over="such time in the first 10 s")
def free_first_mm(run: Measured) -> float | None:
    """The position error in free motion over the first 10 s of a run of 120 s or more."""
    return _error_mm(run, run.windows[0])


@metric("position error, free, last minute", "mm", "lower", over="such time in the last minute")
def free_last_mm(run: Measured) -> float | None:
    """The position error in free motion over the last minute before the hand comes to rest, in a run of 120 s or more:
    if it is greater than in the first 10 s, the coupling gets worse with time."""
    return _error_mm(run, run.windows[1])


@metric("position error, contact", "mm", "lower", over="time with the proxy in a wall")
def contact_rms_mm(run: Measured) -> float | None:
    """Root mean square of that distance while the proxy is in a wall. A perfect coupling has this error too, as its
    spring yields."""
    return scaled(run.summary["motion"]["contact_rms_m"], 1e3)


@metric("drag at 67 mm/s", "N", "nearer 0", over="time in free motion")
def drag_N(run: Measured) -> float | None:
    """Force against the motion in free space, by linear regression on the device's velocity, at 67 mm/s; both are means
    over a third of a second, so that no oscillation hides the drag. Time within a round trip and two of the longest
    steps after a contact is left out."""
    return None if (found := run.once(_windows)) is None else found.drag()


@metric("drag, 95th percentile", "N", "nearer 0", over="time in free motion at 50 to 90 mm/s")
def drag_p95_N(run: Measured) -> float | None:
    """95th percentile of the force against the motion, over the thirds of a second of free motion with a mean speed of
    50 to 90 mm/s."""
    return None if (found := run.once(_windows)) is None else found.greatest_drag()


@metric("drag, last minute", "N", "nearer 0", over="time in free motion in the last minute")
def drag_last_N(run: Measured) -> float | None:
    """Drag at 67 mm/s over the last minute before the hand comes to rest, in a run of 120 s or more."""
    found, (_, last) = run.once(_windows), run.windows
    return None if found is None or last is None else found.during(last).drag()


@metric("force, free, 99th percentile", "N", "lower", over="time in free motion")
def free_force_p99_N(run: Measured) -> float | None:
    """99th percentile of the force in free space, at any speed: what a fast hand feels where nothing is. Time within a
    round trip and two of the longest steps after a contact is left out."""
    if run.delay_s is None or run.world is None or run.walls is None:
        return None
    return free_force(run.recording, run.walls, run.delay_s + 2.0 * float(run.world["step_s"].max()))


@metric("contact to drag", "", "higher", over="time in settled contact; time in free motion")
def contact_to_drag(run: Measured) -> float | None:
    """Median resisting force in settled contact over the drag at 67 mm/s (0.01 N if the drag is less): at 1, free
    motion feels as hard as the wall."""
    drag = drag_N(run)
    if run.delay_s is None or run.walls is None or drag is None:
        return None
    pushed = contact_force(run.recording, run.walls, run.delay_s)
    return None if pushed is None else pushed / max(drag, _MIN_DRAG_N)


@metric("position drift", "mm/min", "nearer 0", over="time with device and proxy free")
def drift_mm_per_min(run: Measured) -> float | None:
    """Slope over time of device minus proxy along the motion while both are free, by least absolute deviations; a lag
    that depends on the device's last 0.4 s is fitted too and left out."""
    return None if run.walls is None else scaled(drift(run.recording, run.walls), 60e3)


def _error_mm(run: Measured, span: Span | None) -> float | None:
    if run.inside is None or span is None:
        return None
    return scaled(following_error(run.recording, ~run.inside & span.holds(run.device["time_s"])), 1e3)


def _windows(run: Measured) -> FreeWindows | None:
    if run.delay_s is None or run.world is None or run.walls is None:
        return None
    return free_windows(run.recording, run.walls, run.delay_s + 2.0 * float(run.world["step_s"].max()))


DRAG_MPS = 0.067
"""The speed at which drag is given [m/s]: the rms speed of a hand that moves by 30 mm at 0.5 Hz."""

NEAR_MPS = (0.05, 0.09)
"""The range of speeds for the largest drag [m/s]."""

_WINDOW_S = 1.0 / 3.0
"""Force and velocity are means over this time [s], so that the regression covers the hand's motion, not an oscillation
at 3 Hz or more, whose force and speed are so large that they hide the drag."""
_MIN_S, _MIN_MPS = 0.3, 0.005


def following_error(recording: Recording, free: NDArray[np.bool_]) -> float | None:
    """Root mean square of the distance between device and proxy in free motion [m]; None without such motion.

    free : (N,) True for samples with the device outside of all walls. The proxy may be in a wall, as it is at another
        place. (The summary's `motion` uses the proxy instead, as a recording alone has no walls: it leaves out a proxy
        that has run into a wall, and counts a proxy that is late while the hand pushes into the wall.)
    """
    device, world = recording.device, recording.world
    if device is None or world is None or not recording.meta.get("aligned", True):
        return None
    error, known = position_error(device, world)
    counted = free[known]
    return rms(error[counted], durations_s(device)[known][counted])


class FreeWindows(NamedTuple):
    """Windows of a third of a second in free motion.

    time_s : (M,) the end of each. velocity, force : (M, n) the device's mean velocity [m/s] and the mean force on it
        [N] in each. period_s : time between the ends of two windows.
    """

    time_s: Array
    velocity: Array
    force: Array
    period_s: float

    def during(self, span: Span) -> FreeWindows:
        """The windows that end in `span`."""
        chosen = span.holds(self.time_s)
        return FreeWindows(self.time_s[chosen], self.velocity[chosen], self.force[chosen], self.period_s)

    def drag(self) -> float | None:
        """The force that resists free motion at `DRAG_MPS` [N]: a linear regression of force on velocity.

        The slope is ``-sum F.v / sum v.v`` with means F and v over a third of a second. A force that only accelerates
        and brakes, such as a mass's, has slope 0. None with less than 0.3 s of windows, or if they are slower than
        5 mm/s (root mean square).
        """
        squared = float(np.sum(self.velocity * self.velocity))
        count = len(self.velocity)
        if count * self.period_s < _MIN_S or squared < count * _MIN_MPS**2:
            return None
        return -DRAG_MPS * float(np.sum(self.force * self.velocity)) / squared

    def greatest_drag(self, share: float = 0.95) -> float | None:
        """The quantile at `share` of the force against the motion, over the windows at `NEAR_MPS` [N].

        None with less than 0.3 s of such windows.
        """
        speed = np.linalg.norm(self.velocity, axis=1)
        near = (speed >= NEAR_MPS[0]) & (speed <= NEAR_MPS[1])
        if np.count_nonzero(near) * self.period_s < _MIN_S:
            return None
        against = -np.einsum("ij,ij->i", self.force[near], self.velocity[near]) / speed[near]
        return float(np.quantile(against, share))


def free_windows(recording: Recording, walls: Sequence[WallOrSolid], settling_s: float) -> FreeWindows | None:
    """The windows of free motion; None: the two sides are not on one clock.

    A window counts if neither the device nor the proxy was in a wall during it, nor in the `settling_s` seconds before.
    Samples that are not evenly spaced are first resampled to an even grid.
    """
    device, world = recording.device, recording.world
    if device is None or world is None or not recording.meta.get("aligned", True) or len(device["time_s"]) < 2:
        return None
    device = evenly(device, ("position_m", "force_N"))
    times, x = device["time_s"], device["position_m"]
    period_s = float(times[-1] - times[0]) / (len(times) - 1)
    width = max(1, round(_WINDOW_S / period_s))
    touched = touching(device, world)
    for wall in walls:
        touched |= wall.depths(x) > 0.0
    untouched_s = times - np.maximum.accumulate(np.where(touched, times, -np.inf))
    free = untouched_s[width:] > settling_s + width * period_s
    total = np.cumsum(device["force_N"], axis=0)
    velocity = ((x[width:] - x[:-width]) / (width * period_s))[free]
    return FreeWindows(times[width:][free], velocity, ((total[width:] - total[:-width]) / width)[free], period_s)


def free_force(
    recording: Recording, walls: Sequence[WallOrSolid], settling_s: float, share: float = 0.99
) -> float | None:
    """The quantile at `share` of the force's magnitude over the time in free motion [N], as `free_windows` counts it.

    None: the two sides are not on one clock, or there is less than 0.3 s of such time.
    """
    free = _free(recording, walls, settling_s)
    if free is None:
        return None
    device, counted = free
    spans, force = durations_s(device)[counted], np.linalg.norm(device["force_N"][counted], axis=1)
    if spans.sum() < _MIN_S:
        return None
    order = np.argsort(force)
    return float(force[order][np.searchsorted(np.cumsum(spans[order]), share * spans.sum())])


def drag_by_speed(
    recording: Recording, walls: Sequence[WallOrSolid], settling_s: float, edges_mps: Sequence[float]
) -> list[float | None] | None:
    """The mean force against free motion [N] in each range of speed between two of `edges_mps` [m/s].

    None: the two sides are not on one clock; in a range: there is less than 0.3 s of such motion. A force that only
    accelerates and brakes, such as a mass's, cancels over strokes that begin and end at rest.
    """
    free = _free(recording, walls, settling_s)
    if free is None:
        return None
    device, counted = free
    spans, velocity = durations_s(device)[counted], device["velocity_mps"][counted]
    speed = np.linalg.norm(velocity, axis=1)
    against = -np.einsum("ij,ij->i", device["force_N"][counted], velocity) / np.maximum(speed, 1e-9)
    at = np.digitize(speed, edges_mps)
    lasting = [float(spans[at == k].sum()) for k in range(1, len(edges_mps))]
    total = [float((against * spans)[at == k].sum()) for k in range(1, len(edges_mps))]
    return [one / lasted if lasted >= _MIN_S else None for one, lasted in zip(total, lasting, strict=True)]


def _free(
    recording: Recording, walls: Sequence[WallOrSolid], settling_s: float
) -> tuple[Columns, NDArray[np.bool_]] | None:
    """The device's columns, and which of its samples are in free motion; None: the two sides are not on one clock."""
    device, world = recording.device, recording.world
    if device is None or world is None or not recording.meta.get("aligned", True):
        return None
    times, touched = device["time_s"], touching(device, world)
    for wall in walls:
        touched |= wall.depths(device["position_m"]) > 0.0
    return device, times - np.maximum.accumulate(np.where(touched, times, -np.inf)) > settling_s


_TRAVELS_S = (0.1, 0.2, 0.4)
"""The lag is modelled as a weighted sum of the device's displacements over these times [s]: zero while it rests."""
_RATE_HZ = 100.0
_MIN_DRIFT_S, _MIN_SPAN_S = 2.0, 5.0
_ROUNDS = 30


def drift(recording: Recording, walls: Sequence[WallOrSolid]) -> float | None:
    """Slope over time of device minus proxy while both are outside all `walls` [m/s].

    It is measured along the normal of the wall or solid in which the device was deepest; without a wall, along the axis
    on which the device moved most. The model is ``apart(t) = offset + slope t + sum_i w_i (x(t) - x(t - s_i))``. Its
    last terms are the lag, which is periodic if the motion is. The model is fitted by least absolute deviations, so
    that an outage does not look like drift (a very long outage still does). None if the two sides are not on one clock,
    or if free motion lasts less than 2 s in total or less than 5 s from first to last sample.
    """
    device, world = recording.device, recording.world
    if device is None or world is None or not recording.meta.get("aligned", True):
        return None
    direction = _direction(device, pressed_wall(device, walls))
    path, seconds = device["position_m"] @ direction, device["time_s"]
    first, last = max(seconds[0], world["time_s"][0]), min(seconds[-1], world["time_s"][-1])
    times = np.arange(first, last, 1.0 / _RATE_HZ)
    x = np.interp(times, seconds, path)
    apart = x - np.interp(times, world["time_s"], world["position_m"] @ direction)
    travels = [x - np.interp(times - span, seconds, path) for span in _TRAVELS_S]
    outside = np.ones(len(times), dtype=bool)
    for wall in walls:
        outside &= np.interp(times, seconds, wall.depths(device["position_m"])) <= 0.0
    outside &= world["penetration_m"][np.searchsorted(world["time_s"], times, side="right") - 1] <= 0.0
    free_s = times[outside]
    if len(free_s) < _MIN_DRIFT_S * _RATE_HZ or free_s[-1] - free_s[0] < _MIN_SPAN_S:
        return None
    terms = np.column_stack([np.ones(len(times)), times, *travels])[outside]
    slope = float(_least_absolute(terms, apart[outside])[1])
    return slope if np.isfinite(slope) else None


def _direction(device: Columns, wall: WallOrSolid | None) -> Array:
    if wall is not None:
        return np.array(normal_where_deepest(wall, device["position_m"]))
    extent = np.ptp(device["position_m"], axis=0)
    return np.asarray(np.eye(len(extent))[int(np.argmax(extent))])


def _least_absolute(terms: Array, values: Array) -> Array:
    """The weights (m,) with which `terms` (N, m) best fit `values` (N,), by iteratively reweighted least squares."""
    found = np.linalg.lstsq(terms, values, rcond=None)[0]
    floor = 1e-6 * float(np.abs(values).max()) + 1e-12
    for _ in range(_ROUNDS):
        root = 1.0 / np.sqrt(np.maximum(np.abs(values - terms @ found), floor))
        found = np.linalg.lstsq(terms * root[:, None], values * root, rcond=None)[0]
    return np.asarray(found)
