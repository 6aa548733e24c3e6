"""The live plots: force, both reservoirs, penetration, the passivity margin."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import viser
from viser import uplot

from hapnet.checks import Array
from hapnet.view.history import Snapshot, Track

POINTS = 300
"""Points per curve."""

_BLUE, _ORANGE, _GREEN, _INK, _GREY = "#2563eb", "#ea580c", "#16a34a", "#0f172a", "#94a3b8"

_LEAST = 1.0
"""The axis always goes up to this [N, mJ, mm]: otherwise mere rounding errors would fill a plot."""

_HEADING, _FRAME = 96, 42  # pixels: of the panel above the plots, of a plot around its curves

_LEGEND = (
    '<div style="padding:2px 12px 0;font-size:12px">'
    + " &nbsp; ".join(
        f'<span style="color:{colour}">&#9632;</span> {name}'
        for colour, name in (
            (_BLUE, "device, handle"),
            (_ORANGE, "world, proxy"),
            (_INK, "both"),
            ("#dc2626", "not passive"),
        )
    )
    + "</div>"
)


class Plots:
    """Four plots of the last `seconds`, in the container that is open when this is made."""

    def __init__(self, gui: viser.GuiApi, seconds: float) -> None:
        self._seconds = seconds
        gui.add_html(_LEGEND)
        device, world = _curve("device", _BLUE), _curve("world", _ORANGE)
        below = _curve("below 0", "transparent", fill="rgba(220, 38, 38, 0.45)")
        thin = [_curve(name, colour, width=1.0) for name, colour in (("device", _BLUE), ("world", _ORANGE))]
        self._force = self._add(gui, "force on the hand [N]", _curve("force", _GREEN))
        self._reservoirs = self._add(gui, "energy in the reservoirs [mJ]", device, world)
        self._depth = self._add(gui, "depth in the wall [mm]", device, world)
        self._margin = self._add(gui, "passivity margin [mJ]", below, *thin, _curve("both", _INK))

    def fit(self, pixels: int) -> None:
        """Set the height of the four plots so that together they fill a window of `pixels`."""
        for plot in (self._force, self._reservoirs, self._depth, self._margin):
            plot.height = min(max((pixels - _HEADING) // 4 - _FRAME, 80), 300)

    def update(self, snapshot: Snapshot, surfaces: Iterable[Mapping[str, Any]]) -> None:
        """Draw `snapshot`; `surfaces` are the scene's walls."""
        device, world = snapshot.device, snapshot.world
        first = max((track.time_s[0] for track in (device, world) if track is not None), default=-self._seconds)
        at = np.linspace(min(max(first, -self._seconds), -1e-3), 0.0, POINTS)
        halves = [1e3 * _held(track, "margin_J", at) for track in (device, world)]
        both = halves[0] + halves[1]
        depth = np.zeros(POINTS)
        if device is not None:
            depth = 1e3 * held(device.time_s, depth_of(device.position_m, surfaces), at)
        _draw(self._force, at, _signed(device, at))
        _draw(self._reservoirs, at, *(1e3 * _held(track, "reservoir_J", at) for track in (device, world)))
        _draw(self._depth, at, depth, 1e3 * np.maximum(_held(world, "penetration_m", at), 0.0))
        _draw(self._margin, at, np.minimum(both, 0.0), *halves, both)

    def _add(self, gui: viser.GuiApi, title: str, *curves: uplot.Series) -> viser.GuiUplotHandle:
        return gui.add_uplot(
            (np.array([-self._seconds, 0.0]), *(np.zeros(2) for _ in range(len(curves) + 2))),
            ({"label": "s"}, _curve("least range", "transparent"), _curve("zero", _GREY, width=1.0), *curves),
            title=title,
            scales={"x": {"time": False, "range": (-self._seconds, 0.0)}},
            axes=({"size": 26.0, "ticks": {"size": 4.0}}, {"size": 52.0, "ticks": {"size": 4.0}}),
            legend={"show": False},
            cursor={"show": False},
            padding=(6, 12, 0, 0),
            height=122,
        )


def _draw(plot: viser.GuiUplotHandle, at: Array, *curves: Array) -> None:
    reach = np.zeros(len(at))
    reach[0] = _LEAST
    plot.data = (at, reach, np.zeros(len(at)), *curves)


def _held(track: Track | None, name: str, at: Array) -> Array:
    return np.zeros(len(at)) if track is None else held(track.time_s, getattr(track, name), at)


def held(times: Array, values: Array, at: Array) -> Array:
    """`values` (N,) at the times `at`: each is held until the next, and the first holds before its time too.

    So there is never a NaN: uPlot finds no range for a curve that begins with one.
    """
    index = np.searchsorted(times, at, side="right") - 1
    return np.asarray(values[np.maximum(index, 0)])


def depth_of(position_m: Array, surfaces: Iterable[Mapping[str, Any]]) -> Array:
    """How deep each of `position_m` (N, n) is in the deepest wall [m]; 0 outside all of them."""
    depth = np.zeros(len(position_m))
    for surface in surfaces:
        axis = int(surface["axis"])
        if axis < position_m.shape[1]:
            depth = np.maximum(depth, int(surface["solid"]) * (position_m[:, axis] - float(surface["position_m"])))
    return depth


def _signed(device: Track | None, at: Array) -> Array:
    """The force on the hand: with its sign if there is one axis, otherwise its magnitude."""
    if device is None:
        return np.zeros(len(at))
    force = device.force_N[:, 0] if device.force_N.shape[1] == 1 else np.linalg.norm(device.force_N, axis=1)
    return held(device.time_s, np.asarray(force), at)


def _curve(label: str, stroke: str, width: float = 2.0, fill: str | None = None) -> uplot.Series:
    series: uplot.Series = {"label": label, "stroke": stroke, "width": width, "points": {"show": False}}
    return series if fill is None else {**series, "fill": fill}
