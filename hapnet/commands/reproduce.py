"""`hapnet reproduce`: the paper's Figures 4, 5 and 6 from the simulation, with the reconstructed numbers.

The printing of the paper lost digits, and the defaults of `hapnet.params` restore them: `LOST` says which. The law of
Figure 6's filter was not printed: here it is a first-order low-pass with a time constant of 15 ms, run every 5 ms.
"""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from hapnet.commands import flags, output
from hapnet.commands.complete import FIGURES
from hapnet.commands.options import ParamsOptions
from hapnet.commands.progress import Progress
from hapnet.errors import InvalidParameter
from hapnet.extras import require
from hapnet.params import Params

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hapnet.recording.samples import Recording

SECTION_4: dict[str, object] = {
    "rendering": "paper", "scene": "wall", "operator": "press", "link.up": "", "link.down": "",
    "record_hz": 1000.0, "operator_hand.start_periods": 0.0, "operator_hand.end_hold_s": 0.0,
    "device.stiffness": 100.0, "device.ceiling_J": 0.05,
}  # fmt: skip
"""One computer: device and virtual world on the same machine, without a link between them. The hand is as it was when
the figures were made: a sine, if one is asked for, is full from the start."""
SMOOTHING_S = 0.015
"""Time constant of Figure 6's filter [s]."""

LOST = (
    "The printing lost digits; reconstructed: K = 100 N/m (printed 1N/m), K' = 500 N/m (5N/m; K' = 5K), "
    "virtual mass 20 g (.kg), wall's damping 10 Ns/m (1Ns/m), T_k uniform from 10 to 50 ms (a figure; 3ms on average)"
)


def reproduce(
    *,
    figure: flags.Figure,
    duration: flags.Duration = None,
    seed: flags.Seed = 0,
    params: ParamsOptions,
    json_to: flags.Json = None,
    out: flags.Out = None,
    verbose: flags.Verbose = False,
) -> int:
    """Simulate the paper's Figures 4, 5 and 6, with the numbers of its Section 4 (lost digits reconstructed)."""
    base = Params().set(SECTION_4)
    if figure == "fig6":
        base = base.set({"device.smoothing_s": SMOOTHING_S})
    chosen = params.over(base, {"duration_s": duration})
    if params.show_params:
        return params.show(chosen)
    require("report", "hapnet reproduce")
    from hapnet import reports
    from hapnet.recording.mcap import save
    from hapnet.simulation.simulation import Simulation

    if figure not in FIGURES:
        raise InvalidParameter("figure", figure, "one of " + ", ".join(FIGURES), FIGURES)
    words = output.console(json_to)
    simulation = Simulation(chosen, seed)
    with Progress(output.progress_console(), "simulating", chosen.duration_s) as progress:
        result = simulation.run(progress.update)
        directory = output.run_directory(out, seed)
        recording = result.recording
        unfiltered = None
        if figure == "fig6":
            progress.stage("simulating without the filter", chosen.duration_s)
            unfiltered = Simulation(chosen.set({"device.smoothing_s": 0.0}), seed).run(progress.update).recording
        progress.stage("drawing")
        drawn = timesteps(recording) if figure == "fig4" else profiles(recording, chosen, unfiltered)
        reports.save_figure(drawn, directory / f"{figure}.png")
        progress.stage("writing")
        save(recording, directory / f"{figure}.mcap")
    result.summary["reconstructed"] = True
    output.write_json(result.summary, str(directory / f"{figure}.json"))
    output.show_warnings(words, result.warnings)
    output.show_summary(words, result.summary, verbose=verbose)
    written = output.Written()
    written.judge(result.summary, chosen, virtual=True)
    names = (f"{figure}.png", f"{figure}.mcap", f"{figure}.json")
    output.show_files(words, names, directory)
    words.print(LOST, markup=False)
    output.write_json(result.summary, json_to)
    return written.code()


def timesteps(recording: Recording) -> Figure:
    """Figure 4: the world's step T_k against k."""
    import numpy as np

    fig = _figure(90)
    world = recording.world
    assert world is not None
    axes = fig.subplots()
    steps_ms = 1e3 * world["step_s"]
    axes.plot(np.arange(len(steps_ms)), steps_ms, color="0.2", linewidth=0.8, marker=".", markersize=3)
    axes.set(xlabel="index k", ylabel="integration step T_k [ms]", ylim=(0.0, None))
    low, mean, high = steps_ms.min(), steps_ms.mean(), steps_ms.max()
    _title(fig, f"Figure 4: the virtual world steps every {low:.0f} to {high:.0f} ms, {mean:.0f} ms on average")
    axes.grid(visible=True, color="0.88")
    return fig


