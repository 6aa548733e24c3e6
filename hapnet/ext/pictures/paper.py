"""The paper's Figures 4, 5 and 6."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

import numpy as np

from hapnet.checks import Array
from hapnet.ext.pictures.style import DEVICE_COLOR, WORLD_COLOR, legend_above, sheet
from hapnet.params import Params
from hapnet.recording.samples import Recording

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LOST = (
    "The printed paper lacks digits; reconstructed: K = 100 N/m (printed 1N/m), K' = 500 N/m (5N/m; K' = 5K), "
    "virtual mass 20 g (.kg), wall's damping 10 Ns/m (1Ns/m), T_k uniform from 10 to 50 ms (a figure; 3ms on average)"
)


def timesteps(recording: Recording) -> Figure:
    """Figure 4: the world's step T_k over k."""
    world = recording.world
    assert world is not None
    steps_ms = 1e3 * world["step_s"]
    low, mean, high = steps_ms.min(), steps_ms.mean(), steps_ms.max()
    with sheet(90) as fig:
        axes = fig.subplots()
        axes.plot(np.arange(len(steps_ms)), steps_ms, color="0.2", linewidth=0.8, marker=".", markersize=3)
        axes.set(xlabel="index k", ylabel="integration step T_k [ms]", ylim=(0.0, None))
        _title(fig, f"Figure 4: the virtual world steps every {low:.0f} to {high:.0f} ms, {mean:.0f} ms on average")
    return fig


def profiles(recording: Recording, params: Params, unfiltered: Recording | None = None) -> Figure:
    """Figures 5 and 6: positions, forces and reservoirs during contact with the wall, along the first axis.

    unfiltered : the same run without the smoothing filter, for Figure 6.
    """
    device, world = recording.device, recording.world
    assert device is not None
    assert world is not None
    with sheet(190) as fig:
        top, middle, bottom = fig.subplots(3, 1, sharex=True)
        t, s = device["time_s"], world["time_s"]
        _pair(top, (t, device["position_m"][:, 0]), (s, world["position_m"][:, 0]), ("haptic device", "virtual mass"))
        for surface in recording.meta["surfaces"]:
            if surface["axis"] == 0:
                top.axhline(surface["position_m"], color="0.4", linewidth=0.8)
                top.annotate(
                    "wall", (t[0], surface["position_m"]), xytext=(2, 2), textcoords="offset points", fontsize=8
                )
        top.set_ylabel("position [m]")
        wall = -world["contact_force_N"][:, 0]
        ratio = _stiffness(params, "world.stiffness") / _stiffness(params, "device.stiffness")
        if unfiltered is None:
            low, high = 1e3 * world["step_s"].min(), 1e3 * world["step_s"].max()
            took_mJ = 1e3 * float(world["reservoir_J"].max() - world["reservoir_J"].min())
            story = (
                f"Figure 5: contact is stable, although the world steps every {low:.0f} to {high:.0f} ms;\n"
                f"it costs the world {took_mJ:.0f} mJ, and without a filter the force before and after it is rough"
            )
        else:
            assert unfiltered.device is not None
            before, after = (_roughness(one) for one in (unfiltered, recording))
            story = (
                f"Figure 6: a filter of {1e3 * params.device.smoothing_s:.0f} ms before PSPM smooths the force out of "
                f"contact:\nin 5 ms it changes by {after:.2g} N, not {before:.2g} N "
                "(95th percentile while the hand moves)"
            )
            rough = unfiltered.device["operator_force_N"][:, 0]
            middle.plot(t, rough, color="0.7", linewidth=0.8, label="without the filter")
        label = f"virtual mass on the wall, divided by K'/K = {ratio:g}"
        _pair(middle, (t, device["operator_force_N"][:, 0]), (s, wall / ratio), ("hand on the device", label))
        middle.set_ylabel("force [N]")
        _pair(bottom, (t, device["reservoir_J"]), (s, world["reservoir_J"]), ("device E(k)", "virtual world E_k"))
        bottom.set(xlabel="time [s]", ylabel="energy reservoir [J]", ylim=(0.0, None))
        _title(fig, story)
    return fig


def _roughness(recording: Recording) -> float:
    """The change of the hand's force within 5 ms [N]: 95th percentile, out of contact, faster than 10 mm/s."""
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
    """Put the text above the figure, and the reconstructed digits below it."""
    fig.suptitle(text, fontsize=9)
    fig.supxlabel("\n".join(textwrap.wrap(LOST, 125)), fontsize=7, color="0.35")


def _stiffness(params: Params, name: str) -> float:
    """A coupling's stiffness along the first axis [N/m]; the parameter may be a scalar, a diagonal or a matrix."""
    return float(np.ravel(params.get(name))[0])


def _pair(axes: Axes, device: tuple[Array, Array], world: tuple[Array, Array], labels: tuple[str, str]) -> None:
    axes.plot(*device, color=DEVICE_COLOR, linewidth=1.0, label=labels[0])
    axes.plot(
        *world, color=WORLD_COLOR, linewidth=1.0, linestyle=(0, (5, 1.5)), drawstyle="steps-post", label=labels[1]
    )
    legend_above(axes)
