"""The world's y: the device's position, predicted for the time when the proxy gets there."""

from __future__ import annotations

from collections.abc import Sequence

from hapnet import checks
from hapnet.checks import Vector
from hapnet.control.coupling import CouplingSample, vector_of
from hapnet.control.prediction import STEP_GAIN, MotionPredictor, depth_ahead, note, predict
from hapnet.mechanics.plane import Plane
from hapnet.records.record import PLANES, OfAxes, OfPlanes, Reals, Record, VectorsOfPlanes, equation
from hapnet.records.vectors import dot


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
    share : of the time to predict that is used, 0 to 1; 1 at the start. y : the last y [m]. age : of the newest
        position [s]; fresh : whether a position has come since the last step. mean_step : of the world's steps [s].
    aimed_s : the time for which y is predicted, on the device's clock [s], if it `has_aimed`. around : the planes
        around the mass. goal, place : temporary memory for positions. in_use : always 1, except in unused records of
        compiled code.
    """

    in_use: int
    predictor: MotionPredictor
    lag: float
    stop_s: float
    share: float
    y: OfAxes
    age: float
    fresh: int
    mean_step: float
    has_aimed: int
    aimed_s: float
    around: Around
    goal: OfAxes
    place: OfAxes

    def __init__(self, position: Vector, lag: float, predictor: MotionPredictor, stop_s: float = 0.0) -> None:
        self.in_use = 1
        self.lag = lag
        self.predictor = predictor
        self.stop_s = checks.non_negative("stop_s", stop_s)
        self.share = 1.0
        self.around = Around()
        self.around.normal = [[0.0] * len(position) for _ in range(PLANES)]
        self.reset(position)

    def reset(self, position: Vector) -> None:
        """Forget the device's motion, as the device was replaced. y continues at `position` [m]."""
        self.predictor.reset()
        self.y, self.goal, self.place = list(position), list(position), list(position)
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
    ahead = predict(p, n, predicted.share * (predicted.age + predicted.lag + predicted.mean_step / 2.0), predicted.y)
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
    p.is_compared = 0  # what a wall stops says nothing about the hand
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
