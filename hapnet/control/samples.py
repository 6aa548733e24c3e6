"""The samples that the two ends of a coupling send to each other, in SI units."""

from __future__ import annotations

from typing import NamedTuple

from hapnet.checks import Vector
from hapnet.mechanics.plane import Plane


class PositionSample(NamedTuple):
    """A position [m], and the level of its sender's reservoir (`hapnet.control.reservoir_level`)."""

    position: Vector
    level: float


class MotionSample(NamedTuple):
    """A position [m] and its velocity [m/s]."""

    position: Vector
    velocity: Vector


class PortSample(NamedTuple):
    """The signal at one port, a position [m] or a force [N], and the total energy put in there so far [J]."""

    value: Vector
    energy: float


class WaveSample(NamedTuple):
    """A wave variable [sqrt(W)], averaged over a time span [s].

    total, total_s : the integral of all waves sent so far, including this wave [sqrt(W) s], and the sum of their spans
        [s]. Only in a received wave; empty if its sender does not send it.
    """

    value: Vector
    span: float
    total: Vector = ()
    total_s: float = 0.0


class ProxySample(NamedTuple):
    """The virtual mass's position, and the surfaces around it."""

    position: Vector
    """Position of the virtual mass [m]."""
    aimed_s: float
    """The time on the device's clock for which the position holds [s]; 0: unknown."""
    force: Vector
    """Mean force of the environment on the mass in the last step [N]; zero: it moves freely."""
    planes: tuple[Plane, ...] | None
    """The planes that the mass touches or is near; None: this world cannot send planes."""
    reach_m: float | None = None
    """No other planes are within this distance of the mass [m]; None: unknown."""
    level: float | None = None
    """The level of the world's reservoir (`hapnet.control.reservoir_level`); None: it is not sent."""


CouplingSample = Vector | PositionSample | MotionSample | PortSample | WaveSample | ProxySample
"""A sample from one side to the other. A bare vector is a position [m]."""


def level_of(sample: CouplingSample) -> float | None:
    """The level of the sender's reservoir; None: the sample does not contain it."""
    match sample:
        case PositionSample(_, level) | ProxySample(_, _, _, _, _, level):
            return level
        case _:
            return None


def vector_of(sample: CouplingSample) -> Vector:
    """The vector in a sample: a position, a port's value or a wave."""
    match sample:
        case (
            PositionSample(vector, _)
            | MotionSample(vector, _)
            | PortSample(vector, _)
            | WaveSample(vector, _, _, _)
            | ProxySample(vector, _, _, _)
        ):
            return vector
        case _:
            return sample
