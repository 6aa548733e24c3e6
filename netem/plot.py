"""A figure of a link's effect on a stream of messages."""

from __future__ import annotations

import textwrap
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from netem.errors import NetemError
from netem.survey import Survey

_STYLE = {"font.size": 8.0, "axes.titlesize": 8.0, "axes.grid": True, "grid.linewidth": 0.4, "grid.color": "0.88"}
_POINTS = 2000  # number of messages drawn as points
_PAD = 8.0
_DELAY, _LOSS = "#08306b", "#e6550d"


def figure(survey: Survey, interval_ns: int) -> Figure:
    """The first messages' delays and losses over time, and the histogram of all delays."""
    with rc_context(_STYLE):  # type: ignore[arg-type]  # matplotlib types its keys as literals
        drawn = Figure(figsize=(8.5, 3.6), dpi=150, layout="constrained")
        FigureCanvasAgg(drawn)
        time, histogram = drawn.subplots(1, 2, width_ratios=(4, 3))
        _over_time(time, survey, interval_ns)
        _histogram(histogram, survey)
        words = "\n".join(textwrap.wrap(survey.stats.profile or "(nothing)", 100))
        drawn.suptitle(words, fontsize=9)
    return drawn


def save(survey: Survey, interval_ns: int, path: str) -> None:
    """Write the figure as PNG.

    Raises NetemError: the file cannot be written.
    """
    try:
        with Path(path).open("wb") as file:
            figure(survey, interval_ns).savefig(file, format="png")
    except OSError as error:
        raise NetemError(f"--png: cannot write {path}: {error.strerror}") from error


def _over_time(axes: Axes, survey: Survey, interval_ns: int) -> None:
    delays = survey.delays_ms[:_POINTS]
    sent_s = np.arange(len(delays)) * interval_ns * 1e-9
    missing = np.isnan(delays)
    axes.plot(sent_s, delays, ".", color=_DELAY, markersize=2, label="delivered")
    if missing.any():
        top = np.ones(int(missing.sum()))
        (marks,) = axes.plot(sent_s[missing], top, "|", color=_LOSS, transform=axes.get_xaxis_transform())
        marks.set(markersize=7, label="not delivered", clip_on=False)
    axes.set(xlabel="sent at [s]", ylabel="delay [ms]")
    axes.set_title(f"the first {len(delays)} of {survey.stats.offered}", loc="left", pad=_PAD)
    axes.set_ylim(bottom=0.0)
    _legend(axes)


def _histogram(axes: Axes, survey: Survey) -> None:
    stats = survey.stats
    arrived = survey.delays_ms[~np.isnan(survey.delays_ms)]
    if len(arrived):
        axes.hist(arrived, bins=80, color=_DELAY, alpha=0.75)
        for share, style in ((50, "--"), (99, ":")):
            value = float(np.percentile(arrived, share))
            axes.axvline(value, color="black", linestyle=style, linewidth=0.9, label=f"p{share} {value:.3g} ms")
        _legend(axes)
    lost = 100.0 * (1.0 - len(arrived) / stats.offered)
    axes.set(xlabel="delay [ms]", ylabel="messages")
    axes.set_axisbelow(True)
    axes.set_title(f"{lost:.2f} % not delivered", loc="left", pad=_PAD)


def _legend(axes: Axes) -> None:
    axes.legend(
        loc="lower right", bbox_to_anchor=(1.02, 1.0), ncols=2, frameon=False, columnspacing=1.0, handlelength=1.5
    )
