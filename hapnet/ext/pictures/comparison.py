"""The figures of a comparison: the traces of a case for all variants, and transparency over passivity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import ceil
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hapnet.checks import Array
from hapnet.ext.metrics import METRICS
from hapnet.ext.pictures.style import COLOURS, MM, NOT_PASSIVE, WIDTH_MM, sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MARKS = ("o", "s", "^", "D", "v", "P", "X", "p", "*")
_OTHERS: dict[str, Any] = {"color": "0.8", "linewidth": 0.6, "zorder": 1}
_OUT = (
    "most energy that came out of both ports [mJ] (beyond d², shaded: not passive).\n"
    "Dots: cases (crosses: not passive). Marks: a variant at its largest energy (x), and at the median over hands with "
    "its 95 % interval (y)\n(black edge: not all passive)"
)
_DASHED = (0, (3, 1.2))
_COLUMNS = 2
STORY = 100  # characters of a line that fits into the figure's width
_TOP_MM, _CELL_MM, _BOTTOM_MM = 6.0, 56.0, 14.0
TRUE_ERROR, STIFFNESS = "true_force_error_percent", "stiffness_percent"


class Look(NamedTuple):
    """A variant's name, and the number of its coupling, for colour and mark. `filled`: with a deadband."""

    name: str
    coupling: int
    filled: bool = False

    @property
    def color(self) -> str:
        return COLOURS[self.coupling % len(COLOURS)]

    @property
    def mark(self) -> dict[str, Any]:
        """An outline, so that marks in the same place are all visible."""
        return {
            "color": self.color,
            "marker": _MARKS[self.coupling % len(_MARKS)],
            "linestyle": "",
            "markersize": 6.5,
            "markeredgewidth": 1.2,
            "markerfacecolor": self.color if self.filled else "none",
        }


class Traces(NamedTuple):
    """Times [s] and values of a run: positions of device and proxy [mm], and the force that resists the hand [N]."""

    device: tuple[Array, Array]
    proxy: tuple[Array, Array]
    force: tuple[Array, Array]


class Points(NamedTuple):
    """A variant over a link: for each case the energy that came out [mJ], the metric, and whether it was passive.

    median, low, high : of the metric, over hands. passive : True if all cases were. out_mJ : the largest energy.
    """

    cases: Sequence[tuple[float, float, bool]]
    median: float
    low: float | None
    high: float | None
    passive: bool
    out_mJ: float


def traces(
    title: str, looks: Sequence[Look], runs: Sequence[Traces], shown_s: float, surface_mm: float | None
) -> Figure:
    """The same case for each variant: device, proxy and felt force in colour, and those of the other variants in grey.

    surface_mm : the position of the wall's surface.
    """
    with sheet(_TOP_MM + _CELL_MM * ceil(len(runs) / _COLUMNS) + _BOTTOM_MM, layout=None) as fig:
        fig.suptitle(title, fontsize=9, y=1.0 - 2.0 / _height_mm(fig), va="top", parse_math=False)
        fig.legend(handles=_legend(surface_mm), loc="lower center", ncols=3, fontsize=8)
        first: tuple[Axes | None, Axes | None] = None, None
        for k, (look, own) in enumerate(zip(looks, runs, strict=True)):
            top, bottom = _cell(fig, k, first)
            first = (top, bottom) if k == 0 else first
            for other in runs:
                top.plot(*other.device, **_OTHERS)
                bottom.plot(*other.force, **_OTHERS)
            if surface_mm is not None:
                top.axhline(surface_mm, color="0.4", linewidth=0.7, linestyle=":")
            top.plot(*own.device, color=look.color, zorder=3)
            top.plot(*own.proxy, color=look.color, linestyle=_DASHED, linewidth=0.9, zorder=3)
            bottom.plot(*own.force, color=look.color, linewidth=0.8, zorder=3)
            top.set_title(look.name, loc="left", fontsize=9, color=look.color, fontweight="bold", pad=3.0)
            top.tick_params(labelbottom=False)
            if k % _COLUMNS == 0:
                top.set_ylabel("position [mm]")
                bottom.set_ylabel("force [N]")
            if k + _COLUMNS >= len(runs):
                bottom.set_xlabel("time [s]")
            else:
                bottom.tick_params(labelbottom=False)
        for panel in fig.axes:
            panel.set_xlim(0.0, shown_s)
    return fig


