"""Filters and predictors between reception and PSPM.

PSPM accepts any discrete sequence of set-positions, so processing them first cannot break passivity (end of Sec. 3).
Each stage is stepped once per update, before PSPM, in the order given.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from hapnet import checks
from hapnet.checks import Vector


class Stage(Protocol):
    """One step of data processing on the received set-position."""

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
    gain = dt / (time_constant + dt)
    return tuple([old + gain * (new - old) for old, new in zip(state, y, strict=True)])


class FilteredVelocity:
    """The velocity of a position, low-passed: ``(x - x_f) / tau``, with x_f the low-passed position.

    Parameters
    ----------
    time_constant : tau [s], above 0.
    """

    def __init__(self, time_constant: float) -> None:
        self.time_constant: float = checks.positive("time constant of a velocity", time_constant)
        self._filtered: Vector | None = None

    def reset(self) -> None:
        """Start again at rest, wherever the next position is."""
        self._filtered = None

    def step(self, dt: float, x: Vector) -> Vector:
        """The velocity [m/s] at x [m], `dt` seconds after the last step."""
        before = x if self._filtered is None else self._filtered
        filtered = self._filtered = low_passed(dt, self.time_constant, before, x)
        return tuple([(new - old) / self.time_constant for old, new in zip(filtered, x, strict=True)])


class SmoothingFilter:
    """A first-order low-pass (`low_passed`): the smoothing filter of Figure 6.

    The paper gives its period (5 ms), not its equation.

    Parameters
    ----------
    time_constant : tau [s], above 0.
    """

    def __init__(self, time_constant: float) -> None:
        self.time_constant: float = checks.positive("smoothing time constant", time_constant)
        self._state: Vector | None = None

    def reset(self, position: Vector) -> None:
        self._state = position

    def step(self, dt: float, y: Vector, sent_s: float | None) -> Vector:
        state = self._state if self._state is not None else y
        self._state = low_passed(dt, self.time_constant, state, y)
        return self._state


class VelocityPredictor:
    """Constant-velocity extrapolation of the last two samples, by a horizon plus the time since the last one.

    The velocity is computed from the sender's time stamps, so jitter does not disturb it and no common clock is needed.

    Parameters
    ----------
    horizon : how far to predict beyond the sample's arrival [s], for example the link's delay; 0 or above.
    longest : longest extrapolation [s], however long the silence.
    """

    def __init__(self, horizon: float, longest: float = 0.2) -> None:
        self.horizon: float = checks.non_negative("predictor horizon", horizon)
        self.longest: float = checks.positive("predictor limit", longest)
        self._last: tuple[float, Vector] | None = None
        self._velocity: Vector | None = None
        self._age = 0.0

    def reset(self, position: Vector) -> None:
        self._last = None
        self._velocity = None
        self._age = 0.0

    def step(self, dt: float, y: Vector, sent_s: float | None) -> Vector:
        self._age += dt
        if sent_s is not None:
            if self._last is not None and sent_s < self._last[0] - self.longest:
                self.reset(y)  # reordering never reaches so far back: this is the clock of a restarted sender
            if self._last is not None and sent_s > self._last[0]:
                span = sent_s - self._last[0]
                self._velocity = tuple([(new - old) / span for new, old in zip(y, self._last[1], strict=True)])
            if self._last is None or sent_s > self._last[0]:
                self._last = (sent_s, y)
                self._age = 0.0
        if self._velocity is None:
            return y
        ahead = min(self.horizon + self._age, self.longest)
        return tuple([value + ahead * rate for value, rate in zip(y, self._velocity, strict=True)])


class Pipeline:
    """A chain of stages; an empty one is the identity."""

    def __init__(self, stages: Iterable[Stage] = ()) -> None:
        self.stages: tuple[Stage, ...] = tuple(stages)

    def reset(self, position: Vector) -> None:
        for stage in self.stages:
            stage.reset(position)

    def step(self, dt: float, y: Vector, sent_s: float | None) -> Vector:
        for stage in self.stages:
            y = stage.step(dt, y, sent_s)
        return y
