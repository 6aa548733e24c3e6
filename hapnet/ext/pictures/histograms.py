"""Histograms of the links' delays and of the servo's lateness, from the counts in a run's summary."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hapnet.ext.pictures.style import DEVICE_COLOR, WORLD_COLOR, sheet
from hapnet.summary.structure import DIRECTIONS, read
from hapnet.summary.words import number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLORS = {"up": DEVICE_COLOR, "down": WORLD_COLOR}
_TITLE = 300  # letters
_LINE = 64  # letters, as the legend is to the right
_BARS = 60
_WIDE = 20.0  # times the median: a longer delay needs a logarithmic axis
_SUB_BINS = 8  # the servo's lateness has 32 bins per octave; four are joined into one here


def link_histogram(tree: object) -> Figure | None:
    """The delays of both links, in a panel each, 180 mm wide; None if no delays were counted."""
    counted = read(tree)["links"]
    links = {direction: link for direction in DIRECTIONS if (link := counted[direction]) is not None}
    bins = {direction: _bins(link["delay_histogram_ms"]) for direction, link in links.items()}
    found = {direction: part for direction, part in bins.items() if len(part) > 1}
    if not found:
        return None
    top = max(part[-1, 0] for part in found.values())
    wide = any(part[-1, 0] > _WIDE * _median(part) for part in found.values())
    with sheet(20 + 40 * len(found)) as fig:
        panels = fig.subplots(len(found), 1, sharex=True, squeeze=False)[:, 0]
        for panel, (direction, part) in zip(panels, found.items(), strict=True):
            _delays(panel, part, _COLORS[direction], logarithmic=wide)
            link = links[direction]
            _marks(panel, {"p50": link["delay_p50_ms"], "p99": link["delay_p99_ms"]}, "ms")
            words = textwrap.wrap(f"{direction}link: {link['profile'] or 'nothing emulated'}"[:_TITLE], _LINE)
            panel.set_title("\n".join(words), loc="left", fontsize=8, parse_math=False)
        if not wide:
            shortest = min(part[0, 0] for part in found.values())
            room = max(0.1 * (top - shortest), 0.02 * top)
            panels[0].set_xlim(max(0.0, shortest - room), top + room)
        panels[-1].set_xlabel("delay in the link [ms]")
    return fig


def lateness_histogram(tree: object) -> Figure | None:
    """The lateness of the servo's ticks, on logarithmic axes; None if it was not recorded."""
    device = read(tree)["device"]
    servo = None if device is None else device["servo"]
    bins = _bins(None if servo is None else servo["late_histogram_us"])
    if servo is None or not len(bins):
        return None
    late_ns = np.maximum(bins[:, 0] * 1e3, 1.0)
    low, high = np.floor(np.log2(late_ns.min())), np.floor(np.log2(late_ns.max())) + 1
    octaves = np.exp2(np.arange(low, high))
    edges = np.append(np.outer(octaves, 1.0 + np.arange(_SUB_BINS) / _SUB_BINS).ravel(), np.exp2(high))
    counts, _ = np.histogram(late_ns, bins=edges, weights=bins[:, 1])
    with sheet(60) as fig:
        panel = fig.subplots()
        panel.set(xscale="log", yscale="log", xlabel="lateness of a servo tick [µs]", ylabel="ticks")
        _stairs(panel, counts, edges * 1e-3, _COLORS["up"])
        panel.set_ylim(0.5, 2.0 * counts.max())
        panel.xaxis.set_major_formatter("{x:g}")
        late = {"p50": servo["late_p50_us"], "p99": servo["late_p99_us"], "max": servo["late_max_us"]}
        _marks(panel, late, "µs")
    return fig


def _delays(panel: Axes, bins: NDArray[np.float64], color: str, *, logarithmic: bool) -> None:
    edges, counts = bins[:, 0].copy(), bins[1:, 1]
    if logarithmic:  # on this axis bins are equally wide
        edges[0] = edges[0] or edges[1] / 2.0
        panel.set_xscale("log")
        panel.xaxis.set_major_formatter("{x:g}")
    else:  # distributed over bars of equal width
        span, widths = edges[-1] - edges[0], np.diff(edges)[counts > 0.0]
        even = np.linspace(edges[0], edges[-1], max(1, round(min(_BARS, span / np.median(widths)))) + 1)
        edges, counts = even, np.diff(np.interp(even, edges, np.cumsum(bins[:, 1])))
    _stairs(panel, counts, edges, color)
    panel.set_ylabel("packets")


def _stairs(panel: Axes, counts: NDArray[np.float64], edges: NDArray[np.float64], color: str) -> None:
    panel.stairs(counts, edges, fill=True, color=color, alpha=0.3)
    panel.stairs(counts, edges, color=color, linewidth=0.9)


def _bins(histogram: Any) -> NDArray[np.float64]:
    """Rows of (edge, count); no rows if this is not a histogram, or all counts are 0."""
    nothing = np.zeros((0, 2))
    try:
        bins = np.array(histogram or nothing, dtype=float).reshape(-1, 2)
    except (TypeError, ValueError):
        return nothing
    sound = np.isfinite(bins).all() and (bins >= 0.0).all() and (np.diff(bins[:, 0]) > 0.0).all()
    return bins if sound and bins[:, 1].any() else nothing


def _median(bins: NDArray[np.float64]) -> float:
    return float(bins[np.searchsorted(np.cumsum(bins[:, 1]), bins[:, 1].sum() / 2.0), 0])


def _marks(panel: Axes, values: Mapping[str, float | None], unit: str) -> None:
    panel.set_axisbelow(True)
    for (name, value), style in zip(values.items(), ("--", ":", "-."), strict=False):
        if value is not None:
            panel.axvline(value, color="black", linestyle=style, linewidth=0.9, label=f"{name} {number(value)} {unit}")
    if panel.get_legend_handles_labels()[0]:
        panel.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, fontsize=8, borderaxespad=0.1)
