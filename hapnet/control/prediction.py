"""Predicts the device's motion for the world's end of a coupling.

The world receives positions late and in uneven steps. Its proxy follows a set-position with a lag of its own: with the
implicit integrator this lag is B'/K' + T/2 in steps of T (theory: a ramp through one step of L_dp). So the predictor
predicts by the sample's age plus that lag, and the proxy is then at the device's present position.

A parabola is fitted to all positions of the last 36 ms by least squares. With a single position per step, the velocity
would depend on two noisy time stamps. A prediction is only another y(k), so it cannot break passivity (end of Sec. 3).

A wall stops the hand, but a parabola continues into the wall and bounces back out of it, and each time the wall
dissipates energy that the hand has not paid for. So along the normal of a plane that the world sends, the predicted
motion behind the plane dies away (`depth_ahead`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from hapnet import checks
from hapnet.checks import Vector
from hapnet.control.coupling import CouplingSample, vector_of
from hapnet.mechanics.plane import Plane
from hapnet.params import ContactModelParams
from hapnet.records.record import (
    AXES,
    PLANES,
    FloatRows,
    Floats,
    OfAxes,
    OfPlanes,
    Reals,
    Record,
    VectorsOfPlanes,
    equation,
)
from hapnet.records.vectors import copy, dot

_DEFAULTS = ContactModelParams()

SHORTEST_SPAN_S = 0.01
"""The shortest time span of positions for a velocity [s]; a parabola needs three times as much."""

MOST = 1024
"""The most positions in a predictor's window; it keeps the newest."""

STEP_GAIN = 0.1
"""Gain of the running mean of the world's steps, which replaces the next step: that is unknown when y is chosen."""


@equation
def depth_ahead(depth: float, free: float, speed: float, ahead: float, stop_s: float) -> float:
    """The predicted depth of a hand behind a plane that stops it [m]; below 0: in front of it (ours).

    Behind the plane a travel v t shrinks to v t / (1 + t/tau), in both directions; in front of it nothing changes.

    depth : of the newest position [m]. free : depth as predicted without the plane [m]; either must be above 0.
    speed : into the plane, at the newest position [m/s]. ahead : time to predict [s], above 0 unless depth is above 0.
    stop_s : tau [s].
    """
    if depth <= 0.0:
        inside = ahead * free / (free - depth)
        return free / (1.0 + inside / stop_s)
    stopped = depth + speed * ahead / (1.0 + ahead / stop_s)
    if stopped >= 0.0:
        return stopped
    return speed * (ahead - depth / (-speed - depth / stop_s))


class MotionPredictor(Record):
    """Fits a parabola to the positions received last, and extrapolates it.

    Parameters
    ----------
    window : time span of the fit, back from the newest position [s].
    maximum : the longest time to predict [s]; a hand may change its motion within its reaction time.
    max_curve : the longest time for which the acceleration continues [s]; after it the velocity is constant.

    Attributes
    ----------
    times, places : from `start` on, `count` positions [m] with their stamps [s], the newest last.
    position, velocity, half : the fit at the newest stamp: position, velocity, half of the acceleration, if it is
        `fitted`. first, second : temporary memory for the polynomials of the fit.
    """

    window: float
    maximum: float
    max_curve: float
    start: int
    count: int
    times: Annotated[Floats, (MOST,)]
    places: Annotated[FloatRows, (MOST, AXES)]
    fitted: int
    position: OfAxes
    velocity: OfAxes
    half: OfAxes
    first: Annotated[Floats, (MOST,)]
    second: Annotated[Floats, (MOST,)]

    def __init__(
        self,
        window: float = _DEFAULTS.window_s,
        maximum: float = _DEFAULTS.longest_s,
        max_curve: float = _DEFAULTS.curve_s,
    ) -> None:
        self.window = checks.positive("window", window)
        self.maximum = checks.positive("maximum", maximum)
        self.max_curve = checks.non_negative("max_curve", max_curve)
        self.times, self.first, self.second = ([0.0] * MOST for _ in range(3))
        self.places, self.position, self.velocity, self.half = [], [], [], []
        self.start = self.count = self.fitted = 0

    @property
    def newest(self) -> tuple[Vector, Vector]:
        """Position [m] and velocity [m/s] at the newest stamp, as fitted; there must be a position."""
        fit(self, len(self.position))
        return tuple(self.position), tuple(self.velocity)

    @property
    def newest_s(self) -> float | None:
        """The time of sending of the newest position, on its sender's clock [s]; None: no position."""
        return self.times[self.start + self.count - 1] if self.count else None

    def reset(self) -> None:
        """Forget all positions, as their sender was replaced."""
        self.start = self.count = self.fitted = 0

    def receive(self, position: Vector, sent_s: float) -> None:
        """Take in a position [m] with its sender's time stamp [s]; positions may arrive out of order."""
        n = len(position)
        if len(self.position) != n:
            self.make_room(n)
        note(self, n, position, sent_s)

    def make_room(self, n: int) -> None:
        """Allocate memory for positions with n axes."""
        self.places = [[0.0] * n for _ in range(MOST)]
        self.position, self.velocity, self.half = ([0.0] * n for _ in range(3))

    def at(self, ahead: float) -> tuple[Vector, float]:
        """The position `ahead` seconds after the newest, and the time that was really predicted [s].

        There must be a position. The prediction is limited to `maximum` seconds.
        """
        predicted = list(self.position)
        ahead = predict(self, len(predicted), ahead, predicted)
        return tuple(predicted), ahead


