"""A figure that can be zoomed in a browser: matplotlib's drawing converted for plotly.js (extra `zoom`).

The figure is drawn once, in `hapnet.ext.pictures.run`; this module converts its lines and areas.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.resources import files
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from hapnet.recording.samples import plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DASHES = {"-": "solid", "--": "dash", "-.": "dashdot", ":": "dot"}
_PX_A_POINT = 96 / 72
_DIGITS = 6
"""Significant digits of numbers: more than a screen can resolve at any zoom."""


def can_zoom() -> bool:
    """Whether the extra is installed."""
    return find_spec("plotly") is not None


def library() -> str:
    """The source of plotly.js, to put into a page."""
    return files("plotly.package_data").joinpath("plotly.min.js").read_text("utf-8")


def zoomed(figure: Figure) -> str:
    """The figure for ``Plotly.newPlot``, as JSON: its panels one above the other, on one axis of time."""
    layout: dict[str, Any] = {
        "height": round(figure.get_figheight() * 96),
        "margin": {"l": 0, "r": 10, "t": 10, "b": 30},
        "hovermode": "x",
        "font": {"size": 11},
        "shapes": [],
    }
    data: list[dict[str, Any]] = []
    for k, panel in enumerate(figure.axes, 1):
        number = "" if k == 1 else str(k)
        (left, bottom), (right, top) = panel.get_position().get_points().tolist()
        timed = panel.get_xlabel() == "time [s]" or not panel.get_xlabel()
        layout[f"xaxis{number}"] = {
            "domain": [left, right], "anchor": f"y{number}", "zeroline": False, "title": {"text": panel.get_xlabel()},
            **({"matches": "x", "showticklabels": bool(panel.get_xlabel())} if timed and k > 1 else {}),
        }  # fmt: skip
        layout[f"yaxis{number}"] = {
            "domain": [bottom, top], "anchor": f"x{number}", "zeroline": False,
            "title": {"text": panel.get_ylabel(), "font": {"size": 10}},
            **({} if timed else {"scaleanchor": f"x{number}"}),
        }  # fmt: skip
        layout[f"legend{number}"] = {
            "x": left,
            "y": top,
            "yanchor": "bottom",
            "orientation": "h",
            "bgcolor": "rgba(0, 0, 0, 0)",
        }
        axes = {"xaxis": f"x{number}", "yaxis": f"y{number}", "legend": f"legend{number}"}
        data += [{**trace, **axes} for trace in _traces(panel)]
        layout["shapes"] += _shapes(panel, number)
    layout["xaxis"]["showticklabels"] = len(figure.axes) == 1
    return json.dumps(plain({"data": data, "layout": layout}), allow_nan=False).replace("</", "<\\/")


def _traces(panel: Axes) -> Iterator[dict[str, Any]]:
    """The lines of a panel that show data, and its areas."""
    from matplotlib.colors import to_hex

    for line in panel.lines:
        if line.get_transform() != panel.transData:
            continue
        label = str(line.get_label())
        yield {
            "x": _short(line.get_xdata()), "y": _short(line.get_ydata()), "mode": "lines",
            "name": label, "showlegend": not label.startswith("_"),
            "line": {
                "color": to_hex(line.get_color()), "width": line.get_linewidth() * _PX_A_POINT,
                "dash": _DASHES.get(str(line.get_linestyle()), "solid"),
                "shape": "hv" if line.get_drawstyle() == "steps-post" else "linear",
            },
        }  # fmt: skip
    for area in panel.collections:
        if area.get_transform() == panel.transData:
            for path in area.get_paths():
                corners = cast("Any", path.vertices)
                yield {
                    "x": _short(corners[:, 0]), "y": _short(corners[:, 1]), "mode": "lines", "fill": "toself",
                    "line": {"width": 0}, "fillcolor": _colour(area), "showlegend": False, "hoverinfo": "skip",
                }  # fmt: skip


def _shapes(panel: Axes, number: str) -> Iterator[dict[str, Any]]:
    """Return the marks over a panel's whole height or width: contacts, silences, bounds."""
    from matplotlib.colors import to_hex
    from matplotlib.patches import Rectangle

    high = {"xref": f"x{number}", "yref": f"y{number} domain", "y0": 0, "y1": 1}
    wide = {"yref": f"y{number}", "xref": f"x{number} domain", "x0": 0, "x1": 1}
    behind = {"type": "rect", "layer": "below", "line": {"width": 0}}
    for area in panel.collections:
        if area.get_transform() == panel.get_xaxis_transform():
            for path in area.get_paths():
                x = cast("Any", path.vertices)[:, 0]
                ends = {"x0": float(x.min()), "x1": float(x.max())}
                yield {**behind, **high, **ends, "fillcolor": _colour(area)}
    for patch in panel.patches:
        if isinstance(patch, Rectangle):
            x, y, colour = patch.get_x(), patch.get_y(), _colour(patch)
            if patch.get_data_transform() == panel.get_xaxis_transform():
                yield {**behind, **high, "x0": x, "x1": x + patch.get_width(), "fillcolor": colour}
            else:
                yield {**behind, **wide, "y0": y, "y1": y + patch.get_height(), "fillcolor": colour}
    for line in panel.lines:
        if line.get_transform() == panel.get_yaxis_transform():
            y = float(np.asarray(line.get_ydata())[0])
            yield {"type": "line", **wide, "y0": y, "y1": y, "line": {"color": to_hex(line.get_color()), "width": 1}}


def _colour(area: Any) -> str:
    """The colour of an area, translucent, so that everything below it is visible."""
    red, green, blue, alpha = np.atleast_2d(area.get_facecolor())[0].tolist()
    return f"rgba({round(255 * red)}, {round(255 * green)}, {round(255 * blue)}, {min(alpha, 0.5):g})"


def _short(values: Any) -> list[float]:
    return [float(f"{value:.{_DIGITS}g}") for value in np.asarray(values, dtype=float).tolist()]
