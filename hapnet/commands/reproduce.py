"""`hapnet reproduce`: the paper's Figures 4, 5 and 6 from the simulation, with the reconstructed numbers.

The printing of the paper lost digits. The defaults of `hapnet.params` restore them (servo 1 ms, device PSPM 5 ms, K 100
N/m and B 0.1 Ns/m, K' 500 N/m and B' 14 Ns/m, mass 20 g, wall 3 kN/m and 10 Ns/m, T_k 10 to 50 ms). The law of Figure
6's filter was not printed: here it is a first-order low-pass with a time constant of 15 ms, run every 5 ms.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hapnet.commands import output
from hapnet.commands.progress import Progress
from hapnet.errors import InvalidParameter
from hapnet.params import Params

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hapnet.recording.samples import Recording

FIGURES = ("fig4", "fig5", "fig6")
SECTION_4 = {"feel": "paper", "scene": "wall", "operator": "press", "link.up": "", "link.down": "",
             "record_hz": 1000.0, "operator_hand.start_periods": 0.0, "operator_hand.end_hold_s": 0.0}  # fmt: skip
"""One computer: device and virtual world on the same machine, without a link between them. The hand is as it was when
the figures were made: a sine, if one is asked for, is full from the start."""
SMOOTHING_S = 0.015


def main(figure: str, params: Params, seed: int, json_to: str | None, out: Path | None, *, verbose: bool) -> int:
    """Simulate Section 4, draw the figure, print the summary."""
    from hapnet import report
    from hapnet.recording.mcap import save
    from hapnet.simulation.simulation import Simulation

    if figure not in FIGURES:
        raise InvalidParameter("figure", figure, "one of " + ", ".join(FIGURES))
    words = output.console(json_to)
    simulation = Simulation(params, seed)
    with Progress(words, "simulating", params.duration_s) as progress:
        result = simulation.run(progress.update)
        directory = output.run_directory(out, seed)
        recording = result.recording
        progress.stage("drawing")
        drawn = timesteps(recording) if figure == "fig4" else profiles(recording, params)
        report.save_figure(drawn, directory / f"{figure}.png")
        progress.stage("writing")
        save(recording, directory / f"{figure}.mcap")
    result.summary["reconstructed"] = True
    output.write_json(result.summary, str(directory / f"{figure}.json"))
    output.show_warnings(words, result.warnings)
    output.show_summary(words, result.summary, verbose=verbose)
    written = output.Written()
    written.judge(result.summary, params, virtual=True)
    names = (f"{figure}.png", f"{figure}.mcap", f"{figure}.json")
    output.show_files(words, names, directory, " (the paper's lost digits reconstructed)")
    output.write_json(result.summary, json_to)
    return written.code()


def timesteps(recording: Recording) -> Figure:
    """Figure 4: the world's step T_k against k."""
    fig = _figure(80)
    world = recording.world
    assert world is not None
    axes = fig.subplots()
    axes.plot(
        np.arange(len(world["step_s"])), 1e3 * world["step_s"], color="0.2", linewidth=0.8, marker=".", markersize=3
    )
    axes.set(xlabel="index k", ylabel="integration step T_k [ms]", ylim=(0.0, None))
    axes.set_title("Figure 4: integration step of the virtual world (reconstructed: uniform, 10 to 50 ms)", fontsize=9)
    axes.grid(visible=True, color="0.88")
    return fig


def profiles(recording: Recording, params: Params) -> Figure:
    """Figures 5 and 6: positions, forces and reservoirs over contact with the wall, along the first axis."""
    fig = _figure(180)
    device, world = recording.device, recording.world
    assert device is not None
    assert world is not None
    top, middle, bottom = fig.subplots(3, 1, sharex=True)
    name, filtered = ("Figure 6", "with") if params.device.smoothing_s > 0.0 else ("Figure 5", "without")
    fig.suptitle(f"{name}: Section 4 {filtered} smoothing filter (lost digits reconstructed)", fontsize=9)
    t, s = device["time_s"], world["time_s"]
    _pair(top, (t, device["position_m"][:, 0]), (s, world["position_m"][:, 0]), ("haptic device", "virtual mass"))
    for surface in recording.meta["surfaces"]:
        if surface["axis"] == 0:
            top.axhline(surface["position_m"], color="0.4", linewidth=0.8)
            top.annotate("wall", (t[0], surface["position_m"]), xytext=(2, 2), textcoords="offset points", fontsize=8)
    top.set_ylabel("position [m]")
    hand, wall = device["operator_force_N"][:, 0], -world["contact_force_N"][:, 0]
    ratio = _stiffness(params, "world.stiffness") / _stiffness(params, "device.stiffness")
    label = f"virtual mass on the wall, divided by K'/K = {ratio:g}"
    _pair(middle, (t, hand), (s, wall / ratio), ("hand on the device", label))
    middle.set_ylabel("force [N]")
    _pair(bottom, (t, device["reservoir_J"]), (s, world["reservoir_J"]), ("device E(k)", "virtual world E_k"))
    bottom.set(xlabel="time [s]", ylabel="energy reservoir [J]", ylim=(0.0, None))
    return fig


def _stiffness(params: Params, name: str) -> float:
    """A coupling's stiffness along the first axis [N/m]; the parameter may be a scalar, a diagonal or a matrix."""
    return float(np.ravel(params.get(name))[0])


def _figure(height_mm: float) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    fig = Figure(figsize=(180 / 25.4, height_mm / 25.4), dpi=150, layout="constrained")
    FigureCanvasAgg(fig)
    return fig


def _pair(
    axes: Axes,
    device: tuple[np.ndarray, np.ndarray],
    world: tuple[np.ndarray, np.ndarray],
    labels: tuple[str, str],
) -> None:
    axes.plot(*device, color="#08306b", linewidth=1.0, label=labels[0])
    axes.plot(*world, color="#e6550d", linewidth=1.0, linestyle=(0, (5, 1.5)), drawstyle="steps-post", label=labels[1])
    axes.grid(visible=True, color="0.88")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False, fontsize=8)
