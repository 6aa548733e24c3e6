"""The samples that the two ends of a coupling send to each other, in SI units."""

from __future__ import annotations

from typing import NamedTuple

from hapnet.checks import Vector
from hapnet.mechanics.plane import Plane


class PositionSample(NamedTuple):
    """A position [m], and how full its sender's reservoir is (`hapnet.control.reservoir_level`)."""

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

    total, total_s : the integral of all waves that its sender sent so far, this one included [sqrt(W) s], and the sum
        of their spans [s]. Of a received wave only; empty if its sender does not send it.
    """

    value: Vector
    span: float
    total: Vector = ()
    total_s: float = 0.0


class ProxySample(NamedTuple):
    """The virtual mass's position, and what its world knows of the place."""

    position: Vector
    """[m]"""
    aimed_s: float
    """The time on the device's clock for which the position stands [s]; 0: the world does not know."""
    force: Vector
    """Of the environment on the mass in the last step [N]; zero: it moves freely."""
    planes: tuple[Plane, ...] | None
    """The planes that it touches or is near; None: this world cannot send planes."""
    reach_m: float | None = None
    """There are no other planes within this distance of it [m]; None: not known."""
    level: float | None = None
    """How full the world's reservoir is (`hapnet.control.reservoir_level`); None: it does not report that."""


CouplingSample = Vector | PositionSample | MotionSample | PortSample | WaveSample | ProxySample
"""What one side sends to the other. A bare vector is a position [m]."""


def level_of(sample: CouplingSample) -> float | None:
    """How full the sender's reservoir is, if the sample says so."""
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
