"""The live plots: the force and its parts, both reservoirs, penetration, the passivity margin."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import viser
from viser import uplot

from hapnet.checks import Array
from hapnet.ext.page.force import STACK, force_of, stacked
from hapnet.ext.page.history import Snapshot, Track, coupled, of_point, units
from hapnet.summary.verdict import has_reservoirs
from hapnet.units import within

POINTS = 300
"""Points per curve."""

_BLUE, _ORANGE, _GREEN, _INK, _GREY = "#2563eb", "#ea580c", "#16a34a", "#0f172a", "#94a3b8"

_MINIMUM = 1.0
"""Each axis goes at least up to this value [N, mJ, mm]: otherwise rounding errors would fill a plot."""

_HEADING, _FRAME = 150, 42  # pixels: of the panel above the plots, of a plot around its curves

_FORCE, _DEPTH = "force on the hand [{}]", "depth in the wall [{}]"

_OF_PARTS = dict(zip(STACK, ("#93c5fd", "#c4b5fd", "#86efac", "#fdba74"), strict=True))


def _legend(*entries: tuple[str, str]) -> str:
    whole = '<span style="white-space:nowrap"><span style="color:{}">&#9632;</span> {}</span>'
    words = " &nbsp; ".join(whole.format(colour, name) for name, colour in entries)
    return f'<div style="padding:2px 12px 0;font-size:11px">{words}</div>'


class Plots:
    """Four plots of the last `seconds`, in the container that is open when this object is created."""

    def __init__(self, gui: viser.GuiApi, seconds: float) -> None:
        self._seconds = seconds
        of_sides = ("device, handle", _BLUE), ("world, proxy", _ORANGE), ("both", _INK), ("not passive", "#dc2626")
        self._legend = gui.add_html(_legend(*of_sides) + _legend(("force", _GREEN), *_OF_PARTS.items()), visible=False)
        device, world = _curve("device", _BLUE), _curve("world", _ORANGE)
        below = _curve("below 0", "transparent", fill="rgba(220, 38, 38, 0.45)")
        thin = [_curve(name, colour, width=1.0) for name, colour in (("device", _BLUE), ("world", _ORANGE))]
        parts = [_curve(name, "transparent", fill=colour) for name, colour in reversed(_OF_PARTS.items())]
        self._force = self._add(gui, _FORCE.format("N"), *parts, *parts, _curve("force", _GREEN))
        self._reservoirs = self._add(gui, "energy in the reservoirs [mJ]", device, world)
        self._depth = self._add(gui, _DEPTH.format("mm"), device, world)
        self._margin = self._add(gui, "passivity margin [mJ]", below, *thin, _curve("both", _INK))

    def fit(self, pixels: int) -> None:
        """Set the height of the four plots so that together they fill a window of `pixels`."""
        for plot in (self._force, self._reservoirs, self._depth, self._margin):
            plot.height = min(max((pixels - _HEADING) // 4 - _FRAME, 80), 300)

    def update(self, snapshot: Snapshot, surfaces: Iterable[Mapping[str, Any]]) -> None:
        """Draw `snapshot`; `surfaces` are the scene's flat walls at rest, for which the handle's depth is known."""
        axes, snapshot = units(snapshot), of_point(snapshot)
        device, world = snapshot.device, snapshot.world
        known = device is not None or world is not None
        for shown in (self._legend, self._force, self._depth, self._margin):
            shown.visible = known
        reservoirs = has_reservoirs(coupled(snapshot.device_status or snapshot.world_status)[0])
        self._reservoirs.visible = known and reservoirs
        if not known:
            return
        self._force.title, self._depth.title = _FORCE.format(within(axes, "N")), _DEPTH.format(within(axes, "mm"))
        first = max((track.time_s[0] for track in (device, world) if track is not None), default=-self._seconds)
        at = np.linspace(min(max(first, -self._seconds), -1e-3), 0.0, POINTS)
        halves = [1e3 * _held(track, "margin_J", at) for track in (device, world)]
        both = halves[0] + halves[1]
        of_proxy = 1e3 * np.maximum(_held(world, "penetration_m", at), 0.0)
        of_handle, walls = of_proxy, tuple(surfaces)  # without walls the proxy's curve covers the handle's
        if device is not None and walls:
            of_handle = 1e3 * held(device.time_s, depth_of(device.position_m, walls), at)
        if device is not None:
            parts = held(device.time_s, stacked(device), at)
            force = held(device.time_s, force_of(device), at)
            _draw(self._force, at, *piled(parts), force)
        _draw(self._reservoirs, at, *(1e3 * _held(track, "reservoir_J", at) for track in (device, world)))
        _draw(self._depth, at, of_handle, of_proxy)
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
            visible=False,
        )


def _draw(plot: viser.GuiUplotHandle, at: Array, *curves: Array) -> None:
    reach = np.zeros(len(at))
    reach[0] = _MINIMUM
    plot.data = (at, reach, np.zeros(len(at)), *curves)


def _held(track: Track | None, name: str, at: Array) -> Array:
    return np.zeros(len(at)) if track is None else held(track.time_s, getattr(track, name), at)


def held(times: Array, values: Array, at: Array) -> Array:
    """`values` (N,) at the times `at`: each value is held until the next, and the first also before its time.

    So there is never a NaN: uPlot finds no range for a curve that begins with NaN.
    """
    index = np.searchsorted(times, at, side="right") - 1
    return np.asarray(values[np.maximum(index, 0)])


def depth_of(position_m: Array, surfaces: Iterable[Mapping[str, Any]]) -> Array:
    """The depth of each of `position_m` (N, n) in the wall with the largest depth [m]; 0 outside all walls."""
    depth = np.zeros(len(position_m))
    for surface in surfaces:
        axis = int(surface["axis"])
        if axis < position_m.shape[1]:
            depth = np.maximum(depth, int(surface["solid"]) * (position_m[:, axis] - float(surface["position_m"])))
    return depth


def piled(parts: Array) -> list[Array]:
    """The edges of stacked areas for `parts` (N, m): positive values stack upwards from 0, negative values downwards.

    The outermost edge comes first: each area is filled down to 0 and covered by the areas after it.
    """
    up, down = np.cumsum(np.maximum(parts, 0.0), axis=1), np.cumsum(np.minimum(parts, 0.0), axis=1)
    return [*up.T[::-1], *down.T[::-1]]


def _curve(label: str, stroke: str, width: float = 2.0, fill: str | None = None) -> uplot.Series:
    series: uplot.Series = {"label": label, "stroke": stroke, "width": width, "points": {"show": False}}
    return series if fill is None else {**series, "fill": fill}
