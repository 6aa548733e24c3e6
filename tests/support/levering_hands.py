"""Hands that hold a tool with six degrees of freedom: they wander over a hole, jam a peg in it, and lever it.

No rule of the library was tuned on these motions. Each class is an operator, `tests.support.levering_hands:NAME`, for
a tool that starts above a hole whose mouth is 20 mm below, at the middle of the hand's motion.
"""

from typing import ClassVar

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.ext.tools.device import turned
from hapnet.plant.operator import Impedance, minimum_jerk

LONGEST_S = 620.0


class Reaching:
    """Minimum-jerk motions from pose to pose, with pauses.

    seed : of the motion. `goal` draws the next pose: a place (3,) [m] and a rotation vector (3,) [rad].
    """

    seed: ClassVar[int] = 0

    def __init__(self, dof: int, impedance: Impedance) -> None:
        self.impedance = impedance
        rng = np.random.default_rng(self.seed)
        now, at, count = 0.3, np.zeros(6), 0
        rows: list[tuple[float, float, Array, Array]] = [(0.0, now, at, at)]
        while now < LONGEST_S:
            to, span = self.goal(rng, count), rng.uniform(0.3, 1.2)
            rows.append((now, span, at, to))
            now, at, count = now + span + rng.uniform(0.0, 0.5), to, count + 1
        self._begins = np.array([row[0] for row in rows])
        self._rows = rows

    def goal(self, rng: np.random.Generator, count: int) -> Array:
        raise NotImplementedError

    def reference(self, t: float) -> Vector:
        """The pose (12,) [m] at t [s]."""
        begin, span, start, goal = self._rows[int(np.searchsorted(self._begins, t, side="right")) - 1]
        at = start + minimum_jerk(min(1.0, (t - begin) / span)) * (goal - start)
        return turned(tuple(at[:3].tolist()), tuple(at[3:].tolist()))


class Wandering(Reaching):
    """Over the hole and around it, against the block and off it, turned at random."""

    seed = 5101

    def goal(self, rng: np.random.Generator, count: int) -> Array:
        deep = rng.uniform(0.005, 0.03) if count % 2 == 0 else rng.uniform(-0.02, 0.0)
        return np.array([*rng.uniform(-0.02, 0.02, 2), -deep, *rng.uniform(-0.3, 0.3, 3)])


class Jamming(Reaching):
    """Pushes a tilted tool into the hole and pulls it out again."""

    seed = 5102

    def goal(self, rng: np.random.Generator, count: int) -> Array:
        inside = count % 3 != 2
        place = rng.uniform(-0.004, 0.004, 2) if inside else np.zeros(2)
        return np.array([*place, -rng.uniform(0.015, 0.03) if inside else 0.002, *rng.uniform(-0.25, 0.25, 3)])


class Levering(Reaching):
    """Inserts a tool, and levers in the hole: sideways and about all axes."""

    seed = 5103

    def goal(self, rng: np.random.Generator, count: int) -> Array:
        if count < 2:
            return np.array([0.0, 0.0, -0.02 * count, 0.0, 0.0, 0.0])
        return np.array([*rng.uniform(-0.015, 0.015, 2), -rng.uniform(0.01, 0.025), *rng.uniform(-0.3, 0.3, 3)])
