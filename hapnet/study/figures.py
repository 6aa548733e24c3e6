"""The comparison as figures: the traces of one case for all variants, and transparency against passivity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import ceil
from textwrap import fill
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from hapnet.checks import Array
from hapnet.metrics import METRICS
from hapnet.metrics.contact import pressed_wall
from hapnet.metrics.obstacles import normal_where_deepest
from hapnet.plant.worlds.walls import Wall
from hapnet.reports.style import MM, STYLE
from hapnet.study.case import Measured, simulated, was_passive
from hapnet.study.compare import Case, Outcome, Plan, Variant, by_hand
from hapnet.study.statistics import spreads

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours, which colour-blind people can distinguish, and a different mark for each
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#8C6D1F")
_MARKS = ("o", "s", "^", "D", "v", "P", "X", "p")
_OTHERS: dict[str, Any] = {"color": "0.8", "linewidth": 0.6, "zorder": 1}
_OUT = (
    "most energy that ever came out of both ports [mJ] (beyond d², shaded: not passive).\n"
    "Dots: cases (crosses: not passive). Marks: a variant's largest energy across, up the median over hands and its "
    "95 % interval\n(black edge: not all passive)"
)
_DASHED = (0, (3, 1.2))
_SHOWN_S = 5.0
_COLUMNS = 2
_STORY = 100  # characters of a line that the figure's width holds
_WIDTH_MM, _TOP_MM, _CELL_MM, _BOTTOM_MM = 180.0, 6.0, 56.0, 14.0
_SHADE: dict[str, Any] = {"facecolor": "#fcbba1", "edgecolor": "#cb181d", "hatch": "////", "alpha": 0.5, "lw": 0}


def traces(plan: Plan, cases: Sequence[Case]) -> Figure:
    """The same case for each variant: device, proxy and the force felt in colour, those of all other variants in grey.

    Drawn along the normal of the wall in which the first variant's device was deepest, or along the first axis, for
    the first 5 s.
    """
    runs = [simulated(case.params, case.seed) for case in cases]
    direction, surface_mm = _along(runs[0])
    about = cases[0]
    shown = min(_SHOWN_S, about.params.duration_s)
    curves = [_curves(run, direction, shown) for run in runs]
    rows = ceil(len(runs) / _COLUMNS)
    with _style():
        fig = _figure(_TOP_MM + _CELL_MM * rows + _BOTTOM_MM, layout=None)
        title = (
            f"the same hand ({about.operator}) over {about.link}, seed {about.seed}: the first {shown:g} s with each "
            "coupling; in grey the others"
        )
        fig.suptitle(title, fontsize=9, y=1.0 - 2.0 / _height_mm(fig), va="top", parse_math=False)
        fig.legend(handles=_legend(surface_mm), loc="lower center", ncols=3, fontsize=8)
        panels: list[tuple[Axes, Axes]] = []
        for k, (case, own) in enumerate(zip(cases, curves, strict=True)):
            first = panels[0] if panels else (None, None)
            top, bottom = panels_of_cell = _cell(fig, k, first)
            panels.append(panels_of_cell)
            for other in curves:
                top.plot(*other["device"], **_OTHERS)
                bottom.plot(*other["force"], **_OTHERS)
            if surface_mm is not None:
                top.axhline(surface_mm, color="0.4", linewidth=0.7, linestyle=":")
            colour = _mark(plan, case.variant)["color"]
            top.plot(*own["device"], color=colour, zorder=3)
            top.plot(*own["proxy"], color=colour, linestyle=_DASHED, linewidth=0.9, zorder=3)
            bottom.plot(*own["force"], color=colour, linewidth=0.8, zorder=3)
            top.set_title(str(case.variant), loc="left", fontsize=9, color=colour, fontweight="bold", pad=3.0)
            top.tick_params(labelbottom=False)
            if k % _COLUMNS == 0:
                top.set_ylabel("position [mm]")
                bottom.set_ylabel("force [N]")
            if k + _COLUMNS >= len(runs):
                bottom.set_xlabel("time [s]")
            else:
                bottom.tick_params(labelbottom=False)
        for panel in fig.axes:
            panel.set_xlim(0.0, shown)
    return fig


def _cell(fig: Figure, k: int, first: tuple[Axes | None, Axes | None]) -> tuple[Axes, Axes]:
    """The panels of positions and of forces in cell `k`; they share the scales of the first cell's."""
    height = _height_mm(fig)
    left = (16.0 + 83.0 * (k % _COLUMNS)) / _WIDTH_MM
    width = 78.0 / _WIDTH_MM
    top = height - _TOP_MM - _CELL_MM * (k // _COLUMNS)

    def panel(above_mm: float, high_mm: float, share_y: Axes | None) -> Axes:
        made = fig.add_axes((left, (top - above_mm - high_mm) / height, width, high_mm / height), sharey=share_y)
        made.tick_params(labelleft=k % _COLUMNS == 0)
        return made

    return panel(5.0, 24.0, first[0]), panel(31.0, 20.0, first[1])


def tradeoff(plan: Plan, outcomes: Sequence[Outcome]) -> Figure:
    """True force error and rendered stiffness against the most energy that ever came out of both ports.

    There is a panel for each metric and link. A dot is a case. A mark is at the median of the metric and at the largest
    energy of a variant's cases, since a claim of passivity concerns the worst case. The energy axis is linear up to d^2
    and logarithmic beyond, where a coupling is not passive and the energy may be any amount; that part is shaded.
    """
    metrics = ("true_force_error_percent", "stiffness_percent")
    links = list(plan.links)
    fig = _figure(64.0 * len(metrics) + 24.0)
    with _style():
        panels = fig.subplots(len(metrics), len(links), sharex=True, sharey="row", squeeze=False)
        for row, metric in zip(panels, metrics, strict=True):
            for panel, link in zip(row, links, strict=True):
                for variant in plan.variants:
                    ours = [one for one in outcomes if (one.case.variant, one.case.link) == (variant, link)]
                    _points(panel, _mark(plan, variant), ours, metric)
            row[0].set_ylabel(METRICS[metric].heading)
        _axes(panels, links, _bound_mJ(outcomes), max(_out_mJ(outcomes), default=0.0))
        fig.supxlabel(_OUT, fontsize=8)
        marks = [panels[0][0].plot([], [], label=str(one), **_mark(plan, one))[0] for one in plan.variants]
        reported = story(plan, outcomes)  # as the legend's title: a figure's own title would lie on the legend
        legend = fig.legend(
            handles=marks,
            loc="outside upper center",
            ncols=_columns(plan.variants),
            fontsize=8,
            title=reported,
            title_fontsize=9,
        )
        legend.get_title().set(multialignment="center", parse_math=False)
    return fig


def story(plan: Plan, outcomes: Sequence[Outcome]) -> str:
    """What the figure of all cases shows, in one or two lines: who was passive, and who of them felt most true."""
    lost: dict[str, list[str]] = {}
    errors: dict[str, list[float]] = {}
    for variant in plan.variants:
        for link in plan.links:
            these = [one for one in outcomes if (one.case.variant, one.case.link) == (variant, link)]
            ours = [one.measures for one in these]
            if not all(was_passive(measures) for measures in ours if measures):
                lost.setdefault(str(variant), []).append(link)
            found = dict(spreads(by_hand(these))).get("true_force_error_percent")
            if found is not None:
                errors.setdefault(str(variant), []).append(found.median)
    kept = {name: values for name, values in errors.items() if name not in lost}
    who, lines = "", ["every coupling was passive in all cases"]
    if lost:
        who = "of the others "
        lines = [f"not passive in all cases: {', '.join(f'{name} ({_some(links)})' for name, links in lost.items())}"]
    if kept:
        best = min(kept, key=lambda name: max(kept[name]))
        low, high = min(kept[best]), max(kept[best])
        spread = f"{low:.2g} %" if f"{low:.2g}" == f"{high:.2g}" else f"{low:.2g} to {high:.2g} %"
        lines.append(f"{who}{best} has the smallest force error: {spread} (a link's median)")
    return "\n".join(fill(line, _STORY) for line in lines)


def _columns(variants: Sequence[Variant]) -> int:
    """How many of their names have room side by side, with a mark each."""
    widths = [len(str(one)) + 7 for one in variants]
    return len(widths) if sum(widths) <= _STORY + 10 else max(1, min(len(widths), _STORY // max(widths)))


def _some(links: Sequence[str]) -> str:
    return ", ".join(links) if len(links) <= 3 else f"{len(links)} links"


def _axes(panels: Any, links: Sequence[str], bound: float, most: float) -> None:
    """Set scales, ticks and shades. `bound` : d^2; `most` : the most energy that ever came out [mJ]."""
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
    force, stiffness = (row[0] for row in panels)
    force.set_yscale("symlog", linthresh=10.0)
    top = max(force.get_ylim()[1], 20.0)
    force.set_ylim(-1.0, top)
    ticks = [tick for tick in (0.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0) if tick <= top]
    force.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    force.set_yticks([], minor=True)
    low, high = stiffness.get_ylim()
    stiffness.set_ylim(max(min(low, 80.0), -50.0), min(max(high, 120.0), 250.0))  # of a graze it may be anything
    for panel in panels.flat:
        panel.axvspan(bound, right, zorder=0, **_SHADE)
        panel.axvline(bound, color="#cb181d", linewidth=1.0)


def _points(panel: Axes, mark: dict[str, Any], outcomes: Sequence[Outcome], metric: str) -> None:
    """Draw a variant over a link: its cases, and its mark."""
    pairs = [
        (1e3 * out, value, was_passive(m))
        for one in outcomes
        if (m := one.measures) and (out := m["energy_out_J"]) is not None and (value := m[metric]) is not None
    ]
    most = _out_mJ(outcomes)
    if not pairs or not most:
        return
    x, y, passive = np.array(pairs, dtype=float).T
    kept = passive == 1.0
    dots: dict[str, Any] = {"color": mark["color"], "linestyle": "none", "zorder": 2}
    panel.plot(x[kept], y[kept], marker=".", markersize=4.0, alpha=0.6, markeredgewidth=0.0, **dots)
    panel.plot(x[~kept], y[~kept], marker="x", markersize=4.5, markeredgewidth=1.2, **dots)
    bad = not all(was_passive(one.measures) for one in outcomes if one.measures)
    filled = {"markerfacecolor": mark["color"], "markeredgecolor": "black", "markersize": 9.0} if bad else {}
    spread = dict(spreads(by_hand(outcomes)))[metric]
    if spread.low is not None and spread.high is not None:
        panel.vlines(max(most), spread.low, spread.high, colors=mark["color"], linewidth=1.2, zorder=3)
    panel.plot(max(most), spread.median, **{**mark, **filled}, zorder=4 if bad else 3)


def _out_mJ(outcomes: Sequence[Outcome]) -> list[float]:
    """The most energy that came out [mJ], for each case in which it is known."""
    return [1e3 * out for one in outcomes if one.measures and (out := one.measures["energy_out_J"]) is not None]


def _bound_mJ(outcomes: Sequence[Outcome]) -> float:
    """d^2 [mJ], which is the same for all cases."""
    known = (one.measures for one in outcomes if one.measures)
    bounds = [
        1e3 * (margin + out)
        for m in known
        if (margin := m["margin_J"]) is not None and (out := m["energy_out_J"]) is not None
    ]
    return max(bounds, default=0.0)


def _mark(plan: Plan, variant: Variant) -> dict[str, Any]:
    """Colour and mark of a coupling: an outline, so that marks in the same place all show; filled with a deadband."""
    k = plan.couplings.index(variant.coupling)
    colour = COLOURS[k % len(COLOURS)]
    return {
        "color": colour,
        "marker": _MARKS[k % len(_MARKS)],
        "linestyle": "",
        "markersize": 6.5,
        "markeredgewidth": 1.2,
        "markerfacecolor": colour if variant.deadband else "none",
    }


def _legend(surface_mm: float | None) -> list[Any]:
    from matplotlib.lines import Line2D

    solid = Line2D([], [], color="0.2", label="device; force on it")
    dashed = Line2D([], [], color="0.2", linewidth=0.9, linestyle=_DASHED, label="proxy")
    wall = Line2D([], [], color="0.4", linewidth=0.7, linestyle=":", label="the wall's surface")
    return [solid, dashed, wall][: 2 if surface_mm is None else 3]


def _along(run: Measured) -> tuple[Array, float | None]:
    """The direction along which to draw (n,), and the position of the wall's surface on it [mm]."""
    device = run.recording.device
    assert device is not None
    wall = pressed_wall(device, run.walls or ())
    if wall is None:
        return np.eye(device["position_m"].shape[1])[0], None
    normal = normal_where_deepest(wall, device["position_m"])
    return np.array(normal), 1e3 * wall.offset if isinstance(wall, Wall) else None


def _curves(run: Measured, direction: Array, until_s: float) -> Mapping[str, tuple[Array, Array]]:
    """Times [s] and values of the curves: positions [mm], and the force that resists the hand [N]."""
    device, world = run.recording.device, run.recording.world
    assert device is not None
    assert world is not None
    felt, moved = device["time_s"] <= until_s, world["time_s"] <= until_s
    return {
        "device": (device["time_s"][felt], 1e3 * (device["position_m"][felt] @ direction)),
        "proxy": (world["time_s"][moved], 1e3 * (world["position_m"][moved] @ direction)),
        "force": (device["time_s"][felt], -(device["force_N"][felt] @ direction)),
    }


def _style() -> Any:
    import matplotlib

    return matplotlib.rc_context(STYLE)


def _figure(height_mm: float, layout: Literal["constrained"] | None = "constrained") -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    fig = Figure(figsize=(_WIDTH_MM * MM, height_mm * MM), dpi=150, layout=layout)
    FigureCanvasAgg(fig)
    return fig


def _height_mm(fig: Figure) -> float:
    return float(fig.get_figheight() / MM)
