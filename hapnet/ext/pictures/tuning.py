"""The figure of a tuning: the objective over the trials, and over each searched parameter."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array
from hapnet.ext.pictures.style import COLOURS, headed, legend_above, log_ticks, sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLUMNS = 3
_EDGE = 0.04  # of a range, on both sides of it
_TOP_MM, _CELL_MM = 62.0, 46.0
_SPREAD = 4.0  # the range of the objective's axis, from the best trial, as a multiple of the median's distance
_BROKEN: dict[str, Any] = {"marker": "x", "s": 18, "linewidths": 0.9, "zorder": 2}
_ALLOWED: dict[str, Any] = {"marker": "o", "s": 18, "zorder": 3}
_BEST: dict[str, Any] = {
    "marker": "o", "markersize": 9, "markerfacecolor": "none", "markeredgecolor": COLOURS[1], "markeredgewidth": 1.8,
    "linestyle": "none", "zorder": 5,
}  # fmt: skip
_DEFAULT: dict[str, Any] = {"color": "0.35", "linestyle": (0, (4, 2)), "linewidth": 1.0, "zorder": 1}
_LINE: dict[str, Any] = {"color": COLOURS[1], "linewidth": 1.2, "drawstyle": "steps-post", "zorder": 4}


class Trials(NamedTuple):
    """The trials of a search in order: objectives (N,), NaN if not finite, and which keep all constraints.

    best : the number of the chosen trial. default : the defaults' objective, NaN if it is not finite.
    """

    objective: Array
    allowed: NDArray[np.bool_]
    best: int | None
    default: float


class Slice(NamedTuple):
    """A searched parameter, between `low` and `high` or among `choices`, with indices as values.

    values : (N,) of the trials. default : None if it is not in the range.
    """

    name: str
    values: Array
    default: float | None
    low: float
    high: float
    log: bool
    whole: bool
    choices: Sequence[str]


def draw(title: str, trials: Trials, slices: Sequence[Slice]) -> Figure:
    """The figure, 180 mm wide. At least one trial must have been run."""
    rows = math.ceil(len(slices) / _COLUMNS)
    with sheet(_TOP_MM + _CELL_MM * rows) as fig:
        headed(fig, title)
        layout = fig.add_gridspec(1 + rows, _COLUMNS, height_ratios=[_TOP_MM, *[_CELL_MM] * rows])
        top = fig.add_subplot(layout[0, :])
        _draw_course(top, trials)
        for i, one in enumerate(slices):
            panel = fig.add_subplot(layout[1 + i // _COLUMNS, i % _COLUMNS], sharey=top)
            _draw_slice(panel, trials, one)
            if i % _COLUMNS == 0:
                panel.set_ylabel("objective")
            else:
                panel.tick_params(labelleft=False)
    return fig


def _draw_course(panel: Axes, trials: Trials) -> None:
    costs, default = trials.objective, trials.default
    numbers = np.arange(len(costs))
    _points(panel, trials, numbers)
    best = np.fmin.accumulate(np.where(trials.allowed, costs, math.nan))
    if np.isfinite(best).any():
        panel.plot(numbers[np.isfinite(best)], best[np.isfinite(best)], label="best so far", **_LINE)
    if math.isfinite(default):
        panel.axhline(default, label="defaults", **_DEFAULT)
    if trials.best is not None:
        panel.plot(trials.best, costs[trials.best], label="chosen", **_BEST)
    _limit(panel, [*costs, default])
    panel.set_xlabel("trial")
    panel.locator_params(axis="x", integer=True)
    panel.set_ylabel("objective (lower is better)")
    legend_above(panel, ncols=5, handlelength=1.6)


def _draw_slice(panel: Axes, trials: Trials, one: Slice) -> None:
    _points(panel, trials, one.values)
    if trials.best is not None:
        panel.plot(one.values[trials.best], trials.objective[trials.best], **_BEST)
    if one.default is not None:
        panel.axvline(one.default, **_DEFAULT)
    panel.set_xlabel(one.name)
    if one.choices:
        panel.set_xticks(range(len(one.choices)), one.choices)
        panel.set_xlim(-0.5, len(one.choices) - 0.5)
    elif one.log:
        panel.set_xscale("log")
        log_ticks(panel.xaxis, one.low, one.high)
        edge = (one.high / one.low) ** _EDGE
        panel.set_xlim(one.low / edge, one.high * edge)
    else:
        panel.locator_params(axis="x", integer=one.whole)
        edge = _EDGE * (one.high - one.low)
        panel.set_xlim(one.low - edge, one.high + edge)


def _points(panel: Axes, trials: Trials, x: Any) -> None:
    """Draw trials as marks: crosses if they break a constraint, and darker if they are later."""
    order, allowed = np.arange(len(x)), trials.allowed
    ends: dict[str, Any] = {"vmin": 0, "vmax": max(1, len(x) - 1), "cmap": "viridis_r"}
    for mask, style, label in (
        (allowed, _ALLOWED, "allowed (darker: later)"),
        (~allowed, _BROKEN, "breaks a constraint"),
    ):
        if mask.any():
            panel.scatter(x[mask], trials.objective[mask], c=order[mask], label=label, **ends, **style)


def _limit(panel: Axes, costs: list[float]) -> None:
    """Limit the axis to leave out trials that are far worse than most, so that good trials can be told apart."""
    known = np.array([cost for cost in costs if math.isfinite(cost)])
    if not known.size:
        return
    low, high = float(known.min()), float(known.max())
    far = low + _SPREAD * (float(np.median(known)) - low)
    if high > far > low:
        high = far
        panel.text(0.995, 0.97, "worse trials are above", transform=panel.transAxes, ha="right", va="top", fontsize=7)
    margin = 0.06 * (high - low) or abs(low) * 0.1 or 1.0
    panel.set_ylim(low - margin, high + margin)
