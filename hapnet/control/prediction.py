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

from typing import Annotated

from hapnet import checks
from hapnet.checks import Vector
from hapnet.params import ContactModelParams
from hapnet.records.record import (
    AXES,
    FloatRows,
    Floats,
    OfAxes,
    Reals,
    Record,
    equation,
)
from hapnet.records.vectors import copy

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


TRUST_M = 0.005
"""The distance that counts at the start as predicted rightly [m]: so the first predictions are used in full."""

TRUST_KEPT = 0.95
"""The share of the earlier predictions' weight that stays when a prediction is compared."""


class MotionPredictor(Record):
    """Fits a parabola to the positions received last, and extrapolates it as far as that has proved right.

    A hand that writes turns round within the time to predict, and the parabola then leads away from it. So one
    prediction after another is compared with the position that came: of the predicted travel d, the share

        trust = sum d . r / sum d . d,      0 <= trust <= 1

    is used, where r is the real travel: the share with the least squared error in the last `TRUST_KEPT`-weighted sums.

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
    trust : see above; right, whole : its sums [m^2]. due_s : the stamp for which the prediction under comparison holds
        [s], if one `is_compared`; begun, travel : its start [m] and its predicted travel [m].
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
    trust: float
    right: float
    whole: float
    is_compared: int
    due_s: float
    begun: OfAxes
    travel: OfAxes

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
        self.begun, self.travel, self.due_s = [], [], 0.0
        self.reset()

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
        self.start = self.count = self.fitted = self.is_compared = 0
        self.right = self.whole = TRUST_M * TRUST_M
        self.trust = 1.0

    def receive(self, position: Vector, sent_s: float) -> None:
        """Take in a position [m] with its sender's time stamp [s]; positions may arrive out of order."""
        n = len(position)
        if len(self.position) != n:
            self.make_room(n)
        note(self, n, position, sent_s)

    def make_room(self, n: int) -> None:
        """Allocate memory for positions with n axes."""
        self.places = [[0.0] * n for _ in range(MOST)]
        self.position, self.velocity, self.half, self.begun, self.travel = ([0.0] * n for _ in range(5))

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
    if p.is_compared and times[end] >= p.due_s:
        _compare(p, n, end)


@equation
def _compare(p: MotionPredictor, n: int, newest: int) -> None:
    """Compare the prediction with the position that came, and update the trust."""
    p.is_compared = 0
    at = newest
    while at > p.start and p.times[at - 1] >= p.due_s:
        at -= 1
    right = whole = 0.0
    for i in range(n):
        right += p.travel[i] * (p.places[at][i] - p.begun[i])
        whole += p.travel[i] * p.travel[i]
    p.right, p.whole = TRUST_KEPT * p.right + right, TRUST_KEPT * p.whole + whole
    p.trust = min(1.0, max(0.0, p.right / p.whole)) if p.whole > 0.0 else 1.0


@equation
def predict(p: MotionPredictor, n: int, ahead: float, out: Floats) -> float:
    """Put the predicted position into `out`; returns the time really predicted [s]: `MotionPredictor.at`."""
    fit(p, n)
    ahead = min(max(ahead, 0.0), p.maximum)
    curve = min(ahead, p.max_curve)
    square = curve * (2.0 * ahead - curve)  # a parabola up to max_curve, then its tangent
    compares = p.is_compared == 0 and ahead > 0.0
    for i in range(n):
        travel = p.velocity[i] * ahead + p.half[i] * square
        out[i] = p.position[i] + p.trust * travel
        if compares:
            p.begun[i], p.travel[i] = p.position[i], travel
    if compares:
        p.is_compared, p.due_s = 1, p.times[p.start + p.count - 1] + ahead
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