@equation
def note(p: MotionPredictor, n: int, position: Reals, sent_s: float) -> None:
    """Take in a position and its sender's time stamp: `MotionPredictor.receive`."""
    times, places = p.times, p.places
    end = p.start + p.count
    at = end
    if p.count and sent_s <= times[end - 1]:
        if sent_s < times[end - 1] - p.window:
            return
        while at > p.start and times[at - 1] >= sent_s:
            if times[at - 1] == sent_s:
                return
            at -= 1
    if end == MOST:
        if p.start == 0:  # the oldest is dropped, whatever the window
            if at == 0:
                return
            p.start, p.count = 1, p.count - 1
        for k in range(p.count):
            times[k] = times[p.start + k]
            copy(n, places[p.start + k], places[k])
        at -= p.start
        p.start, end = 0, p.count
    for k in range(end, at, -1):
        times[k] = times[k - 1]
        copy(n, places[k - 1], places[k])
    times[at] = sent_s
    copy(n, position, places[at])
    p.count += 1
    while times[p.start] < times[end] - p.window:
        p.start += 1
        p.count -= 1
    p.fitted = 0


@equation
def predict(p: MotionPredictor, n: int, ahead: float, out: Floats) -> float:
    """Put the predicted position into `out`; returns the time really predicted [s]: `MotionPredictor.at`."""
    fit(p, n)
    ahead = min(max(ahead, 0.0), p.maximum)
    curve = min(ahead, p.max_curve)
    square = curve * (2.0 * ahead - curve)  # a parabola up to max_curve, then its tangent
    for i in range(n):
        out[i] = p.position[i] + p.velocity[i] * ahead + p.half[i] * square
    return ahead


@equation
def fit(p: MotionPredictor, n: int) -> None:
    """Fit position, velocity and half of the acceleration at the newest time, by least squares."""
    if p.fitted:
        return
    p.fitted = 1
    times, places, first, second = p.times, p.places, p.first, p.second
    start, count, stop = p.start, p.count, p.start + p.count
    newest_s = times[stop - 1]
    span = -(times[start] - newest_s)
    if span < SHORTEST_SPAN_S or count < 2:
        for i in range(n):
            p.position[i] = places[stop - 1][i]
            p.velocity[i] = p.half[i] = 0.0
        return
    # Orthogonal polynomials over the times: 1, t - mean, (t - mean)^2 - b (t - mean) - c.
    mean = 0.0
    for k in range(start, stop):
        mean += times[k] - newest_s
    mean = mean / count
    s2 = b = 0.0
    for k in range(start, stop):
        one = first[k] = (times[k] - newest_s) - mean
        s2 += one * one
        b += one * one * one
    b, c = b / s2, s2 / count
    s4 = 0.0
    for k in range(start, stop):
        one = first[k]
        two = second[k] = one * one - b * one - c
        s4 += two * two
    curved = count >= 4 and span >= 3.0 * SHORTEST_SPAN_S and s4 > 1e-9 * s2 * span * span
    for i in range(n):
        level = slope = half = 0.0
        for k in range(start, stop):
            x = places[k][i]
            level += x
            slope += first[k] * x
            half += second[k] * x
        level, slope, half = level / count, slope / s2, (half / s4 if curved else 0.0)
        # at t = 0, where t - mean = -mean
        p.position[i] = level - slope * mean + half * (mean * mean + b * mean - c)
        p.velocity[i] = slope + half * (-2.0 * mean - b)
        p.half[i] = half


class Around(Record):
    """The planes around the virtual mass."""

    count: int
    normal: VectorsOfPlanes
    offset: OfPlanes
    stiffness: OfPlanes
    velocity: OfPlanes


