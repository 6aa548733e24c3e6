"""Draws the effect of each part: the stages before PSPM render, PSPM keeps the bound where they are not enough.

python -m examples.pictures.credit --out DIR
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from examples.pictures.drawing import COUPLINGS, canvas, saved, thinned
from examples.pictures.lying import lying_planes
from hapnet.checks import Array
from hapnet.ext.pictures.style import DEVICE_COLOR, WORLD_COLOR
from hapnet.params import RELAXED_HAND, Params
from hapnet.recording.samples import Columns
from hapnet.simulation.simulation import Result, Simulation

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import SubFigure

OUT_COLOR = "#cb181d"
BY_PROPORTION_MJ = 100.0
"""Energies above this are drawn on a logarithmic scale, so that the bound is visible in each panel."""


@dataclass(frozen=True)
class Pair:
    """A case, run with the plain spring and with PSPM; its force is shown over the last `shown_s`."""

    about: str
    changes: Mapping[str, object]
    seed: int
    lies: bool = False
    shown_s: float = 10.0

    def run(self, coupling: str) -> Result:
        params = Params().set({"coupling": coupling, "device.servo": "sampled", **self.changes})
        simulation = Simulation(params, self.seed)
        if self.lies:
            scene: Any = simulation.world.scene
            scene.planes = lying_planes(np.random.default_rng(self.seed))
        return simulation.run()


FOUR_G = {"link.up": "4g", "link.down": "4g"}
FAR = {"link.up": "wan-intercontinental", "link.down": "wan-intercontinental"}
FREE = {**FOUR_G, **RELAXED_HAND, "scene": "free", "operator": "sine", "device.stiffness": 100.0}
UPPER = (
    Pair("no stages (rendering=paper)", {**FREE, "rendering": "paper"}, 1),
    Pair("stages (rendering=hapnet)", {**FREE, "rendering": "hapnet"}, 1),
)
LOWER = (
    Pair("each plane sent is false: 4g, light hand", {**FOUR_G, **RELAXED_HAND, "scene": "moving", "dof": 2}, 1, True),
    Pair(
        "a gyroid with friction: intercontinental, hand-6",
        {**FAR, "operator": "hand-6", "scene": "sdf:examples.fields:gyroid?friction=0.2", "duration_s": 20.0},
        3,
    ),
)


def energies_out(result: Result) -> tuple[Array, Array, Array]:
    """Times (N,) [s], and the energy that has come out at the hand's and the world's port until then (N,) [mJ].

    A port's work is its side's account without the shuffled energy.
    """
    recording, summary = result.recording, result.summary
    assert recording.device is not None
    assert recording.world is not None
    times = recording.world["time_s"]
    hand, world = (
        1e3 * ((side["sent_J"] - side["credited_J"] + side["margin_J"]) - (part["ledger"]["bound_J"] or 0.0))
        for side, part in ((recording.device, summary["device"]), (recording.world, summary["world"]))
    )
    before = np.searchsorted(recording.device["time_s"], times, side="right") - 1
    known = before >= 0
    return times[known], -hand[before[known]], -world[known]


def pair(figure: SubFigure, case: Pair) -> list[list[Axes]]:
    """Two columns of two panels: force over energy, the plain spring beside PSPM. Returns the panels, row by row."""
    figure.suptitle(case.about, fontsize=8.5)
    panels = figure.subplots(2, 2, sharey="row", height_ratios=(1.0, 1.15))
    for column, (coupling, name) in enumerate(COUPLINGS.items()):
        result = case.run(coupling)
        device = result.recording.device
        assert device is not None
        _force(panels[0, column], device, case.shown_s, name)
        _energy(panels[1, column], result)
    panels[0, 0].set_ylabel("force on the hand [N]")
    panels[1, 0].set_ylabel("energy that came out [mJ]")
    return [list(row) for row in panels]


def _force(panel: Axes, device: Columns, shown_s: float, name: str) -> None:
    force = device["force_N"]
    axis = int(np.argmax(np.mean(force * force, axis=0)))
    last = device["time_s"] > device["time_s"][-1] - shown_s
    rms = float(np.sqrt(np.mean(np.sum(force * force, axis=1))))
    panel.plot(device["time_s"][last], force[last, axis], color=DEVICE_COLOR, linewidth=0.7)
    panel.set_title(f"{name}: {rms:{'.2f' if rms >= 0.1 else '.3f'}} N rms", fontsize=8)
    panel.set_xlabel("time [s]", labelpad=1.0)


def _energy(panel: Axes, result: Result) -> None:
    theorem = result.summary["theorem"]
    bound, out = 1e3 * (theorem["bound_J"] or 0.0), 1e3 * (theorem["energy_out_J"] or 0.0)
    times, hand, world = energies_out(result)
    lines = ((hand, "hand's port", DEVICE_COLOR, "-"), (world, "world's port", WORLD_COLOR, (0, (5, 1.5))),
             (hand + world, "both", "black", "-."))  # fmt: skip
    for values, label, colour, style in lines:
        kept = thinned(values)
        panel.plot(times[kept], values[kept], label=label, color=colour, linestyle=style, linewidth=1.0)
    panel.axhline(bound, color=OUT_COLOR, linewidth=1.0, label=f"bound d² = {bound:.0f} mJ")
    passive = out <= bound
    words = f"at most {out:.0f} mJ" if passive else f"{out:.0f} mJ: not passive"
    panel.set_title(words, color="black" if passive else OUT_COLOR, fontsize=8)
    panel.set_yscale("symlog", linthresh=BY_PROPORTION_MJ, subs=(2, 5))
    panel.set_yticks((-1000.0, -100.0, 0.0, 100.0, 1000.0), ("-1000", "-100", "0", "100", "1000"))
    panel.set_ylim(-2000.0, 10_000.0)
    panel.set_xlabel("time [s]", labelpad=1.0)


def main() -> None:
    figure = canvas(180.0, 200.0)
    rows = figure.subfigures(2, 1, hspace=0.05)
    titles = (
        "With the stages a light hand moves freely over 4g (K 100 N/m)",
        "Where the stages are not enough, PSPM keeps the bound (both with the stages)",
    )
    drawn = []
    for row, title, cases in zip(rows, titles, (UPPER, LOWER), strict=True):
        row.suptitle(title, fontsize=9.5, fontweight="bold")
        drawn.append([pair(part, case) for part, case in zip(row.subfigures(1, 2, wspace=0.02), cases, strict=True)])
    (without, stages), _ = drawn
    stages[0][0].set_ylim(without[0][0].get_ylim())
    figure.legend(*without[1][0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    saved(figure, "credit.png")


if __name__ == "__main__":
    main()
