"""Figures of a sweep: a heat map along two axes, or a line with quartiles along a single axis."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hapnet.ext.metrics.measured import quantile
from hapnet.ext.pictures.grid import USUAL, Cell, Grid, GridAxis, metric_label, statistic, usual_statistic
from hapnet.ext.pictures.style import DEVICE_COLOR, headed, legend_above, sheet
from hapnet.summary.verdict import ROUNDING_J

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

_WRITTEN = 150  # the largest number of cells that have space for a figure
_TICKS = {"x": 10, "y": 16}
_LABEL = 28  # letters of a tick's line
_LINES = 3
_FAILED: dict[str, Any] = {"color": "#cb181d", "fontweight": "bold"}
_BAD = "#e31a1c"
_NOT_PASSIVE: dict[str, Any] = {"edgecolor": "black", "hatch": "xxx", "linewidth": 2.0, "zorder": 3}
"""A style that is visible on any colour, and in grey."""
_NOT_PASSIVE_POINT: dict[str, Any] = {
    "marker": "X", "markersize": 11, "color": _BAD, "markeredgecolor": "black", "linestyle": "none", "zorder": 5,
}  # fmt: skip
_EMPTY: dict[str, Any] = {"facecolor": "0.93", "edgecolor": "0.55", "hatch": "////", "linewidth": 0.0}


def draw(grid: Grid, stat: str | None = None, where: Sequence[str] = (), name: str = "") -> Figure:
    """The figure, 180 mm wide.

    stat : the statistic of the runs in a cell; None: the metric's usual one. where, name : for the title.

    Raises InvalidParameter: there is no such statistic.
    """
    stat = stat or usual_statistic(grid.metric)
    of = statistic(stat)
    figures = {place: of(cell.values) for place, cell in grid.cells.items() if cell.values}
    label, scale = metric_label(grid.metric, figures.values())
    figures = {place: value * scale for place, value in figures.items()}
    rows = 6 if grid.y is None else min(max(len(grid.y.values), 4), 14)
    with sheet(45 + 9 * rows) as fig:
        headed(fig, _title(grid, f"{stat} of {label.partition(' [')[0]}", where, name), _extremes(grid, figures, label))
        panel = fig.add_subplot()
        if grid.y is None:
            _draw_line(panel, grid, figures, stat, label, scale)
        else:
            _draw_map(fig, panel, grid, figures, f"{stat} of {label}")
        marks = _legend(grid)
        if marks:
            fig.legend(handles=marks, loc="outside lower left", ncols=len(marks), fontsize=8, handlelength=1.6)
    return fig


def _draw_map(fig: Figure, panel: Axes, grid: Grid, figures: dict[tuple[int, int], float], label: str) -> None:
    from matplotlib import colormaps
    from matplotlib.patches import Rectangle

    assert grid.y is not None
    shape = len(grid.y.values), len(grid.x.values)
    values = np.full(shape, np.nan)
    for (i, j), figure in figures.items():
        values[j, i] = figure
    passivity = _shows_passivity(grid.metric)
    signed = passivity and grid.metric != USUAL  # a margin or a slack
    bad = {
        place
        for place, cell in grid.cells.items()
        if cell.not_passive or (signed and min(cell.values, default=0.0) < -ROUNDING_J)
    }
    shown = values.copy()
    if passivity:  # a single bad cell would take the whole range of colours, so the colours are for the other cells
        for i, j in bad:
            shown[j, i] = np.nan
    norm, colours = _colours(shown)
    mesh = panel.pcolormesh(
        np.arange(shape[1] + 1) - 0.5, np.arange(shape[0] + 1) - 0.5, shown, norm=norm, cmap=colours
    )
    fig.colorbar(mesh, ax=panel, label=label, pad=0.02, aspect=30, ticks=_scale_ticks(norm), format="%g")
    panel.grid(visible=False)
    written = values.size <= _WRITTEN
    for i in range(shape[1]):
        for j in range(shape[0]):
            cell = grid.cells.get((i, j), Cell())
            figure = values[j, i]
            if (i, j) in bad:
                _mark_not_passive(panel, i, j, figure, written, fill=passivity)
            elif np.isnan(figure):
                panel.add_patch(Rectangle((i - 0.5, j - 0.5), 1.0, 1.0, **_EMPTY))
            elif written:
                dark = float(np.dot(colormaps[colours](norm(figure))[:3], (0.299, 0.587, 0.114))) < 0.5
                panel.text(i, j, f"{figure:.3g}", ha="center", va="center", color="white" if dark else "black")
            if cell.failed:
                _mark_failed(panel, i, j, cell.failed, written, alone=not cell.values)
    panel.set_xlim(-0.5, shape[1] - 0.5)
    panel.set_ylim(-0.5, shape[0] - 0.5)
    panel.tick_params(length=0)
    _ticks(panel, grid.x, "x")
    _ticks(panel, grid.y, "y")


def _mark_not_passive(panel: Axes, i: int, j: int, figure: float, written: bool, *, fill: bool) -> None:
    from matplotlib.patches import Rectangle

    frame = Rectangle((i - 0.46, j - 0.46), 0.92, 0.92, facecolor=_BAD if fill else "none", **_NOT_PASSIVE)
    panel.add_patch(frame)
    if written and not np.isnan(figure):
        box = {"facecolor": "white", "edgecolor": "black", "pad": 1.2, "linewidth": 0.8}
        panel.text(
            i, j, f"{figure:.3g}", ha="center", va="center", color="black", fontweight="bold", bbox=box, zorder=4
        )


def _shows_passivity(metric: str) -> bool:
    return metric in (USUAL, "slack_J") or ("margin" in metric and metric.endswith("_J"))


def _mark_failed(panel: Axes, i: int, j: int, failed: int, written: bool, *, alone: bool) -> None:
    if not written:
        for colour, width in (("white", 2.2), (_FAILED["color"], 1.0)):  # visible on any colour
            panel.plot(i, j, marker="x", markersize=3.5, markeredgewidth=width, color=colour)
    else:
        box = {"facecolor": "white", "edgecolor": "none", "pad": 0.8}
        at: dict[str, Any] = {"ha": "center", "va": "center"} if alone else {"ha": "right", "va": "top"}
        x, y = (i, j) if alone else (i + 0.47, j + 0.45)
        panel.text(x, y, f"×{failed}", fontsize=7, bbox=box, **at, **_FAILED)


def _draw_line(
    panel: Axes, grid: Grid, figures: dict[tuple[int, int], float], stat: str, label: str, scale: float
) -> None:
    x = np.array(grid.x.values, dtype=float) if grid.x.numeric else np.arange(len(grid.x.values), dtype=float)
    cells = [grid.cells.get((i, 0), Cell()) for i in range(len(x))]
    line = np.array([figures.get((i, 0), np.nan) for i in range(len(x))])
    low, high = (
        np.array([quantile(cell.values, q) * scale if cell.values else np.nan for cell in cells]) for q in (0.25, 0.75)
    )
    if grid.x.numeric:
        panel.fill_between(x, low, high, color=DEVICE_COLOR, alpha=0.2, linewidth=0, label="quartiles")
        panel.plot(x, line, color=DEVICE_COLOR, marker=".", label=stat)
        if grid.x.log:
            panel.set_xscale("log")
        if len(x) <= _TICKS["x"]:
            panel.set_xticks(x, grid.x.words)
            panel.set_xticks([], minor=True)
    else:
        panel.vlines(x, low, high, color=DEVICE_COLOR, alpha=0.3, linewidth=6, label="quartiles")
        panel.plot(x, line, color=DEVICE_COLOR, marker="o", linestyle="none", label=stat)
        panel.set_xlim(-0.5, len(x) - 0.5)
        _ticks(panel, grid.x, "x")
    panel.set_xlabel(grid.x.label)
    panel.set_ylabel(label)
    for place, cell in zip(x, cells, strict=True):
        if cell.failed:
            over: dict[str, Any] = {
                "transform": panel.get_xaxis_transform(),
                "ha": "center",
                "va": "bottom",
                "fontsize": 7,
            }
            panel.text(place, 0.01, f"×{cell.failed}", **over, **_FAILED)
    bad = np.array([cell.not_passive > 0 for cell in cells])
    if bad.any():
        panel.plot(x[bad], np.where(np.isnan(line), 0.0, line)[bad], **_NOT_PASSIVE_POINT)
    legend_above(panel)


def _colours(values: NDArray[np.float64]) -> tuple[Normalize, str]:
    """The range and map of colours: two colours that meet at zero, if there are values on both sides of it."""
    from matplotlib.colors import Normalize, TwoSlopeNorm

    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    if low < 0.0 < high:
        return TwoSlopeNorm(0.0, low, high), "RdBu"
    if low == high:
        spread = abs(low) / 2 or 1.0
        return Normalize(low - spread, high + spread), "viridis"
    return Normalize(low, high), "viridis"


def _scale_ticks(norm: Normalize) -> list[float] | None:
    """Ticks on each side of zero, if the two sides have different scales."""
    from matplotlib.colors import TwoSlopeNorm
    from matplotlib.ticker import MaxNLocator

    if not isinstance(norm, TwoSlopeNorm):
        return None
    low, high = float(norm.vmin or 0.0), float(norm.vmax or 0.0)
    ticks = {*MaxNLocator(4).tick_values(low, 0.0), 0.0, *MaxNLocator(4).tick_values(0.0, high)}
    return sorted(tick for tick in ticks if low <= tick <= high)


def _ticks(panel: Axes, axis: GridAxis, which: str) -> None:
    """Put a tick at each cell, or with many cells at every second, third, ..."""
    every = max(1, -(-len(axis.values) // _TICKS[which])) if axis.numeric else 1
    width = _LABEL if which == "y" else max(8, 84 // len(axis.values))
    words = ["\n".join(textwrap.wrap(word, width, max_lines=_LINES, placeholder=" …")) for word in axis.words[::every]]
    places = range(0, len(axis.values), every)
    if which == "x":
        panel.set_xticks(places, words)
        panel.set_xlabel(axis.label)
    else:
        panel.set_yticks(places, words)
        panel.set_ylabel(axis.label)


def _legend(grid: Grid) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    counted = list(grid.cells.values())
    wide = len(grid.x.values) * (1 if grid.y is None else len(grid.y.values))
    marks: list[Any] = []
    if not_passive := sum(cell.not_passive for cell in counted):
        label = f"not passive: {not_passive} case{'s' * (not_passive > 1)}"
        if grid.y is not None:
            face = _BAD if _shows_passivity(grid.metric) else "none"
            marks.append(Patch(facecolor=face, **{**_NOT_PASSIVE, "linewidth": 1.0}, label=label))
        else:
            marks.append(Line2D([], [], **_NOT_PASSIVE_POINT, label=label))
    if grid.y is not None and (len(counted) < wide or not all(cell.values for cell in counted)):
        marks.append(Patch(**_EMPTY, label="no value"))
    if any(cell.failed for cell in counted):
        style = {"marker": "x", "color": _FAILED["color"], "linestyle": "none", "markeredgewidth": 1.5}
        marks.append(Line2D([], [], **style, label=f"cases that failed: {sum(cell.failed for cell in counted)}"))
    if missing := sum(cell.missing for cell in counted):
        marks.append(Patch(facecolor="none", edgecolor="none", label=f"not run yet: {missing} cases"))
    return marks


def _title(grid: Grid, what: str, where: Sequence[str], name: str) -> str:
    over = f" over {', '.join(grid.over)}" if grid.over else ""
    words = f"{name}: {what}{over}" if name else f"{what}{over}"
    return ", ".join([words, f"where {', '.join(where)}"] if where else [words])


def _extremes(grid: Grid, figures: dict[tuple[int, int], float], label: str) -> str:
    """The smallest and the largest figure with their places, if they differ."""
    if not figures:
        return ""
    unit = label.partition(" [")[2].rstrip("]")
    if min(figures.values()) == (same := max(figures.values())):
        return f"{same:.3g} {unit}".rstrip() + " everywhere" if len(figures) > 1 else ""

    def described(word: str, place: tuple[int, int]) -> str:
        axes = [(grid.x, place[0])] + ([] if grid.y is None else [(grid.y, place[1])])
        at = ", ".join(f"{axis.name} {axis.words[index]}" for axis, index in axes)
        return f"{word} {figures[place]:.3g} {unit}".rstrip() + f" at {at}"

    least, most = min(figures, key=figures.__getitem__), max(figures, key=figures.__getitem__)
    return f"{described('least', least)}; {described('most', most)}"
