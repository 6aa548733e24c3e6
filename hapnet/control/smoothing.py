"""Filters and predictors between reception and PSPM.

PSPM accepts any discrete sequence of set-positions, so processing them first cannot break passivity (end of Sec. 3).
Each stage is stepped once per update, before PSPM, in the order given.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from hapnet import checks
from hapnet.checks import Vector
from hapnet.records.record import AXES, Floats, OfAxes, Reals, Record, compiled_as, equation
from hapnet.records.vectors import copy


class Stage(Protocol):
    """A processing stage of the received set-position."""

    def reset(self, position: Vector) -> None:
        """Start again at rest at `position` [m]."""

    def step(self, dt: float, y: Vector, sent_s: float | None) -> Vector:
        """The stage's output [m], `dt` seconds after the last one.

        `y` is the newest sample, or the output of the previous stage. `sent_s` is the time at which the sample was sent
        [s], on its sender's clock; None if no new sample has arrived since the last step.
        """


def low_passed(dt: float, time_constant: float, state: Vector, y: Vector) -> Vector:
    """One step of a first-order low-pass, ``y_f + dt / (tau + dt) (y - y_f)``.

    Backward Euler is stable for every dt [s] and never overshoots.
    """
    filtered = list(state)
    low_pass(len(filtered), dt, time_constant, filtered, y)
    return tuple(filtered)


@equation
def low_pass(n: int, dt: float, time_constant: float, state: Floats, y: Reals) -> None:
    """Make a step of a first-order low-pass in place: `low_passed`."""
    gain = dt / (time_constant + dt)
    for i in range(n):
        state[i] = state[i] + gain * (y[i] - state[i])


class FilteredVelocity(Record):
    """The velocity of a position, low-passed: ``(x - x_f) / tau``, with x_f the low-passed position.

    time_constant : tau [s], above 0. n : number of axes.

    Attributes
    ----------
    known : whether x_f is known. filtered : x_f [m]. velocity : of the last step [m/s].
    """

    time_constant: float
    known: int
    filtered: OfAxes
    velocity: OfAxes

    def __init__(self, time_constant: float, n: int = AXES) -> None:
        self.time_constant = checks.positive("time constant of a velocity", time_constant)
        self.known, self.filtered, self.velocity = 0, [0.0] * n, [0.0] * n

    def reset(self) -> None:
        """Start again at rest, at the next position."""
        self.known = 0

    def step(self, dt: float, x: Vector) -> Vector:
        """The velocity [m/s] at x [m], `dt` seconds after the last step."""
        filter_velocity(self, len(x), dt, x)
        return tuple(self.velocity)


@equation
def filter_velocity(f: FilteredVelocity, n: int, dt: float, x: Reals) -> None:
    """Filter the velocity of motion to x, `dt` seconds after the last step: `FilteredVelocity.step`."""
    if not f.known:
        copy(n, x, f.filtered)
        f.known = 1
    low_pass(n, dt, f.time_constant, f.filtered, x)
    for i in range(n):
        f.velocity[i] = (x[i] - f.filtered[i]) / f.time_constant


class SmoothingFilter(Record):
    """A first-order low-pass (`low_passed`): the smoothing filter of Figure 6.

    The paper gives its period (5 ms), not its equation.

    time_constant : tau [s], above 0.

    Attributes
    ----------
    has_state : whether there is a state yet. in_use : always 1, except in unused records of compiled code.
    """

    time_constant: float
    in_use: int
    has_state: int
    state: OfAxes

    def __init__(self, time_constant: float) -> None:
        super().__init__()
        self.time_constant = checks.positive("smoothing time constant", time_constant)
        self.in_use = 1

    def reset(self, position: Vector) -> None:
        self.has_state, self.state = 1, list(position)

    def step(self, dt: float, y: Vector, sent_s: float | None) -> Vector:
        if not self.has_state:
            self.reset(y)
        smooth(self, len(y), dt, out := list(y))
        return tuple(out)


@equation
def smooth(stage: SmoothingFilter, n: int, dt: float, y: Floats) -> None:
    """Smooth y in place: `SmoothingFilter.step`."""
    if not stage.has_state:
        copy(n, y, stage.state)
        stage.has_state = 1
    low_pass(n, dt, stage.time_constant, stage.state, y)
    copy(n, stage.state, y)


class VelocityPredictor(Record):
    """Constant-velocity extrapolation of the last two samples, by a horizon plus the time since the last one.

    The velocity is computed from the sender's time stamps, so jitter does not disturb it and no common clock is needed.

    horizon : time to predict beyond the sample's arrival [s], for example the link's delay; 0 or above.
    maximum : the longest extrapolation [s], however long the silence.

    Attributes
    ----------
    last, last_s : the newest sample [m], and its time of sending [s]; has_last : whether there is a sample.
    velocity : between the last two samples [m/s]; has_velocity : whether there are two. age : time since the newest
        sample came [s]. in_use : as in `SmoothingFilter`.
    """

    horizon: float
    maximum: float
    in_use: int
    has_last: int
    last_s: float
    last: OfAxes
    has_velocity: int
    velocity: OfAxes
    age: float

    def __init__(self, horizon: float, maximum: float = 0.2) -> None:
        super().__init__()
        self.horizon = checks.non_negative("predictor horizon", horizon)
        self.maximum = checks.positive("predictor limit", maximum)
        self.in_use = 1

    def reset(self, position: Vector) -> None:
        self.has_last = self.has_velocity = 0
        self.age = 0.0
        self.last, self.velocity = list(position), [0.0] * len(position)

    def step(self, dt: float, y: Vector, sent_s: float | None) -> Vector:
        if len(self.last) < len(y):
            self.reset(y)
        extrapolate(self, len(y), dt, out := list(y), sent_s is not None, sent_s or 0.0)
        return tuple(out)


@equation
def extrapolate(stage: VelocityPredictor, n: int, dt: float, y: Floats, fresh: bool, sent_s: float) -> None:
    """Extrapolate y in place: `VelocityPredictor.step`. fresh : whether y is a new sample, sent at `sent_s`."""
    stage.age += dt
    if fresh:
        if stage.has_last and sent_s < stage.last_s - stage.maximum:
            stage.has_last = stage.has_velocity = 0  # older than reordering explains: the sender's clock has restarted
            stage.age = 0.0
        newer = stage.has_last == 0 or sent_s > stage.last_s
        if stage.has_last and newer:
            span = sent_s - stage.last_s
            for i in range(n):
                stage.velocity[i] = (y[i] - stage.last[i]) / span
            stage.has_velocity = 1
        if newer:
            stage.last_s = sent_s
            copy(n, y, stage.last)
            stage.has_last = 1
            stage.age = 0.0
    if stage.has_velocity:
        ahead = min(stage.horizon + stage.age, stage.maximum)
        for i in range(n):
            y[i] = y[i] + ahead * stage.velocity[i]


class Pipeline(Record):
    """A chain of stages; an empty one is the identity.

    Attributes
    ----------
    predictor, smoothing : the stages in compiled code, in this order; each may be unused.
    """

    predictor: VelocityPredictor
    smoothing: SmoothingFilter

    def __init__(self, stages: Iterable[Stage] = ()) -> None:
        super().__init__()
        self.stages: tuple[Stage, ...] = tuple(stages)
        for stage in self.stages:
            if isinstance(stage, VelocityPredictor):
                self.predictor = stage
            elif isinstance(stage, SmoothingFilter):
                self.smoothing = stage

    def reset(self, position: Vector) -> None:
        for stage in self.stages:
            stage.reset(position)

    def step(self, dt: float, y: Vector, sent_s: float | None) -> Vector:
        for stage in self.stages:
            y = stage.step(dt, y, sent_s)
        return y


def _compiled_step(stages: Pipeline, n: int, dt: float, y: Floats, fresh: bool, sent_s: float) -> None:
    if stages.predictor.in_use:
        extrapolate(stages.predictor, n, dt, y, fresh, sent_s)
    if stages.smoothing.in_use:
        smooth(stages.smoothing, n, dt, y)


@compiled_as(_compiled_step)
def step(stages: Pipeline, n: int, dt: float, y: Floats, fresh: bool, sent_s: float) -> None:
    """Pass y through all stages in place: `Pipeline.step`."""
    if stages.stages:
        y[:] = stages.step(dt, tuple(y), sent_s if fresh else None)
