"""Draws reservoirs, modulated share and free motion's error over ten minutes, with the energy economy and without.

python -m examples.pictures.ten_minutes --out DIR
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from examples.pictures.drawing import canvas, saved
from hapnet import simulate
from hapnet.checks import Array
from hapnet.ext.metrics.world import modulated_share
from hapnet.ext.pictures.style import DEVICE_COLOR, WORLD_COLOR
from hapnet.simulation.simulation import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LINKS = {"4g": "4g", "intercontinental": "wan-intercontinental"}
OPERATOR, SEED, SECONDS, WINDOW_S = "hand-21", 21, 600.0, 10.0
WITHOUT: Mapping[str, object] = {
    "device.shuffle": "harvested", "world.shuffle": "harvested", "contact_model.yields_below": 0.0,
    "contact_model.stop_s": 0.0, "contact_model.remembers": False,
}  # fmt: skip
"""Switches off levels, yielding, stopping at walls and memory; springs and ceilings stay."""

STYLES = {"with": "-", "without": (0, (2, 1.2))}


def windows(result: Result) -> list[Array]:
    """For windows of `WINDOW_S`: centre times [s], mean reservoirs of device and world [mJ], the world's share of
    modulated set-positions [%], and the error in free motion (rms) [mm]."""
    device, world = result.recording.device, result.recording.world
    assert device is not None
    assert world is not None
    x = device["position_m"][:, 0]
    error = 1e3 * (x - np.interp(device["time_s"], world["time_s"], world["position_m"][:, 0]))
    free = x <= result.recording.meta["params"]["world"]["wall"]["position_m"]
    rows = []
    for begin in np.arange(0.0, SECONDS, WINDOW_S):
        here = (device["time_s"] >= begin) & (device["time_s"] < begin + WINDOW_S)
        there = (world["time_s"] >= begin) & (world["time_s"] < begin + WINDOW_S)
        rows.append(
            (
                begin + WINDOW_S / 2.0,
                1e3 * float(np.mean(device["reservoir_J"][here])),
                1e3 * float(np.mean(world["reservoir_J"][there])),
                100.0 * modulated_share({name: values[there] for name, values in world.items()}),
                float(np.sqrt(np.mean(error[here & free] ** 2))),
            )
        )
    return [np.array(column) for column in zip(*rows, strict=True)]


def column(panels: list[Axes], link: str) -> None:
    """Draw three panels for a link, with the values of the last minute in the titles."""
    last = round(60.0 / WINDOW_S)
    last_minute: dict[str, tuple[float, float]] = {}
    for name, changes in (("with", {}), ("without", WITHOUT)):
        profile = {"link.up": LINKS[link], "link.down": LINKS[link]}
        result = simulate({**profile, "operator": OPERATOR, "duration_s": SECONDS, **changes}, seed=SEED)
        times, device, world, modulated, error = windows(result)
        dashes, minutes = STYLES[name], times / 60.0
        panels[0].plot(minutes, device, color=DEVICE_COLOR, linestyle=dashes, label=f"{name}: device")
        panels[0].plot(minutes, world, color=WORLD_COLOR, linestyle=dashes, label=f"{name}: world")
        for panel, values in ((panels[1], modulated), (panels[2], error)):
            panel.plot(minutes, values, color="black", linestyle=dashes, label=name)
        last_minute[name] = float(np.mean(modulated[-last:])), float(np.sqrt(np.mean(error[-last:] ** 2)))
    panels[0].set_title(f"{link}: reservoirs", fontsize=8.5)
    for panel, index, unit in ((panels[1], 0, "%"), (panels[2], 1, "mm")):
        kept, lost = (f"{last_minute[name][index]:.2g} {unit}" for name in STYLES)
        panel.set_title(f"last minute: with {kept}, without {lost}", fontsize=8.5)


def main() -> None:
    figure = canvas(180.0, 150.0)
    title = f"Ten minutes with {OPERATOR} at a wall, with the energy economy and without"
    figure.suptitle(title, fontsize=9.5, fontweight="bold")
    panels = figure.subplots(3, len(LINKS), sharex=True, sharey="row")
    for index, link in enumerate(LINKS):
        column(list(panels[:, index]), link)
        panels[2, index].set_xlabel(f"time [min]; windows of {WINDOW_S:.0f} s")
    labels = (
        "mean reservoir [mJ]",
        "modulated set-positions\nof the world [%]",
        "position error (rms),\nfree motion [mm]",
    )
    for row, label in enumerate(labels):
        panels[row, 0].set_ylabel(label)
        panels[row, 0].set_ylim(bottom=0.0)
    handles, shown = (
        [*above, *below]
        for above, below in zip(*(panels[row, 0].get_legend_handles_labels() for row in (0, 1)), strict=True)
    )
    figure.legend(handles, shown, loc="outside lower center", ncols=6)
    saved(figure, "ten-minutes.png")


if __name__ == "__main__":
    main()
