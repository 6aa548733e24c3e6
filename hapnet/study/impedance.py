"""How stiff and how damped a wall feels at each frequency: a device is moved through a wall, and its force is measured.

The motion is imposed: the hand is so stiff that the device follows its reference, whatever the coupling does. It goes
10 mm into the wall and then through a multisine of 2 mm, 0.5 to 20 Hz. Only the device's own position and force are
used, as on hardware. `hapnet.metrics.impedance` has the sources.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from hapnet.assembly.build import prepare
from hapnet.checks import Vector
from hapnet.couplings.registry import coupling
from hapnet.couplings.spec import scalar_stiffness
from hapnet.errors import InvalidParameter
from hapnet.metrics.impedance import Curve, Line, Quartiles, harmonics_between, multisine, off_hz, transmitted
from hapnet.metrics.misses import quantile
from hapnet.params import Params
from hapnet.plant.operator import Impedance, minimum_jerk
from hapnet.plant.worlds.walls import Wall
from hapnet.simulation.simulation import Simulation

MIN_HZ, MOST_HZ, LINES = 0.5, 20.0, 20
DEPTH_M, AMPLITUDE_M = 0.010, 0.002
PERIOD_S = 4.0
IMPOSING = Impedance(0.5, 400.0, 1e5)
"""A hand that imposes its motion: 1 N moves it by 10 um."""

_APPROACH_S, _REST_S = 1.0, 1.0
HARMONICS = harmonics_between(MIN_HZ, MOST_HZ, PERIOD_S, LINES)


class Imposed:
    """A minimum-jerk move along `normal` to `DEPTH_M` inside the wall, a rest, and the multisine from then on.

    The multisine grows over its first period; the periods after that are for measuring.
    """

    def __init__(self, wall: Wall, start: Vector) -> None:
        self.impedance = IMPOSING
        self._start, self._normal = start, wall.normal
        self._path = DEPTH_M - wall.penetration(start)
        self._signal = multisine(HARMONICS, PERIOD_S, AMPLITUDE_M)

    def reference(self, t: float) -> Vector:
        along = self._path * minimum_jerk(t / _APPROACH_S)
        if (since := t - _APPROACH_S - _REST_S) > 0.0:
            along += minimum_jerk(since / PERIOD_S) * self._signal(since)
        return tuple([x + along * n for x, n in zip(self._start, self._normal, strict=True)])


@dataclass(frozen=True)
class Transmission:
    """The impedance that one run transmitted, the true one at the same frequencies, and where they differ.

    off_3dB_hz : the lowest frequency at which the two are 3 dB apart; None: not up to 20 Hz.
    """

    lines: tuple[Line, ...]
    truth: tuple[complex, ...]
    off_3dB_hz: float | None


def true_impedance(params: Params, wall: Wall, frequency_hz: float) -> complex:
    """What a hand would feel of `wall` at this frequency through the given springs, without delay or mass [N/m].

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


def transmission(params: Params, seed: int, periods: int = 4) -> Transmission:
    """Impose the motion on the first wall of the scene, and estimate the impedance over so many periods.

    The operator and the duration of `params` are not used. Two periods or more also give the estimates' spread.

    Raises HapnetError, netem.NetemError: the parameters do not make a run; InvalidParameter if the scene has no wall.
    """
    begin_s = _APPROACH_S + _REST_S + PERIOD_S
    servo = {"device.servo": "sampled"} if params.device.servo == "auto" else {}
    own = {"operator": "rest", "duration_s": begin_s + periods * PERIOD_S + 0.5, "record_hz": params.device.servo_hz}
    params = params.set({**servo, **own})
    setup = prepare(params, "sampled")
    params = setup.params
    if not setup.scene.walls:
        raise InvalidParameter("scene", params.scene, "one with a wall at rest, to be moved through")
    wall = setup.scene.walls[0]
    setup = replace(setup, hand=Imposed(wall, setup.scene.start))
    device = Simulation(params, seed, setup).run().recording.device
    assert device is not None, "a simulated run has both sides"
    normal, step_s = np.array(wall.normal), 1.0 / params.device.servo_hz
    first = round(begin_s / step_s)
    measured = slice(first, first + periods * round(PERIOD_S / step_s))
    along, resistance = device["position_m"][measured] @ normal, -(device["force_N"][measured] @ normal)
    lines = transmitted(along, resistance, step_s, PERIOD_S, HARMONICS)

    def truth(frequency_hz: float) -> complex:
        return true_impedance(params, wall, frequency_hz)

    return Transmission(tuple(lines), tuple(truth(line.frequency_hz) for line in lines), off_hz(lines, truth))


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
    )


def _quartiles(values: Iterable[float]) -> Quartiles:
    known = list(values)
    return Quartiles(quantile(known, 0.5), quantile(known, 0.25), quantile(known, 0.75))
