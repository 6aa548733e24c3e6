"""The steps of many worlds: when each ends, how long they have been, and how long the next ones will be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hapnet.checks import Array
from hapnet.side.endpoint import NANO
from hapnet.side.world import WorldState
from hapnet.simulation.batch.arrays import Index, Whole
from hapnet.simulation.batch.scenario import Scenario, walls

_BLOCK = 256


class WorldSteps:
    """One world a scenario; its running step ends at `due_ns`.

    `shift_ns`: time on a scenario's own clock when the batch's clock shows 0.
    """

    def __init__(self, scenarios: Sequence[Scenario], shift_ns: Whole) -> None:
        self._scenarios, self._shift_ns = scenarios, shift_ns
        states = [scenario.world.state() for scenario in scenarios]
        self.due_ns: Whole = np.array([scenario.step_due_ns for scenario in scenarios]) - shift_ns
        self._last_ns: Whole = np.array([state.last_ns for state in states]) - shift_ns
        self._steps = np.array([state.steps for state in states])
        self._stepped_s = np.array([state.stepped_s for state in states])
        self._longest_s = np.array([state.longest_step_s for state in states])
        self._lengths = np.zeros((len(scenarios), _BLOCK), dtype=np.int64)
        self._drawn = np.full(len(scenarios), _BLOCK)  # how many of these have been used
        self._before_draw: dict[int, Mapping[str, Any]] = {}

    def end(self, at: Index, now_ns: Whole) -> Array:
        """The running step of each of `at` ends, and the next begins: how long it has been [s]."""
        dt: Array = np.multiply(now_ns - self._last_ns[at], NANO, dtype=np.float64)
        self._last_ns[at] = now_ns
        self._steps[at] += 1
        self._stepped_s[at] += dt
        self._longest_s[at] = np.maximum(self._longest_s[at], dt)
        self.due_ns[at] = now_ns + self._next_ns(at)
        return dt

    def _next_ns(self, at: Index) -> Whole:
        drawn = self._drawn[at]
        for i in at[drawn == _BLOCK].tolist():
            self._draw(i)
        drawn = self._drawn[at]
        self._drawn[at] = drawn + 1
        lengths: Whole = self._lengths[at, drawn]
        return lengths

    def _draw(self, i: int) -> None:
        """The lengths of scenario i's next steps [ns], as its scene draws them one at a time."""
        scene, rng = walls(self._scenarios[i]), self._scenarios[i].world.rng
        self._before_draw[i] = rng.bit_generator.state
        seconds = np.minimum(scene.max_s, scene.min_s + (scene.max_s - scene.min_s) * rng.random(_BLOCK))
        self._lengths[i] = np.maximum(1, np.rint(seconds / NANO).astype(np.int64))
        self._drawn[i] = 0

    def write_back(self, i: int) -> None:
        """Write scenario i's state back, its generator as if the used lengths had been drawn one at a time."""
        world = self._scenarios[i].world
        if i in self._before_draw:
            world.rng.bit_generator.state = self._before_draw.pop(i)
            world.rng.random(int(self._drawn[i]))
        last_ns = int(self._last_ns[i] + self._shift_ns[i])
        world.restore(WorldState(int(self._steps[i]), float(self._stepped_s[i]), float(self._longest_s[i]), last_ns))