def _cell(fig: Figure, k: int, first: tuple[Axes | None, Axes | None]) -> tuple[Axes, Axes]:
    """The panels of positions and of forces in cell `k`, which share the scales of the first cell's panels."""
    height = _height_mm(fig)
    left = (16.0 + 83.0 * (k % _COLUMNS)) / WIDTH_MM
    width = 78.0 / WIDTH_MM
    top = height - _TOP_MM - _CELL_MM * (k // _COLUMNS)

    def panel(above_mm: float, high_mm: float, share_y: Axes | None) -> Axes:
        axes = fig.add_axes((left, (top - above_mm - high_mm) / height, width, high_mm / height), sharey=share_y)
        axes.tick_params(labelleft=k % _COLUMNS == 0)
        return axes

    return panel(5.0, 24.0, first[0]), panel(31.0, 20.0, first[1])


def tradeoff(
    story: str,
    looks: Sequence[Look],
    links: Sequence[str],
    found: Mapping[str, Mapping[str, Sequence[Points | None]]],
    bound_mJ: float,
    most_mJ: float,
) -> Figure:
    """True force error and rendered stiffness over the most energy that came out of both ports.

    There is a panel for each link, and for each metric that a case has. A dot is a case. A mark is at the median of the
    metric and at the largest energy of a variant's cases, as a claim of passivity concerns the worst case. The
    energy axis is linear up to d^2 and logarithmic beyond; that part, where a coupling is not passive, is shaded.

    found : by metric (`TRUE_ERROR`, `STIFFNESS`) and link, for each look. bound_mJ : d^2. most_mJ : largest energy out.
    """
    found = {metric: over for metric, over in found.items() if any(map(any, over.values()))} or found
    with sheet(64.0 * len(found) + 24.0) as fig:
        panels = fig.subplots(len(found), len(links), sharex=True, sharey="row", squeeze=False)
        for row, (metric, over) in zip(panels, found.items(), strict=True):
            for panel, link in zip(row, links, strict=True):
                for look, points in zip(looks, over[link], strict=True):
                    if points is not None:
                        _points(panel, look.mark, points)
            row[0].set_ylabel(METRICS[metric].heading)
        _axes(panels, dict(zip(found, panels[:, 0], strict=True)), links, bound_mJ, most_mJ)
        fig.supxlabel(_OUT, fontsize=8)
        marks = [panels[0][0].plot([], [], label=look.name, **look.mark)[0] for look in looks]
        legend = fig.legend(  # with a title, as a figure's own title would lie on it
            handles=marks, loc="outside upper center", ncols=_columns(looks), fontsize=8, title=story, title_fontsize=9
        )
        legend.get_title().set(multialignment="center", parse_math=False)
    return fig


def _columns(looks: Sequence[Look]) -> int:
    """The number of their names that fit side by side, with a mark each."""
    widths = [len(one.name) + 7 for one in looks]
    return len(widths) if sum(widths) <= STORY else max(1, min(len(widths), STORY // max(widths)))


def _axes(panels: Any, first: Mapping[str, Any], links: Sequence[str], bound: float, most: float) -> None:
    """Set scales, ticks and shades.

    first : each metric's first panel. bound : d^2; most : the most energy that ever came out [mJ].
    """
    right = max(2.0 * most, 1.6 * bound, 1e-6)
    for panel, link in zip(panels[0], links, strict=True):
        panel.set_title(link, fontsize=9)
        panel.set_xscale("symlog", linthresh=bound or 1.0, linscale=0.8)
        panel.set_xlim(-0.06 * (bound or 1.0), right)
        decades = [bound * 10.0**k for k in range(12) if bound * 10.0**k <= right]
        every = -(-len(decades) // (3 if len(links) <= 3 else 1)) or 1  # what the panels have room for
        ticks = sorted({0.0, bound, *decades[::every], *decades[-1:]})
        panel.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        panel.set_xticks([], minor=True)
    if (force := first.get(TRUE_ERROR)) is not None:
        force.set_yscale("symlog", linthresh=10.0)
        top = max(1.1 * force.get_ylim()[1], 20.0)
        force.set_ylim(-1.0, top)
        ticks = [tick for tick in (0.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0) if tick <= top]
        force.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
        force.set_yticks([], minor=True)
    if (stiffness := first.get(STIFFNESS)) is not None:
        low, high = stiffness.get_ylim()
        stiffness.set_ylim(max(min(low, 80.0), -50.0), min(max(high, 120.0), 250.0))  # a graze may have any stiffness
    for panel in panels.flat:
        panel.axvspan(bound, right, alpha=0.5, **NOT_PASSIVE)
        panel.axvline(bound, color="#cb181d", linewidth=1.0)


def _points(panel: Axes, mark: dict[str, Any], found: Points) -> None:
    """Draw a variant over a link: its cases, and its mark."""
    x, y, passive = np.array(found.cases, dtype=float).T
    kept = passive == 1.0
    dots: dict[str, Any] = {"color": mark["color"], "linestyle": "none", "zorder": 2}
    panel.plot(x[kept], y[kept], marker=".", markersize=4.0, alpha=0.6, markeredgewidth=0.0, **dots)
    panel.plot(x[~kept], y[~kept], marker="x", markersize=4.5, markeredgewidth=1.2, **dots)
    bad = {"markerfacecolor": mark["color"], "markeredgecolor": "black", "markersize": 9.0}
    if found.low is not None and found.high is not None:
        panel.vlines(found.out_mJ, found.low, found.high, colors=mark["color"], linewidth=1.2, zorder=3)
    panel.plot(found.out_mJ, found.median, **(mark if found.passive else mark | bad), zorder=3 if found.passive else 4)


def _legend(surface_mm: float | None) -> list[Any]:
    from matplotlib.lines import Line2D

    solid = Line2D([], [], color="0.2", label="device; force on it")
    dashed = Line2D([], [], color="0.2", linewidth=0.9, linestyle=_DASHED, label="proxy")
    wall = Line2D([], [], color="0.4", linewidth=0.7, linestyle=":", label="the wall's surface")
    return [solid, dashed, wall][: 2 if surface_mm is None else 3]


def _height_mm(fig: Figure) -> float:
    return float(fig.get_figheight() / MM)
