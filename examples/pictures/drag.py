"""Draws the drag of free motion over the speed of the hand, over 4g, with PSPM and with a plain spring.

python -m examples.pictures.drag --out DIR
"""

from __future__ import annotations

import numpy as np

from examples.pictures.drawing import COUPLINGS, canvas, saved
from hapnet import simulate
from hapnet.ext.metrics.motion import drag_by_speed
from hapnet.ext.pictures.style import COLOURS
from hapnet.plant.natural_hands import Strokes
from hapnet.plant.operator import Impedance

EDGES_MPS = tuple(float(one) for one in np.geomspace(0.05, 1.0, 11))
SEED, LASTS_S = 4201, 60.0


class Air(Strokes):
    """Strokes with peak speeds of 0.07 to 0.9 m/s that touch nothing."""

    def __init__(self, dof: int, impedance: Impedance) -> None:
        rng = np.random.default_rng(SEED)
        super().__init__(dof, impedance, rng, touches=0.0, slides=0.0, slowest=0.07, fastest=0.9)


def drags(coupling: str, rendering: str) -> list[float | None]:
    """The drag in each range of `EDGES_MPS` [N]."""
    result = simulate(
        {"coupling": coupling, "rendering": rendering, "operator": f"{__spec__.name}:Air", "scene": "free", "dof": 3,
         "link.up": "4g", "link.down": "4g", "duration_s": LASTS_S, "record_hz": 1000.0, "device.servo": "sampled"},
        seed=1,
    )  # fmt: skip
    found = drag_by_speed(result.recording, (), 0.0, EDGES_MPS)
    assert found is not None
    return found


def main() -> None:
    figure = canvas(140.0, 80.0)
    figure.suptitle("Drag in free motion over 4g, strokes of 0.07 to 0.9 m/s", fontsize=9.5, fontweight="bold")
    panel = figure.subplots()
    middles = np.sqrt(np.array(EDGES_MPS[1:]) * EDGES_MPS[:-1])
    for index, (rendering, style) in enumerate({"hapnet": "-", "paper": "--"}.items()):
        for (coupling, name), colour in zip(COUPLINGS.items(), (COLOURS[1], COLOURS[0]), strict=True):
            found = drags(coupling, rendering)
            values = [float("nan") if one is None else one for one in found]
            label = f"{name}, {'without' if index else 'with'} the stages"
            panel.plot(middles, values, style, color=colour, marker="o" if coupling == "pspm" else "x", label=label)
    panel.set(xlabel="speed [m/s]", ylabel="mean force against the motion [N]", xscale="log")
    panel.set_xticks((0.07, 0.1, 0.2, 0.5, 0.9), ("0.07", "0.1", "0.2", "0.5", "0.9"))
    panel.minorticks_off()
    panel.set_yscale("log")
    panel.set_yticks((0.01, 0.1, 1.0), ("0.01", "0.1", "1"))
    figure.legend(loc="outside lower center", ncols=2)
    saved(figure, "drag.png")


if __name__ == "__main__":
    main()
