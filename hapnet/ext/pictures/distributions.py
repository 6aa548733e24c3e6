"""The figure of a benchmark: the distributions of measured values and of a bare reference."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hapnet.checks import Array
from hapnet.ext.pictures.style import DEVICE_COLOR, WORLD_COLOR, log_ticks, sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BINS = 60
_COLUMNS = 3
_SUBJECT: dict[str, Any] = {"color": DEVICE_COLOR}
_BARE: dict[str, Any] = {"color": WORLD_COLOR}
_SHADE = 0.25


class Values(NamedTuple):
    """Measured values, ascending, how often each occurred, and the two figures that are marked."""

    values: Array
    counts: Array
    median: float
    p99: float


class Panel(NamedTuple):
    """A measurement: name and unit, the title, and its values beside the reference's, if there is one."""

    name: str
    title: str
    subject: Values
    bare: Values | None


def draw(rows: Sequence[Panel]) -> Figure:
    """A panel for every row: the shares of values in each bin, for subject and reference."""
    from matplotlib.colors import to_rgb
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    columns = max(1, min(_COLUMNS, len(rows)))
    lines = max(1, math.ceil(len(rows) / columns))
    with sheet(52 * lines + 10, 85 * max(2, columns)) as fig:
        panels = fig.subplots(lines, columns, squeeze=False)
        for panel, row in zip(panels.ravel(), rows, strict=False):
            _panel(panel, row)
        for panel in panels.ravel()[len(rows) :]:
            panel.set_visible(False)
        for panel in panels[:, 0]:
            panel.set_ylabel("share of values")
        key = [
            Patch(facecolor=(*to_rgb(DEVICE_COLOR), _SHADE), edgecolor=DEVICE_COLOR),
            Line2D([], [], **_BARE),
            Line2D([], [], color="0.3", linestyle="--"),
            Line2D([], [], color="0.3", linestyle=":"),
        ]
        fig.legend(key, ["hapnet", "bare reference", "median", "p99"], loc="outside upper center", ncols=4)
    return fig


def _panel(panel: Axes, row: Panel) -> None:
    parts = [(row.subject, _SUBJECT), *([] if row.bare is None else [(row.bare, _BARE)])]
    low = min(part.values[part.values > 0.0].min(initial=np.inf) for part, _ in parts)
    high = max(part.values[-1] for part, _ in parts)
    edges = np.geomspace(low * 0.9, max(high, low) * 1.1, _BINS + 1)
    for part, style in parts:
        counts, _ = np.histogram(np.maximum(part.values, edges[0]), bins=edges, weights=part.counts)
        share = counts / part.counts.sum()
        if style is _SUBJECT:
            panel.stairs(share, edges, fill=True, alpha=_SHADE, **style)
        panel.stairs(share, edges, linewidth=1.1, **style)
        for value, dash in ((part.median, "--"), (part.p99, ":")):
            panel.axvline(value, linestyle=dash, linewidth=1.0, **style)
    panel.set(xscale="log", yscale="log", xlabel=row.name, ylim=(None, 2.0))
    log_ticks(panel.xaxis, edges[0], edges[-1])
    panel.set_title(row.title, loc="left")
    panel.set_axisbelow(True)
