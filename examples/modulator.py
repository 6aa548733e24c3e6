"""PSPM in a servo loop of your own: a set-position jumps, and the spring follows as far as energy allows.

The torque is held from tick to tick, so what was dissipated is measured (`MeasuredHarvest`): the paper's bound from the
position's range holds for a continuous damper only, and a held one is not.
"""

from __future__ import annotations

import numpy as np

from hapnet import SetPositionModulator
from hapnet.control.harvest import MeasuredHarvest

K = np.array([[100.0, 20.0], [20.0, 60.0]])  # N/m
B = 0.4  # Ns/m
MASS, DT = 0.05, 1e-3  # kg, s


def main() -> None:
    x, v, force = np.zeros(2), np.zeros(2), np.zeros(2)
    pspm = SetPositionModulator(stiffness=K, ceiling=0.01, position=x)
    harvest = MeasuredHarvest((0.0, 0.0))
    phi = 0.0
    for tick in range(1, 1001):
        before = x
        v = v + DT * force / MASS  # your device moves, and your encoders say where it is
        x = x + DT * v
        harvest.hold(tuple(force), tuple(before), tuple(x), DT)
        if tick % 5 == 0:  # the modulator's own clock: every 5 ms, with the newest set-position there is
            goal = np.array([0.03, -0.02]) if tick > 200 else np.zeros(2)
            dissipated = harvest.take(pspm.spring.potential(tuple(x - pspm.set_position)) - phi)
            r = pspm.update(set_position=goal, position=x, dissipated=dissipated)
            phi = pspm.spring.potential(tuple(x - r.set_position))
            if tick % 100 == 0:
                print(
                    f"{tick:4d} ms  goal {goal}  modulated {r.set_position.round(4)}  reservoir {1e3 * r.energy:.2f} mJ"
                )
        force = -K @ (x - pspm.set_position) - B * v


if __name__ == "__main__":
    main()
