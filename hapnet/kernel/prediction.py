"""The world's prediction of the device: `hapnet.control.prediction`."""

from __future__ import annotations

from typing import Annotated

from hapnet.control import prediction as reference
from hapnet.control.prediction import depth_ahead
from hapnet.kernel.contact_model import Planes
from hapnet.records.equation import equation
from hapnet.records.record import AXES, FloatRows, Floats, OfAxes, Record
from hapnet.records.vectors import copy, dot

_SHORTEST_SPAN_S, _STEP_GAIN = reference.SHORTEST_SPAN_S, reference.STEP_GAIN

MOST = 1024
"""The most positions in a predictor's window."""


class PredictedDevice(Record):
    """The attributes of `PredictedDevice` and of its `MotionPredictor`.

    in_use : does the world predict? overflow : more positions came than there is room for.
    """

    in_use: int
    lag: float
    window: float
    longest: float
    longest_curve: float
    stop_s: float
    count: int
    overflow: int
    times: Annotated[Floats, (MOST,)]
    places: Annotated[FloatRows, (MOST, AXES)]
    fitted: int
    position: OfAxes
    velocity: OfAxes
    half: OfAxes
    y: OfAxes
    age: float
    fresh: int
    mean_step: float
    has_aimed: int
    aimed_s: float
    first: Annotated[Floats, (MOST,)]
    second: Annotated[Floats, (MOST,)]


@equation
def receive(predicted: PredictedDevice, n: int, position: Floats, sent_s: float, age_s: float) -> None:
    """`PredictedDevice.receive`."""
    _note(predicted, n, position, sent_s)
    if predicted.count and sent_s == predicted.times[predicted.count - 1]:
        predicted.age = age_s
        predicted.fresh = 1


@equation
def step(predicted: PredictedDevice, around: Planes, n: int, dt: float, out: Floats) -> None:
    """`PredictedDevice.step`: y into `out`. around : the planes that the world tells."""
    if not predicted.fresh:
        predicted.age += dt
    predicted.fresh = 0
    before = predicted.mean_step
    predicted.mean_step = dt if before == 0.0 else before + _STEP_GAIN * (dt - before)
    if predicted.count:
        ahead = _predict(predicted, n, predicted.age + predicted.lag + predicted.mean_step / 2.0)
        predicted.aimed_s = predicted.times[predicted.count - 1] + ahead
        predicted.has_aimed = 1
        if predicted.stop_s and ahead:
            for k in range(around.count):
                _stop(predicted, around, k, n, ahead)
    copy(n, predicted.y, out)


@equation
def turn_s(predicted: PredictedDevice) -> float:
    """`PredictedDevice.turn_s`."""
    return 2.0 * predicted.age + predicted.mean_step


@equation
def _stop(predicted: PredictedDevice, around: Planes, k: int, n: int, ahead: float) -> None:
    """`PredictedDevice._stopped` by plane k: changes `predicted.y`."""
    normal = around.normal[k]
    depth = dot(n, normal, predicted.position) - around.offset[k]
    free = dot(n, normal, predicted.y) - around.offset[k]
    if around.velocity[k] or (depth <= 0.0 and free <= 0.0):
        return
    back = depth_ahead(depth, free, dot(n, normal, predicted.velocity), ahead, predicted.stop_s) - free
    for i in range(n):
        predicted.y[i] = predicted.y[i] + back * normal[i]


@equation
def stands_for(predicted: PredictedDevice, dt: float) -> float:
    """`PredictedDevice.stands_for`."""
    return max(0.0, predicted.aimed_s - predicted.lag + dt / 2.0) if predicted.has_aimed else 0.0


@equation
def _note(predicted: PredictedDevice, n: int, position: Floats, sent_s: float) -> None:
    """`MotionPredictor.receive`."""
    times, places, count = predicted.times, predicted.places, predicted.count
    at = count
    if count and sent_s <= times[count - 1]:
        if sent_s < times[count - 1] - predicted.window:
            return
        while at and times[at - 1] >= sent_s:
            if times[at - 1] == sent_s:
                return
            at -= 1
    if count == MOST:
        predicted.overflow = 1
        return
    for k in range(count, at, -1):
        times[k] = times[k - 1]
        copy(n, places[k - 1], places[k])
    times[at] = sent_s
    for i in range(n):
        places[at][i] = position[i]
    count += 1
    old = 0
    while times[old] < times[count - 1] - predicted.window:
        old += 1
    if old:
        for k in range(old, count):
            times[k - old] = times[k]
            copy(n, places[k], places[k - old])
    predicted.count = count - old
    predicted.fitted = 0


@equation
def _predict(predicted: PredictedDevice, n: int, ahead: float) -> float:
    """`MotionPredictor.at`: the position into `predicted.y`; returns how far ahead it really is [s]."""
    if not predicted.fitted:
        _fit(predicted, n)
        predicted.fitted = 1
    ahead = min(max(ahead, 0.0), predicted.longest)
    curve = min(ahead, predicted.longest_curve)
    square = curve * (2.0 * ahead - curve)
    for i in range(n):
        predicted.y[i] = predicted.position[i] + predicted.velocity[i] * ahead + predicted.half[i] * square
    return ahead


@equation
def _fit(predicted: PredictedDevice, n: int) -> None:
    """`hapnet.control.prediction._parabola`."""
    times, places, count = predicted.times, predicted.places, predicted.count
    first, second = predicted.first, predicted.second
    end = times[count - 1]
    span = -(times[0] - end)
    if span < _SHORTEST_SPAN_S or count < 2:
        for i in range(n):
            predicted.position[i] = places[count - 1][i]
            predicted.velocity[i] = predicted.half[i] = 0.0
        return
    mean = 0.0
    for k in range(count):
        mean += times[k] - end
    mean = mean / count
    s2 = b = 0.0
    for k in range(count):
        p = first[k] = (times[k] - end) - mean
        s2 += p * p
        b += p * p * p
    b, c = b / s2, s2 / count
    s4 = 0.0
    for k in range(count):
        p = first[k]
        second[k] = p * p - b * p - c
        s4 += second[k] * second[k]
    curved = count >= 4 and span >= 3.0 * _SHORTEST_SPAN_S and s4 > 1e-9 * s2 * span * span
    for i in range(n):
        level = slope = half = 0.0
        for k in range(count):
            x = places[k][i]
            level += x
            slope += first[k] * x
            half += second[k] * x
        level, slope, half = level / count, slope / s2, (half / s4 if curved else 0.0)
        predicted.position[i] = level - slope * mean + half * (mean * mean + b * mean - c)
        predicted.velocity[i] = slope + half * (-2.0 * mean - b)
        predicted.half[i] = half
