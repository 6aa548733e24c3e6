"""Hands as people move them: strokes with pauses that touch a wall or slide along it, and handwriting.

No rule of the library is tuned on these motions. The wall is at 20 mm on the first axis. Strokes go on
for `LASTS_S`.
"""

from __future__ import annotations

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.plant.operator import Impedance, Operator, minimum_jerks

WALL_M = 0.02
LASTS_S = 620.0

TREMOR_M, TREMOR_HZ = 3e-4, 9.3


class Strokes:
    """Minimum-jerk strokes, at times a pause, and a tremor of 0.3 mm.

    rng : draws the motion. touches : the share of strokes that end behind the wall; slides : of those along it.
    slowest, fastest : range of the peak speeds, log-uniform [m/s].
    """

    def __init__(
        self,
        dof: int,
        impedance: Impedance,
        rng: np.random.Generator,
        *,
        touches: float = 0.3,
        slides: float = 0.2,
        slowest: float = 0.05,
        fastest: float = 0.8,
    ) -> None:
        self.impedance = impedance
        now, at = 0.0, np.zeros(dof)
        rows: list[tuple[float, float, Array, Array]] = []
        while now < LASTS_S:
            speed, kind = np.exp(rng.uniform(np.log(slowest), np.log(fastest))), rng.random()
            to = rng.uniform(-0.06, 0.06, dof)
            if kind < touches:
                to[0] = rng.uniform(WALL_M + 0.002, 2.0 * WALL_M)
            elif kind < touches + slides:
                to[0] = at[0]
            else:
                to[0] = rng.uniform(-0.1, WALL_M / 2.0)
            far = float(np.linalg.norm(to - at))
            if far < 1e-3:
                continue
            span = max(1.875 * far / speed, 0.06)  # the peak of a minimum-jerk stroke is 1.875 times its mean speed
            rows.append((now, span, at, to))
            now, at = now + span, to
            if rng.random() < 0.3:
                pause = rng.uniform(0.05, 0.6)
                rows.append((now, pause, at, at))
                now += pause
        self._begin, self._span = (np.array([row[k] for row in rows]) for k in (0, 1))
        self._from, self._to = (np.array([row[k] for row in rows]) for k in (2, 3))

    def path(self, times: Array) -> Array:
        """`reference` at many times (N,) [s], (N, n) [m]."""
        at = np.clip(np.searchsorted(self._begin, times, side="right") - 1, 0, len(self._begin) - 1)
        share = minimum_jerks(np.clip((times - self._begin[at]) / self._span[at], 0.0, 1.0))[:, None]
        tremor = TREMOR_M * np.sin(2.0 * np.pi * TREMOR_HZ * times)[:, None]
        return np.asarray(self._from[at] + share * (self._to[at] - self._from[at]) + tremor)

    def reference(self, t: float) -> Vector:
        return tuple(self.path(np.array([t]))[0].tolist())


class Writing:
    """A pen that writes on the wall: letters of 2 to 6 Hz along it, and 1.1 times a second it is lifted by 6 mm.

    rng : draws the letters. On a single axis the pen only presses and lifts.
    """

    def __init__(self, dof: int, impedance: Impedance, rng: np.random.Generator) -> None:
        self.impedance, self.dof = impedance, dof
        self._hz, self._size = rng.uniform(2.0, 6.0, 6), rng.uniform(0.3, 1.0, 6)
        self._phase = rng.uniform(0.0, 2.0 * np.pi, (6, 3))

    def path(self, times: Array) -> Array:
        """`reference` at many times (N,) [s], (N, n) [m]."""
        places = np.zeros((len(times), self.dof))
        vigour = 0.5 + 0.5 * np.sin(2.0 * np.pi * 0.21 * times)
        places[:, 0] = 0.019 + 0.004 * np.clip(1.6 * np.sin(2.0 * np.pi * 1.1 * times + 0.3), -1.0, 0.75)
        for axis in range(1, self.dof):
            places[:, axis] = 0.03 * np.sin(2.0 * np.pi * 0.13 * times + axis)
            for hz, size, phase in zip(self._hz, self._size, self._phase, strict=True):
                places[:, axis] += 0.0035 * size * np.sin(2.0 * np.pi * hz * times + phase[axis % 3]) * vigour
        return np.asarray(places * np.clip(times / 2.0, 0.0, 1.0)[:, None])

    def reference(self, t: float) -> Vector:
        return tuple(self.path(np.array([t]))[0].tolist())


class Displaced:
    """A hand whose motion is displaced: to begin at `rest` (n,) [m] instead of the origin."""

    def __init__(self, hand: Operator, rest: Vector) -> None:
        self.impedance: Impedance = hand.impedance
        self._hand, self._rest = hand, rest

    def reference(self, t: float) -> Vector:
        return tuple([x + r for x, r in zip(self._hand.reference(t), self._rest, strict=True)])