def profiles(recording: Recording, params: Params, unfiltered: Recording | None = None) -> Figure:
    """Figures 5 and 6: positions, forces and reservoirs over contact with the wall, along the first axis.

    unfiltered : the same run without the smoothing filter, for Figure 6.
    """
    fig = _figure(190)
    device, world = recording.device, recording.world
    assert device is not None
    assert world is not None
    top, middle, bottom = fig.subplots(3, 1, sharex=True)
    t, s = device["time_s"], world["time_s"]
    _pair(top, (t, device["position_m"][:, 0]), (s, world["position_m"][:, 0]), ("haptic device", "virtual mass"))
    for surface in recording.meta["surfaces"]:
        if surface["axis"] == 0:
            top.axhline(surface["position_m"], color="0.4", linewidth=0.8)
            top.annotate("wall", (t[0], surface["position_m"]), xytext=(2, 2), textcoords="offset points", fontsize=8)
    top.set_ylabel("position [m]")
    wall = -world["contact_force_N"][:, 0]
    ratio = _stiffness(params, "world.stiffness") / _stiffness(params, "device.stiffness")
    if unfiltered is None:
        low, high = 1e3 * world["step_s"].min(), 1e3 * world["step_s"].max()
        took_mJ = 1e3 * float(world["reservoir_J"].max() - world["reservoir_J"].min())
        _title(
            fig,
            f"Figure 5: contact is stable, although the world steps every {low:.0f} to {high:.0f} ms;\n"
            f"it costs the world {took_mJ:.0f} mJ, and without a filter the force before and after it is rough",
        )
    else:
        assert unfiltered.device is not None
        before, after = (_roughness(one) for one in (unfiltered, recording))
        _title(
            fig,
            f"Figure 6: a filter of {1e3 * params.device.smoothing_s:.0f} ms before PSPM smooths the force out of "
            f"contact:\nin 5 ms it changes by {after:.2g} N, not {before:.2g} N (95th percentile while the hand moves)",
        )
        rough = unfiltered.device["operator_force_N"][:, 0]
        middle.plot(t, rough, color="0.7", linewidth=0.8, label="without the filter")
    label = f"virtual mass on the wall, divided by K'/K = {ratio:g}"
    _pair(middle, (t, device["operator_force_N"][:, 0]), (s, wall / ratio), ("hand on the device", label))
    middle.set_ylabel("force [N]")
    _pair(bottom, (t, device["reservoir_J"]), (s, world["reservoir_J"]), ("device E(k)", "virtual world E_k"))
    bottom.set(xlabel="time [s]", ylabel="energy reservoir [J]", ylim=(0.0, None))
    return fig


def _roughness(recording: Recording) -> float:
    """By how much the hand's force changes within 5 ms [N]: 95th percentile, out of contact, faster than 10 mm/s."""
    import numpy as np

    device, world = recording.device, recording.world
    assert device is not None
    assert world is not None
    t, force = device["time_s"], device["operator_force_N"][:, 0]
    touches = np.interp(t, world["time_s"], world["penetration_m"] > 0.0) > 0.0
    moves = np.abs(np.gradient(device["position_m"][:, 0], t)) > 0.01
    apart = round(0.005 / float(np.median(np.diff(t))))
    changes = np.abs(force[apart:] - force[:-apart])[(moves & ~touches)[apart:]]
    return float(np.percentile(changes, 95)) if len(changes) else 0.0


def _title(fig: Figure, text: str) -> None:
    """The story above, and what is not printed in the paper below."""
    fig.suptitle(text, fontsize=9)
    fig.supxlabel("\n".join(textwrap.wrap(LOST, 125)), fontsize=7, color="0.35")


def _stiffness(params: Params, name: str) -> float:
    """A coupling's stiffness along the first axis [N/m]; the parameter may be a scalar, a diagonal or a matrix."""
    import numpy as np

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
    ncols = len(axes.get_legend_handles_labels()[0])
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=ncols, frameon=False, fontsize=8)
