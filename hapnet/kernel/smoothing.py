"""Filters and predictors between reception and PSPM: `hapnet.control.smoothing`, `Silence` of hapnet.control.limits."""

from __future__ import annotations

from hapnet.records.equation import equation
from hapnet.records.record import Floats, OfAxes, Record
from hapnet.records.vectors import copy, low_pass


class Stages(Record):
    """The stages of one side.

    smoothing_s : time constant of the `SmoothingFilter`; 0: none. horizon_s, longest_s : of the `VelocityPredictor`; a
    horizon of 0: none. releases : is the policy at silence "release"?
    """

    smoothing_s: float
    has_state: int
    state: OfAxes
    horizon_s: float
    longest_s: float
    has_last: int
    last_s: float
    last: OfAxes
    has_velocity: int
    velocity: OfAxes
    age: float
    releases: int
    after: float
    elapsed: float


@equation
def step(n: int, stages: Stages, dt: float, y: Floats, fresh: bool, sent_s: float) -> None:
    """Replace y by the stages' output."""
    if stages.horizon_s > 0.0:
        _predict(n, stages, dt, y, fresh, sent_s)
    if stages.smoothing_s > 0.0:
        if not stages.has_state:
            copy(n, y, stages.state)
            stages.has_state = 1
        low_pass(n, dt, stages.smoothing_s, stages.state, y)
        copy(n, stages.state, y)


@equation
def silent(stages: Stages, dt: float, fresh: bool) -> bool:
    """`Silence.step`: is y to be released?"""
    stages.elapsed = 0.0 if fresh else stages.elapsed + dt
    return stages.releases != 0 and stages.elapsed > stages.after


@equation
def _predict(n: int, stages: Stages, dt: float, y: Floats, fresh: bool, sent_s: float) -> None:
    """`VelocityPredictor.step`."""
    stages.age += dt
    if fresh:
        if stages.has_last and sent_s < stages.last_s - stages.longest_s:
            stages.has_last = stages.has_velocity = 0
            stages.age = 0.0
        newer = stages.has_last == 0 or sent_s > stages.last_s
        if stages.has_last and newer:
            span = sent_s - stages.last_s
            for i in range(n):
                stages.velocity[i] = (y[i] - stages.last[i]) / span
            stages.has_velocity = 1
        if newer:
            stages.last_s = sent_s
            copy(n, y, stages.last)
            stages.has_last = 1
            stages.age = 0.0
    if stages.has_velocity:
        ahead = min(stages.horizon_s + stages.age, stages.longest_s)
        for i in range(n):
            y[i] = y[i] + ahead * stages.velocity[i]
