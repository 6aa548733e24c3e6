"""Converts the content of the peer's stream messages to SI units for control, and back."""

from __future__ import annotations

import math

from hapnet.control.coupling import CouplingSample, MotionSample, PortSample, PositionSample, ProxySample, WaveSample
from hapnet.mechanics.plane import Plane
from hapnet.mechanics.pose_frame import Arms
from hapnet.records.record import equation
from hapnet.wire import messages
from hapnet.wire.fields import CURVATURES, EFFECTS, FRICTION, INTEGRAL, LEVEL, REACH

NANO = 1e-9


@equation
def energy_nJ(energy: float) -> int:
    """A port's energy [J] in nJ for a message, rounded down."""
    return max(0, math.floor(energy / NANO))


@equation
def span_ns(span: float) -> int:
    """A wave's span [s] in ns for a message."""
    return max(1, round(span / NANO))


@equation
def moment_ns(aimed_s: float) -> int:
    """The time for which a proxy is valid [s] in ns for a message."""
    return max(0, round(aimed_s / NANO))


def sample_of(message: messages.Motion | messages.Port | messages.Wave | messages.Proxy) -> CouplingSample:
    """The content of a message, in SI units."""
    match message:
        case messages.Motion():
            return MotionSample(message.position, message.velocity)
        case messages.Port():
            return PortSample(message.value, message.energy_nJ * NANO)
        case messages.Wave():
            total, total_ns = (message.more or {}).get(INTEGRAL, ((), 0))
            return WaveSample(message.wave, message.span_ns * NANO, total, total_ns * NANO)
        case messages.Proxy():
            more = message.more or {}
            planes = Plane.all_of(message.planes, more.get(CURVATURES), more.get(FRICTION), more.get(EFFECTS))
            aimed_s, reach_m, level = message.aimed_ns * NANO, more.get(REACH), more.get(LEVEL)
            return ProxySample(message.position, aimed_s, message.force, planes, reach_m, level)


def with_arms(arms: Arms, sample: CouplingSample) -> CouplingSample:
    """A sample of a pose, converted to arms of another length."""
    match sample:
        case ProxySample(position, _, force, planes, reach_m, _):
            turned = None if planes is None else tuple([arms.plane(one) for one in planes])
            least_m = None if reach_m is None else reach_m * min(1.0, arms.times)  # for any normal
            return sample._replace(
                position=arms.place(position), force=arms.force(force), planes=turned, reach_m=least_m
            )
        case PositionSample(position, level):
            return PositionSample(arms.place(position), level)
        case MotionSample() | PortSample() | WaveSample():
            raise TypeError("no law that holds a force on a robot sends motions, ports or waves")
        case _:
            return arms.place(sample)