class PredictedDevice(Record):
    """Computes the world's y: the device's predicted position at the time when the proxy gets there.

    Parameters
    ----------
    position : of the mass at the start [m].
    lag : B'/K' [s]. predictor : predicts the device's motion. stop_s : time constant with which the predicted motion
        dies away behind a plane [s]; 0: planes change nothing.

    Attributes
    ----------
    y : the last y [m]. age : of the newest position [s]; fresh : whether a position has come since the last step.
    mean_step : of the world's steps [s]. aimed_s : the time for which y is predicted, on the device's clock [s], if it
        `has_aimed`. around : the planes around the mass. in_use : always 1, except in unused records of compiled code.
    """

    in_use: int
    predictor: MotionPredictor
    lag: float
    stop_s: float
    y: OfAxes
    age: float
    fresh: int
    mean_step: float
    has_aimed: int
    aimed_s: float
    around: Around

    def __init__(self, position: Vector, lag: float, predictor: MotionPredictor, stop_s: float = 0.0) -> None:
        self.in_use = 1
        self.lag = lag
        self.predictor = predictor
        self.stop_s = checks.non_negative("stop_s", stop_s)
        self.around = Around()
        self.around.normal = [[0.0] * len(position) for _ in range(PLANES)]
        self.reset(position)

    def reset(self, position: Vector) -> None:
        """Forget the device's motion, as the device was replaced. y continues at `position` [m]."""
        self.predictor.reset()
        self.y = list(position)
        self.age = self.mean_step = self.aimed_s = 0.0
        self.fresh = self.has_aimed = 0
        self.see(())

    def see(self, planes: Sequence[Plane]) -> None:
        """Set the planes around the virtual mass; the code that moves the mass must call this before each step."""
        around = self.around
        around.count = len(planes)
        for k, plane in enumerate(planes):
            around.normal[k][:] = plane.normal
            around.offset[k], around.velocity[k] = plane.offset_m, plane.velocity_mps

    @property
    def turn_s(self) -> float:
        """The approximate time from a motion of the device to its answer [s]: a round trip and a step."""
        return turn_s(self)

    def release(self, position: Vector) -> None:
        """Forget the device's motion, as `reset` does; y continues at `position` [m]."""
        self.reset(position)

    def receive(self, sample: CouplingSample, sent_s: float, age_s: float) -> None:
        """Take in the device's position and its age; see `CouplingState.receive`."""
        self.predictor.receive(vector_of(sample), sent_s)
        if sent_s == self.predictor.newest_s:
            self.age = age_s
            self.fresh = 1

    def step(self, dt: float, x: Vector) -> Vector:
        """y [m], `dt` seconds after the last step."""
        look_ahead(self, len(self.y), dt)
        return tuple(self.y)

    def stands_for(self, dt: float) -> float:
        """The time on the device's clock for which the proxy holds after a step of `dt` seconds [s]; 0: unknown."""
        return stands_for(self, dt)


@equation
def receive(predicted: PredictedDevice, n: int, position: Reals, sent_s: float, age_s: float) -> None:
    """Take in the device's position and its age: `PredictedDevice.receive`."""
    p = predicted.predictor
    note(p, n, position, sent_s)
    if p.count and sent_s == p.times[p.start + p.count - 1]:
        predicted.age = age_s
        predicted.fresh = 1


@equation
def look_ahead(predicted: PredictedDevice, n: int, dt: float) -> None:
    """Predict y, `dt` seconds after the last step: `PredictedDevice.step`."""
    ahead, around = aim(predicted, n, dt), predicted.around
    if predicted.stop_s != 0.0 and ahead != 0.0:
        for k in range(around.count):
            stop(predicted, n, around.normal[k], around.offset[k], around.velocity[k], ahead)


@equation
def aim(predicted: PredictedDevice, n: int, dt: float) -> float:
    """Compute `predicted.y` without planes; returns the time that is predicted [s], 0 without a position."""
    p = predicted.predictor
    if not predicted.fresh:
        predicted.age += dt
    predicted.fresh = 0
    before = predicted.mean_step
    predicted.mean_step = dt if before == 0.0 else before + STEP_GAIN * (dt - before)
    if not p.count:
        return 0.0
    ahead = predict(p, n, predicted.age + predicted.lag + predicted.mean_step / 2.0, predicted.y)
    predicted.aimed_s = p.times[p.start + p.count - 1] + ahead
    predicted.has_aimed = 1
    return ahead


@equation
def stop(predicted: PredictedDevice, n: int, normal: Reals, offset: float, velocity: float, ahead: float) -> None:
    """Let a plane stop y; a moving plane takes the hand along, so it changes nothing."""
    p = predicted.predictor
    depth, free = dot(n, normal, p.position) - offset, dot(n, normal, predicted.y) - offset
    if velocity != 0.0 or (depth <= 0.0 and free <= 0.0):
        return
    back = depth_ahead(depth, free, dot(n, normal, p.velocity), ahead, predicted.stop_s) - free
    for i in range(n):
        predicted.y[i] = predicted.y[i] + back * normal[i]


@equation
def turn_s(predicted: PredictedDevice) -> float:
    """The approximate time from a motion of the device to its answer [s]: `PredictedDevice.turn_s`."""
    return 2.0 * predicted.age + predicted.mean_step


@equation
def stands_for(predicted: PredictedDevice, dt: float) -> float:
    """The time on the device's clock for which the proxy holds [s]: `PredictedDevice.stands_for`."""
    return max(0.0, predicted.aimed_s - predicted.lag + dt / 2.0) if predicted.has_aimed else 0.0
