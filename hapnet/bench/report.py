"""What people look at after a benchmark: the table, and the histograms of subject and reference."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hapnet.bench.row import Distribution, Figures, Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.console import RenderableType

_ENOUGH = 50  # values, for a histogram
_BINS = 60
_COLUMNS = 3
_MM = 1 / 25.4
_SUBJECT: dict[str, Any] = {"color": "#08306b"}
_BARE: dict[str, Any] = {"color": "#e6550d"}
_SHADE = 0.25


def table(rows: Sequence[Row]) -> RenderableType:
    """One line per row: min, median, p99; the reference's median and p99; ratios; limits, and if each is met."""
    from rich import box
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    out = Table(box=box.SIMPLE_HEAD, pad_edge=False, title_justify="left")
    out.add_column("", no_wrap=True)
    out.add_column("unit")
    for heading in ("min", "median", "p99", "bare median", "bare p99", "ratio", "ratio p99"):
        out.add_column(heading, justify="right")
    out.add_column("allowed")
    for row in rows:
        allowed = Text("\n").join(
            Text(f"{limit} {'ok' if met else 'MISSED'}", style="" if met else "bold red")
            for limit, met in row.verdicts()
        )
        out.add_row(
            row.name, row.unit, *_numbers(row.figures), *_numbers(row.reference)[1:], _number(row.ratio),
            _number(row.ratio_p99), allowed,
        )  # fmt: skip
    remarks = [Text(line) for row in rows for line in _remarks(row)]
    key = [Text(f"{row.name}: {row.what}; bare: {row.against}", style="dim") for row in rows if row.panel]
    return Group(out, *remarks, *key)


def has_histogram(row: Row) -> bool:
    """Whether the figure has a panel for this row: it needs enough values."""
    return row.panel and row.samples is not None and row.samples.counts.sum() >= _ENOUGH


def figure(rows: Sequence[Row]) -> Figure:
    """A panel for every row with enough values: the shares of values in each bin, for subject and reference."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    drawn = [row for row in rows if has_histogram(row)]
    columns = max(1, min(_COLUMNS, len(drawn)))
    lines = max(1, math.ceil(len(drawn) / columns))
    style: dict[Any, Any] = {"font.size": 8.0, "axes.titlesize": 9.0, "legend.frameon": False}
    with matplotlib.rc_context(style):
        fig = Figure(figsize=(85 * max(2, columns) * _MM, (52 * lines + 10) * _MM), dpi=150, layout="constrained")
        FigureCanvasAgg(fig)
        panels = fig.subplots(lines, columns, squeeze=False)
        for panel, row in zip(panels.ravel(), drawn, strict=False):
            _panel(panel, row)
        for panel in panels.ravel()[len(drawn) :]:
            panel.set_visible(False)
        for panel in panels[:, 0]:
            panel.set_ylabel("share of values")
        key = [
            Patch(facecolor=(*matplotlib.colors.to_rgb(_SUBJECT["color"]), _SHADE), edgecolor=_SUBJECT["color"]),
            Line2D([], [], **_BARE),
            Line2D([], [], color="0.3", linestyle="--"),
            Line2D([], [], color="0.3", linestyle=":"),
        ]
        fig.legend(key, ["hapnet", "bare reference", "median", "p99"], loc="outside upper center", ncols=4)
    return fig


def save_figure(rows: Sequence[Row], path: Path) -> Path:
    """Draw the figure and write it; returns the path."""
    from hapnet import reports

    reports.save_figure(figure(rows), path)
    return path


def _panel(panel: Axes, row: Row) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    assert row.samples is not None
    parts = [(row.samples, row.figures, _SUBJECT)]
    if row.bare is not None:
        parts.append((row.bare, row.reference, _BARE))
    low = min(part.values[part.values > 0.0].min(initial=np.inf) for part, _, _ in parts)
    high = max(part.values[-1] for part, _, _ in parts)
    edges = np.geomspace(low * 0.9, max(high, low) * 1.1, _BINS + 1)
    for part, figures, style in parts:
        share = _histogram(part, edges)
        if style is _SUBJECT:
            panel.stairs(share, edges, fill=True, alpha=_SHADE, **style)
        panel.stairs(share, edges, linewidth=1.1, **style)
        assert figures is not None
        # the table's figures, whose ratio is in the title; quantiles over all rounds together would differ
        for value, dash in ((figures.median, "--"), (figures.p99, ":")):
            panel.axvline(value, linestyle=dash, linewidth=1.0, **style)
    panel.set(xscale="log", yscale="log", xlabel=f"{row.name} [{row.unit}]", ylim=(None, 2.0))
    close = edges[-1] < 30.0 * edges[0]
    panel.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if close else (1.0,)))
    panel.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    panel.xaxis.set_minor_formatter(NullFormatter())
    ratio = "" if row.ratio is None else f"{_number(row.ratio)} times the reference, p99 {_number(row.ratio_p99)}"
    panel.set_title(ratio, loc="left")
    panel.grid(visible=True, color="0.9", linewidth=0.4)
    panel.set_axisbelow(True)


def _histogram(part: Distribution, edges: Any) -> Any:
    """The share of all values in each bin."""
    counts, _ = np.histogram(np.maximum(part.values, edges[0]), bins=edges, weights=part.counts)
    return counts / part.counts.sum()


def _remarks(row: Row) -> list[str]:
    out = []
    if row.note:
        out.append(f"{row.name}: {row.note}")
    if "late_period" in row.more:
        ours, theirs, skipped, bare_skipped = (
            f"{100.0 * row.more[name]:.3f} %" for name in ("late_period", "late_period_bare", "skipped", "skipped_bare")
        )
        out.append(
            f"{row.name}: ticks late by a period or more: {ours}, of the bare loop's {theirs}; "
            f"deadlines skipped for each tick: {skipped}, {bare_skipped}"
        )
    return out


def _numbers(figures: Figures | None) -> list[str]:
    if figures is None:
        return ["-"] * 3
    return [_number(value) for value in (figures.minimum, figures.median, figures.p99)]


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
