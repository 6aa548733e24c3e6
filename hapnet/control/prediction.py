"""Predicts the device's motion for the world's end of a coupling.

The world receives positions late and in uneven steps. Its proxy follows a set-position with a lag of its own: with the
implicit integrator it is B'/K' + T/2 behind in steps of T (theory: a ramp through one step of L_dp). So the predictor
aims ahead by the sample's age plus that lag, and the proxy then stands where the device is now.

A parabola is fitted to all positions of the last 36 ms by least squares. One position per step would leave the velocity
to two noisy time stamps. A prediction is only another y(k), so it cannot break passivity (end of Section 3).

A wall stops the hand, and a parabola does not know that: it runs on into the wall and bounces back out of it, and each
time the wall takes energy that the hand never paid. So along the normal of a plane that the world tells, motion behind
the plane is predicted to die away (`depth_ahead`).
"""

from __future__ import annotations

from bisect import bisect
from collections import deque
from collections.abc import Sequence
from operator import mul

from hapnet import checks
from hapnet.checks import Vector
from hapnet.control.coupling import CouplingSample, vector_of
from hapnet.mechanics.plane import Plane
from hapnet.params import ContactModelParams
from hapnet.records.equation import equation

_DEFAULTS = ContactModelParams()

SHORTEST_SPAN_S = 0.01
"""A velocity needs positions over this time [s]; a parabola needs three times as much."""

STEP_GAIN = 0.1
"""Of the running mean of the world's steps: the next step is not known when y is chosen."""


@equation
def depth_ahead(depth: float, free: float, speed: float, ahead: float, stop_s: float) -> float:
    """How deep a hand will be behind a plane that stops it [m]; below 0: in front of it (ours).

    Behind the plane a way v t shrinks to v t / (1 + t/tau), in both directions; in front of it nothing changes. Also
    compiled for the kernel, as it stands.

    Parameters
    ----------
    depth : of the newest position [m]. free : as predicted without the plane [m]; one of the two must be above 0.
    speed : into the plane, at the newest position [m/s]. ahead : how far ahead [s], above 0 if depth is not.
    stop_s : tau [s].
    """
    if depth <= 0.0:
        inside = ahead * free / (free - depth)
        return free / (1.0 + inside / stop_s)
    stopped = depth + speed * ahead / (1.0 + ahead / stop_s)
    if stopped >= 0.0:
        return stopped
    return speed * (ahead - depth / (-speed - depth / stop_s))


class MotionPredictor:
    """Fits the positions received lately, and continues the fitted motion.

    Parameters
    ----------
    window : how far back the fit reaches from the newest position [s].
    longest : limit of the prediction [s]; a hand may change its mind within its reaction time.
    longest_curve : for how long an acceleration is predicted to last [s]; beyond it the velocity stays.
    """

    def __init__(
        self,
        window: float = _DEFAULTS.window_s,
        longest: float = _DEFAULTS.longest_s,
        longest_curve: float = _DEFAULTS.curve_s,
    ) -> None:
        self.window: float = checks.positive("window", window)
        self.longest: float = checks.positive("longest", longest)
        self.longest_curve: float = checks.non_negative("longest_curve", longest_curve)
        self._stamps: deque[float] = deque()
        self._positions: deque[Vector] = deque()
        self._fit: tuple[Vector, Vector, Vector] | None = None

    @property
    def newest(self) -> tuple[Vector, Vector]:
        """Position [m] and velocity [m/s] at the newest stamp, as fitted; there must be a position."""
        if self._fit is None:
            self._fit = _parabola(self._stamps, self._positions)
        return self._fit[0], self._fit[1]

    @property
    def newest_s(self) -> float | None:
        """When the newest position was sent, on its sender's clock [s]; None: there is none."""
        return self._stamps[-1] if self._stamps else None

    def reset(self) -> None:
        """Forget all positions: their sender was replaced."""
        self._stamps.clear()
        self._positions.clear()
        self._fit = None

    def receive(self, position: Vector, sent_s: float) -> None:
        """A position arrived [m], with its sender's time stamp [s]. One that was overtaken is used as well."""
        stamps, positions = self._stamps, self._positions
        place = len(stamps)
        if stamps and sent_s <= stamps[-1]:
            if sent_s < stamps[-1] - self.window or sent_s in stamps:
                return
            place = bisect(stamps, sent_s)
        stamps.insert(place, sent_s)
        positions.insert(place, position)
        while stamps[0] < stamps[-1] - self.window:
            stamps.popleft()
            positions.popleft()
        self._fit = None

    def at(self, ahead: float) -> tuple[Vector, float]:
        """The position `ahead` seconds after the newest, and how far ahead that prediction really is [s].

        There must be a position. The prediction reaches at most `longest` ahead.
        """
        if self._fit is None:
            self._fit = _parabola(self._stamps, self._positions)
        ahead = min(max(ahead, 0.0), self.longest)
        curve = min(ahead, self.longest_curve)
        square = curve * (2.0 * ahead - curve)  # a parabola up to longest_curve, then its tangent
        position, velocity, half = self._fit
        predicted = [p + v * ahead + a * square for p, v, a in zip(position, velocity, half, strict=True)]
        return tuple(predicted), ahead


