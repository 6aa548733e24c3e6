"""Generated hands, and tremor. Each generated hand has its own motion and impedance, so that nothing is tuned to one
hand.

A hand reaches from place to place with minimum jerk (Flash, Hogan 1985), into the wall and out of it, along the wall in
between, and rests at each place. Its number is the seed of all of this: hand 5 is the same everywhere.

A tremor has 8 to 12 Hz (Deuschl, Bain, Brin 1998), and a few tenths of a millimetre.
"""

from __future__ import annotations

from bisect import bisect_right
from math import pi, sin
from typing import NamedTuple

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.plant.operator import Impedance, Operator, minimum_jerk, minimum_jerks
from hapnet.records.vectors import added

LASTS_S = 60.0
"""Length of the motion before it repeats [s]."""

OUTSIDE_M, INSIDE_M = (-0.02, 0.01), (0.025, 0.045)
"""Ranges of the hand's targets in front of the wall and behind it, along its normal from the start [m]. The wall is at
20 mm by default; the hand is soft and stops short of its target, but it touches such a wall."""

ALONG_M = 0.02
"""Range of its motion along the wall, in both directions [m]."""

REACH_S, TOUCH_S, PAUSE_S = (0.35, 1.2), (0.2, 1.5), (0.1, 0.6)
"""Ranges of the duration of a motion, a touch and a pause [s]."""

FIRST_PAUSE_S = 0.5


class _Reach(NamedTuple):
    begin_s: float
    span_s: float
    start: Vector
    goal: Vector


class GeneratedHand:
    """An operator with random motion and impedance.

    rng : draws everything. normal : (n,) of the wall. relaxed, firm : the impedance is drawn between these.
    scale : factor of its motion; for joints, radians per metre.
    """

    def __init__(
        self, rng: np.random.Generator, normal: Vector, relaxed: Impedance, firm: Impedance, scale: float = 1.0
    ) -> None:
        share = float(rng.random())
        self.impedance: Impedance = Impedance(
            relaxed.mass * (firm.mass / relaxed.mass) ** share,
            relaxed.damping * (firm.damping / relaxed.damping) ** share,
            relaxed.stiffness * (firm.stiffness / relaxed.stiffness) ** share,
        )
        self._reaches = _reaches(rng, np.array(normal), scale)
        self._begins = [reach.begin_s for reach in self._reaches]

    def reference(self, t: float) -> Vector:
        """The hand's target at time t [s], (n,) [m]."""
        t %= LASTS_S
        reach = self._reaches[bisect_right(self._begins, t) - 1]
        share = (t - reach.begin_s) / reach.span_s
        if share >= 1.0:
            return reach.goal
        s = minimum_jerk(share)
        return tuple([a + s * (b - a) for a, b in zip(reach.start, reach.goal, strict=True)])

    def path(self, times: Array) -> Array:
        """`reference` at many times (N,) [s], (N, n) [m]."""
        t = times % LASTS_S
        which = np.searchsorted(self._begins, t, side="right") - 1
        begins, spans = (np.array([one[k] for one in self._reaches])[which] for k in (0, 1))
        starts, goals = (np.array([one[k] for one in self._reaches])[which] for k in (2, 3))
        share = ((t - begins) / spans)[:, None]
        return np.where(share >= 1.0, goals, starts + minimum_jerks(share) * (goals - starts))


def _reaches(rng: np.random.Generator, normal: np.ndarray, scale: float) -> list[_Reach]:
    home = (0.0,) * len(normal)
    reaches = [_Reach(0.0, FIRST_PAUSE_S, home, home)]
    place, t, inside = home, FIRST_PAUSE_S, True
    while t < LASTS_S - 3.0 * REACH_S[1]:
        depth = rng.uniform(*(INSIDE_M if inside else OUTSIDE_M))
        aside = rng.uniform(-ALONG_M, ALONG_M, len(normal))
        goal = tuple((scale * (depth * normal + aside - normal * (normal @ aside))).tolist())
        span = rng.uniform(*REACH_S)
        reaches.append(_Reach(t, span, place, goal))
        place, inside = goal, not inside
        t += span + rng.uniform(*(PAUSE_S if inside else TOUCH_S))
    reaches.append(_Reach(t, REACH_S[1], place, home))
    return reaches


HERTZ = (8.3, 9.4, 10.7, 11.9)
"""Frequencies that are not multiples of each other, so that the tremor waxes and wanes."""


class Tremor:
    """An operator with a tremor along every axis of its reference.

    hand : the operator. amplitude : maximum distance from its reference, on each axis [m].
    """

    def __init__(self, hand: Operator, amplitude: float) -> None:
        self.impedance: Impedance = hand.impedance
        self._hand = hand
        self._each = amplitude / len(HERTZ)

    def reference(self, t: float) -> Vector:
        """The hand's target at time t [s], (n,) [m]."""
        intended = self._hand.reference(t)
        return tuple(
            [
                x + self._each * added([sin(2.0 * pi * f * t + axis + f) for f in HERTZ])
                for axis, x in enumerate(intended)
            ]
        )
