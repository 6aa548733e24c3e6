"""Benchmarks, by hand: ``python -m tests.benchmarks``. Medians of five, one core; beside each a bare reference."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np

from hapnet.control.pspm import SetPositionModulator
from hapnet.params import Params
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.scene import make_scene
from hapnet.runtime.virtual import Simulation


def median(once: Callable[[], float], rounds: int = 5) -> float:
    return statistics.median(once() for _ in range(rounds))


def simulated_per_second(words: dict[str, object], seconds: float = 60.0) -> float:
    simulation = Simulation(Params().set({"duration_s": seconds, **words}), seed=1)
    start = time.perf_counter()
    simulation.run()
    return seconds / (time.perf_counter() - start)


def microseconds(call: Callable[[], object], count: int = 5000) -> float:
    start = time.perf_counter()
    for _ in range(count):
        call()
    return (time.perf_counter() - start) / count * 1e6


def bare_substeps_per_second() -> float:
    """The reference: 4000 substeps of one axis written out, and nothing else, as simulated seconds a second."""
    x, v = 0.01, 0.0
    start = time.perf_counter()
    for _ in range(40_000):
        middle = (4000.0 * v - 235.0 * x) * 2e-4
        v = middle + middle - v
        x += 2.5e-4 * middle
    return 10.0 / (time.perf_counter() - start)


def main() -> None:
    for name, words in (
        ("simulation, 1-DOF", {"record_hz": 1.0}),
        ("simulation, 1-DOF, recording at 200 Hz", {}),
        ("simulation, 3-DOF box", {"scene": "box", "operator": "sine", "record_hz": 1.0}),
    ):
        print(f"{name:<42}{median(lambda words=words: simulated_per_second(words)):8.1f} times real time")  # type: ignore[misc]
    print(f"{'bare substeps, 1-DOF':<42}{median(bare_substeps_per_second):8.1f} times real time")

    rng = np.random.default_rng(1)
    root = rng.normal(size=(3, 3))
    m = SetPositionModulator(stiffness=root @ root.T * 50.0 + 10.0 * np.eye(3), position=np.zeros(3))
    x, y = (0.01, 0.0, -0.01), (0.1, 0.05, 0.02)

    def active() -> None:
        m.energy, m.set_position = 0.01, x
        m.modulate(y, x, 0.0, 0.0)

    scene = make_scene("wall", dof=3)
    mass = PassiveIntegrator(0.02, 14.0, 500.0, scene.start)
    print(f"{'PSPM update, 3-DOF general K, active':<42}{median(lambda: microseconds(active)):8.2f} us")
    step = median(lambda: microseconds(lambda: mass.step(0.01, (0.03, 0.0, 0.0), scene.contacts)))
    print(f"{'world step at the wall, 3-DOF':<42}{step:8.2f} us")


if __name__ == "__main__":
    main()