def _parabola(stamps: Sequence[float], positions: Sequence[Vector]) -> tuple[Vector, Vector, Vector]:
    """Position, velocity and half of the acceleration at the newest time, by least squares."""
    end, newest = stamps[-1], positions[-1]
    still = (0.0,) * len(newest)
    times = [stamp - end for stamp in stamps]
    span = -times[0]
    if span < SHORTEST_SPAN_S or len(times) < 2:
        return newest, still, still
    # Orthogonal polynomials over the times: 1, t - mean, (t - mean)^2 - b (t - mean) - c.
    count = len(times)
    mean = sum(times) / count
    first = [t - mean for t in times]
    squares = list(map(mul, first, first))
    s2 = sum(squares)
    b, c = sum(map(mul, squares, first)) / s2, s2 / count
    second = [square - b * p - c for p, square in zip(first, squares, strict=True)]
    s4 = sum(map(mul, second, second))
    curved = count >= 4 and span >= 3.0 * SHORTEST_SPAN_S and s4 > 1e-9 * s2 * span * span
    fitted: list[tuple[float, float, float]] = []
    for values in zip(*positions, strict=True):
        level = sum(values) / count
        slope = sum(map(mul, first, values)) / s2
        half = sum(map(mul, second, values)) / s4 if curved else 0.0
        # at t = 0, where t - mean = -mean
        fitted.append(
            (level - slope * mean + half * (mean * mean + b * mean - c), slope + half * (-2.0 * mean - b), half)
        )
    position, velocity, halves = zip(*fitted, strict=True)
    return position, velocity, halves


class PredictedDevice:
    """Computes the world's y: where the device will be when the proxy has followed.

    Parameters
    ----------
    position : the mass's at the start [m].
    lag : B'/K' [s]. predictor : predicts the device's motion. stop_s : time constant with which it dies away behind a
        plane [s]; 0: planes change nothing.
    """

    def __init__(self, position: Vector, lag: float, predictor: MotionPredictor, stop_s: float = 0.0) -> None:
        self._lag = lag
        self._predictor = predictor
        self._stop_s = checks.non_negative("stop_s", stop_s)
        self.reset(position)

    def reset(self, position: Vector) -> None:
        """Forget the device's motion: another has taken its place. y continues at `position` [m]."""
        self._predictor.reset()
        self._y = position
        self._age = 0.0
        self._fresh = False
        self._step = 0.0
        self._aimed_s: float | None = None
        self.planes: Sequence[Plane] = ()
        """What stands around the virtual mass; whoever moves the mass sets it before each step."""

    @property
    def turn_s(self) -> float:
        """How long it takes until the device has an answer to what it does, roughly [s]: a round trip and a step."""
        return 2.0 * self._age + self._step

    def release(self, position: Vector) -> None:
        """As `reset`."""
        self.reset(position)

    def receive(self, sample: CouplingSample, sent_s: float, age_s: float) -> None:
        """The device's position, and how old it is; see `CouplingState.receive`."""
        self._predictor.receive(vector_of(sample), sent_s)
        if sent_s == self._predictor.newest_s:
            self._age = age_s
            self._fresh = True

    def step(self, dt: float, x: Vector) -> Vector:
        """y [m], `dt` seconds after the last step."""
        if not self._fresh:
            self._age += dt
        self._fresh = False
        self._step = dt if not self._step else self._step + STEP_GAIN * (dt - self._step)
        newest_s = self._predictor.newest_s
        if newest_s is None:
            return self._y
        self._y, ahead = self._predictor.at(self._age + self._lag + self._step / 2.0)
        if self._stop_s and ahead:
            for plane in self.planes:
                self._y = self._stopped(self._y, plane, ahead)
        self._aimed_s = newest_s + ahead
        return self._y

    def _stopped(self, y: Vector, plane: Plane, ahead: float) -> Vector:
        """y, as the plane lets the hand go on; a plane that moves takes the hand with it, so it changes nothing."""
        position, velocity = self._predictor.newest
        depth, free = plane.depth(position), plane.depth(y)
        if plane.velocity_mps or (depth <= 0.0 and free <= 0.0):
            return y
        speed = sum(map(mul, plane.normal, velocity))
        back = depth_ahead(depth, free, speed, ahead, self._stop_s) - free
        return tuple([part + back * n for part, n in zip(y, plane.normal, strict=True)])

    def stands_for(self, dt: float) -> float:
        """The time on the device's clock for which the proxy stands after a step of `dt` seconds [s]; 0: unknown."""
        return 0.0 if self._aimed_s is None else max(0.0, self._aimed_s - self._lag + dt / 2.0)
