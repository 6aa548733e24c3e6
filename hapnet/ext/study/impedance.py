"""Stiffness and damping of a wall at each frequency: a device is moved inside a wall, and its force is measured.

The motion is imposed: the hand is so stiff that the device follows its reference with any coupling. It moves 10 mm into
the wall and then by a multisine of 2 mm, 0.5 to 20 Hz. Only the device's own position and force are used, as on
hardware. `hapnet.ext.metrics.impedance` has the sources, `hapnet.ext.study.tool_impedance` the motions of a tool.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from math import inf
from typing import NamedTuple

import numpy as np

from hapnet.assembly.build import Setup, prepare
from hapnet.checks import Array, Vector
from hapnet.couplings.registry import coupling
from hapnet.couplings.rendering import largest
from hapnet.couplings.spec import scalar_stiffness
from hapnet.errors import InvalidParameter
from hapnet.ext.metrics.impedance import (
    Curve,
    ImpedanceAtFrequency,
    Quartiles,
    harmonics_between,
    multisine,
    off_hz,
    transmitted,
)
from hapnet.ext.metrics.measured import quantile
from hapnet.params import DeviceParams, Params
from hapnet.plant.operator import Impedance, Operator, minimum_jerk
from hapnet.plant.worlds.walls import Wall
from hapnet.recording.samples import Recording
from hapnet.simulation.simulation import Simulation

MIN_HZ, MOST_HZ, LINES = 0.5, 20.0, 20
DEPTH_M, AMPLITUDE_M = 0.010, 0.002
PERIOD_S = 4.0
IMPOSING = Impedance(0.5, 400.0, 1e5)
"""A hand that imposes its motion: 1 N moves it by 10 um."""

_MOST_SHARE = 0.9
"""The share of the spring's largest force that the motion needs at most."""

_APPROACH_S, _REST_S = 1.0, 1.0
HARMONICS = harmonics_between(MIN_HZ, MOST_HZ, PERIOD_S, LINES)


_SIGNAL = multisine(HARMONICS, PERIOD_S, 1.0)


def approach(t: float) -> float:
    """The share of the way into the wall at t [s]: a minimum-jerk move, then a rest."""
    return minimum_jerk(t / _APPROACH_S)


def swing(t: float) -> float:
    """The multisine at t [s], at most 1. It grows during its first period; the later periods are measured."""
    since = t - _APPROACH_S - _REST_S
    return minimum_jerk(since / PERIOD_S) * _SIGNAL(since) if since > 0.0 else 0.0


def imposed_m(device: DeviceParams) -> tuple[float, float]:
    """Depth and amplitude of the motion [m]: `DEPTH_M` and `AMPLITUDE_M`, or less, so that no spring saturates."""
    most = _MOST_SHARE * device.spring_limit_N
    share = min(1.0, most / (largest(device.stiffness) * (DEPTH_M + AMPLITUDE_M))) if most else 1.0
    return share * DEPTH_M, share * AMPLITUDE_M


class Way(NamedTuple):
    """An imposed motion.

    hand : makes the motion. along : returns the device's position on the path in a recording (N,) [m or rad], and the
        force against it (N,) [N or Nm]. truth : returns the true impedance at a frequency [Hz].
    """

    hand: Operator
    along: Callable[[Recording], tuple[Array, Array]]
    truth: Callable[[float], complex]


class Imposed:
    """A hand that moves to a depth inside the wall [m], and there to and fro along the normal by an amplitude [m]."""

    def __init__(self, wall: Wall, start: Vector, depth: float, amplitude: float) -> None:
        self.impedance = IMPOSING
        self._start, self._normal = start, wall.normal
        self._path, self._amplitude = depth - wall.penetration(start), amplitude

    def reference(self, t: float) -> Vector:
        along = self._path * approach(t) + self._amplitude * swing(t)
        return tuple([x + along * n for x, n in zip(self._start, self._normal, strict=True)])


