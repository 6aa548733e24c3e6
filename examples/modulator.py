"""PSPM in a servo loop of your own: a set-position jumps, and the spring follows as far as energy allows."""

from __future__ import annotations

import numpy as np

from hapnet import SetPositionModulator

K = np.array([[100.0, 20.0], [20.0, 60.0]])  # N/m
B = 0.4  # Ns/m
MASS, DT = 0.05, 1e-3  # kg, s


def main() -> None:
    x, v = np.zeros(2), np.zeros(2)
    pspm = SetPositionModulator(stiffness=K, damping=B, ceiling=0.01, position=x)
    low, high = x, x
    for tick in range(1, 1001):
        force = -K @ (x - pspm.set_position) - B * v
        v = v + DT * force / MASS
        x = x + DT * v
        low, high = np.minimum(low, x), np.maximum(high, x)
        if tick % 5 == 0:  # the modulator's own clock: every 5 ms, with the newest set-position there is
            goal = np.array([0.03, -0.02]) if tick > 200 else np.zeros(2)
            r = pspm.update(set_position=goal, position=x, extremes=(low, high), interval=5 * DT)
            low, high = x, x
            if tick % 100 == 0:
                print(
                    f"{tick:4d} ms  goal {goal}  modulated {r.set_position.round(4)}  reservoir {1e3 * r.energy:.2f} mJ"
                )


if __name__ == "__main__":
    main()
