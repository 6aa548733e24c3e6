"""The style of all figures (for print, 180 mm wide, text of 8 points and more), and functions that write them."""

from __future__ import annotations

import io
import json
import os
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from hapnet.recording.whole_file import complete_or_absent

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MM = 1 / 25.4
"""A millimetre in inches, matplotlib's unit."""

WIDTH_MM = 180.0

DEVICE_COLOR, WORLD_COLOR = "#08306b", "#e6550d"

# Okabe and Ito's colours, which colour-blind people can tell apart
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#8C6D1F", "#7A3E9D")

NOT_PASSIVE: dict[str, Any] = {"facecolor": "#fcbba1", "edgecolor": "#cb181d", "hatch": "////", "lw": 0, "zorder": 0}
"""The style of the part of a panel in which a coupling is not passive."""

STYLE: dict[Any, Any] = {  # Any: matplotlib types its keys as literals
    "font.size": 8.0,
    "axes.titlesize": 9.0,
    "axes.grid": True,
    "grid.linewidth": 0.4,
    "grid.color": "0.85",
    "lines.linewidth": 1.1,
    "legend.frameon": False,
    "hatch.linewidth": 0.4,
    "path.simplify_threshold": 0.2,
}


@contextmanager
def sheet(
    height_mm: float, width_mm: float = WIDTH_MM, layout: Literal["constrained"] | None = "constrained"
) -> Iterator[Figure]:
    """A context with an empty figure, in which everything is drawn in the common style."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        fig = Figure(figsize=(width_mm * MM, height_mm * MM), dpi=150, layout=layout)
        FigureCanvasAgg(fig)
        yield fig


def headed(fig: Figure, *paragraphs: str, letters: int = 105, **more: Any) -> None:
    """Put a title above a figure, in lines of at most `letters`; a no-break space keeps two words in a line."""
    lines = [line for paragraph in paragraphs for line in textwrap.wrap(paragraph, letters)]
    fig.suptitle("\n".join(lines).replace("\N{NO-BREAK SPACE}", " "), fontsize=9, parse_math=False, **more)


def legend_above(panel: Axes, **style: Any) -> None:
    """Put a panel's legend above it, where it cannot cover data; no legend if nothing has a label."""
    handles, labels = panel.get_legend_handles_labels()
    if handles:
        usual = {"ncols": len(handles), "fontsize": 8, "borderaxespad": 0.1}
        panel.legend(handles, labels, loc="lower left", bbox_to_anchor=(0.0, 1.0), **{**usual, **style})


def log_ticks(axis: Any, low: float, high: float) -> None:
    """Put plain numbers on a logarithmic axis from `low` to `high`; over few decades also at 2 and 5 of each decade."""
    from matplotlib.ticker import LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 200.0 * low else (1.0,)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def also_to(fig: Figure, file: str | os.PathLike[str] | None) -> Figure:
    """Return `fig`, after writing it to `file` (.png, .pdf, .svg), if given."""
    if file is not None:
        with complete_or_absent(Path(file), "figure") as part:
            fig.savefig(part, format=Path(file).suffix.removeprefix(".") or None)
    return fig


def png(fig: Figure) -> bytes:
    """`fig` as a PNG, with its texts and the ranges of its curves as the description in the file."""
    out = io.BytesIO()
    fig.savefig(out, format="png", dpi=150, metadata={"Description": described(fig)})
    return out.getvalue()


def described(fig: Figure) -> str:
    """JSON with `texts`: titles, labels and legends; and `curves`: least, mean and largest value of each curve and bar
    along each axis."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Rectangle
    from matplotlib.text import Text

    fig.draw_without_rendering()  # lays out, and makes the legends
    drawn: list[Any] = [text for text in fig.findobj(Text) if text.get_visible()]
    texts = [text.get_text() for text in drawn if any(letter.isalpha() for letter in text.get_text())]
    curves: list[list[float]] = []
    for axes in fig.axes:
        lines: list[Any] = axes.findobj(Line2D, include_self=False)
        own = [line for line in lines if line in axes.lines]
        series = [values for line in own for values in getattr(line, "get_data_3d", line.get_data)()]
        series += [[bar.get_width(), bar.get_height()] for bar in axes.patches if isinstance(bar, Rectangle)]
        for values in series:
            known = np.asarray(values, dtype=float)
            known = known[np.isfinite(known)]
            curves += [[float(f"{f(known):.4g}") for f in (np.min, np.mean, np.max)]] if len(known) else []
    return json.dumps({"texts": texts, "curves": curves}, ensure_ascii=False)


def save(data: bytes, path: str | os.PathLike[str], what: str) -> None:
    """Write `data`. Raises `RecordingError` if it cannot be written; `what` is its name in the message."""
    with complete_or_absent(Path(path), what) as part:
        part.write_bytes(data)


def save_figure(fig: Figure, path: str | os.PathLike[str]) -> None:
    """Write `fig` as a PNG. Raises `RecordingError` if it cannot be written."""
    save(png(fig), path, "figure")