@dataclass(frozen=True)
class Transmission:
    """The impedance transmitted in a run, the true impedance at the same frequencies, and where the two differ.

    off_3dB_hz : the lowest frequency at which the two are 3 dB apart; None: not up to 20 Hz. turns : True for
        a rotation.
    """

    lines: tuple[ImpedanceAtFrequency, ...]
    truth: tuple[complex, ...]
    off_3dB_hz: float | None
    turns: bool = False


def true_impedance(params: Params, wall: Wall, frequency_hz: float) -> complex:
    """Return the stiffness of `wall` that a hand would feel at this frequency through the given springs, without delay
    or mass [N/m].

    As `ideal_stiffness`, with the wall's damper beside its spring: ``K_w + j w B_w``. Raises InvalidParameter if the
    springs are no scalars.
    """
    K, K_world = scalar_stiffness(params), params.world.stiffness
    solid = wall.stiffness + 2j * math.pi * frequency_hz * wall.damping
    if not coupling(params.coupling).scaled:
        return K * solid / (K + solid)
    if not isinstance(K_world, float):
        raise InvalidParameter("world.stiffness", K_world, "a number, to compute the true impedance of a wall")
    return K * solid / (K_world + solid)


def transmission(params: Params, seed: int, periods: int = 4, motion: str = "") -> Transmission:
    """Impose the motion on the first wall of the scene, and estimate the impedance over this number of periods.

    The operator and the duration of `params` are not used. Two periods or more also give the estimates' spread.
    motion : of a tool, a name in `hapnet.ext.study.tool_impedance`; empty: into the wall.

    Raises HapnetError, netem.NetemError: the parameters do not make a run; InvalidParameter if the scene has no wall.
    """
    from hapnet.ext.study import tool_impedance

    begin_s = _APPROACH_S + _REST_S + PERIOD_S
    servo = {"device.servo": "sampled"} if params.device.servo == "auto" else {}
    own = {"operator": "rest", "duration_s": begin_s + periods * PERIOD_S + 0.5, "record_hz": params.device.servo_hz}
    setup = prepare(params.set({**servo, **own}), "sampled")
    path = tool_impedance.path_of(setup, motion) if motion else _into_the_wall(setup)
    recording = Simulation(setup.params, seed, replace(setup, hand=path.hand)).run().recording
    step_s = 1.0 / setup.params.device.servo_hz
    first = round(begin_s / step_s)
    measured = slice(first, first + periods * round(PERIOD_S / step_s))
    along, resistance = path.along(recording)
    lines = transmitted(along[measured], resistance[measured], step_s, PERIOD_S, HARMONICS)
    turns = bool(motion) and tool_impedance.turns(motion)
    truth = tuple(path.truth(line.frequency_hz) for line in lines)
    return Transmission(tuple(lines), truth, off_hz(lines, path.truth), turns)


def _into_the_wall(setup: Setup) -> Way:
    if not setup.scene.walls:
        allowed = "one with a wall at rest, to be moved through, or a tool among solids"
        raise InvalidParameter("scene", setup.params.scene, allowed)
    wall = setup.scene.walls[0]
    normal = np.array(wall.normal)

    def along(recording: Recording) -> tuple[Array, Array]:
        assert recording.device is not None, "a simulated run has both sides"
        return recording.device["position_m"] @ normal, -(recording.device["force_N"] @ normal)

    hand = Imposed(wall, setup.scene.start, *imposed_m(setup.params.device))
    return Way(hand, along, lambda hz: true_impedance(setup.params, wall, hz))


def curve(found: Sequence[Transmission]) -> Curve:
    """Medians and quartiles over these runs, at least one."""
    lines = list(zip(*(one.lines for one in found), strict=True))
    return Curve(
        tuple(at[0].frequency_hz for at in lines),
        tuple(_quartiles(line.stiffness for line in at) for at in lines),
        tuple(_quartiles(line.damping for line in at) for at in lines),
        tuple(_quartiles(abs(line.impedance) for line in at) for at in lines),
        found[0].truth,
        _quartiles(inf if one.off_3dB_hz is None else one.off_3dB_hz for one in found),
        found[0].turns,
    )


def _quartiles(values: Iterable[float]) -> Quartiles:
    known = list(values)
    return Quartiles(quantile(known, 0.5), quantile(known, 0.25), quantile(known, 0.75))
