"""The figure of a tuning: the objective from trial to trial, and over each parameter that was searched."""

from __future__ import annotations

import math
import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np

from hapnet.reports.style import MM, STYLE
from hapnet.study.search import Search
from hapnet.study.search_space import Searched
from hapnet.study.spec import value_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLUMNS = 3
_EDGE = 0.04  # of a range, on both sides of it
_TITLE = 105  # letters of its line
_TOP_MM, _CELL_MM = 62.0, 46.0
_SPREAD = 4.0  # trials that are further from the best than this many times the median's distance are drawn at the edge
_COLOURS = "viridis_r"
_BROKEN: dict[str, Any] = {"marker": "x", "s": 18, "linewidths": 0.9, "zorder": 2}
_ALLOWED: dict[str, Any] = {"marker": "o", "s": 18, "zorder": 3}
_BEST: dict[str, Any] = {
    "marker": "o", "markersize": 9, "markerfacecolor": "none", "markeredgecolor": "#D55E00", "markeredgewidth": 1.8,
    "linestyle": "none", "zorder": 5,
}  # fmt: skip
_DEFAULT: dict[str, Any] = {"color": "0.35", "linestyle": (0, (4, 2)), "linewidth": 1.0, "zorder": 1}
_LINE: dict[str, Any] = {"color": "#D55E00", "linewidth": 1.2, "drawstyle": "steps-post", "zorder": 4}


def draw(search: Search) -> Figure:
    """The figure, 180 mm wide. At least one trial must have been run."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    spec = search.spec
    rows = math.ceil(len(spec.space) / _COLUMNS)
    with matplotlib.rc_context(STYLE):
        fig = Figure(figsize=(180 * MM, (_TOP_MM + _CELL_MM * rows) * MM), dpi=150, layout="constrained")
        FigureCanvasAgg(fig)
        title = f"{spec.name}: {' + '.join(map(str, spec.goal.terms))}"
        if search.best is not None and math.isfinite(default := _default_cost(search)):
            title += f": {_shown(search)[search.best]:.3g} with what was chosen, {default:.3g} with the defaults"
        fig.suptitle("\n".join(textwrap.wrap(title, _TITLE)), fontsize=9, parse_math=False)
        layout = fig.add_gridspec(1 + rows, _COLUMNS, height_ratios=[_TOP_MM, *[_CELL_MM] * rows])
        top = fig.add_subplot(layout[0, :])
        _draw_course(top, search)
        for i, one in enumerate(spec.space):
            panel = fig.add_subplot(layout[1 + i // _COLUMNS, i % _COLUMNS], sharey=top)
            _draw_slice(panel, search, one)
            if i % _COLUMNS == 0:
                panel.set_ylabel("objective")
            else:
                panel.tick_params(labelleft=False)
    return fig


def _draw_course(panel: Axes, search: Search) -> None:
    verdicts = search.verdicts()
    numbers = np.arange(len(verdicts))
    costs = _shown(search)
    _points(panel, search, numbers, costs)
    best = np.minimum.accumulate([v.objective if v.allowed else math.inf for v in verdicts])
    if np.isfinite(best).any():
        panel.plot(numbers[np.isfinite(best)], best[np.isfinite(best)], label="best so far", **_LINE)
    default = _default_cost(search)
    if math.isfinite(default):
        panel.axhline(default, label="defaults", **_DEFAULT)
    if search.best is not None:
        panel.plot(search.best, costs[search.best], label="chosen", **_BEST)
    _limit(panel, [*costs, default])
    panel.set_xlabel("trial")
    panel.locator_params(axis="x", integer=True)
    panel.set_ylabel("objective (lower is better)")
    panel.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=5, fontsize=8, borderaxespad=0.1, handlelength=1.6)


def _draw_slice(panel: Axes, search: Search, one: Searched) -> None:
    values = [_place(one, trial.values[one.name]) for trial in search.trials]
    costs = _shown(search)
    _points(panel, search, np.array(values), costs)
    if search.best is not None:
        panel.plot(values[search.best], costs[search.best], **_BEST)
    if one.default in one:
        panel.axvline(_place(one, one.default), **_DEFAULT)
    panel.set_xlabel(one.name)
    if one.choices:
        panel.set_xticks(range(len(one.choices)), [value_words(one.name, choice) for choice in one.choices])
        panel.set_xlim(-0.5, len(one.choices) - 0.5)
        return
    low, high = float(one.low), float(one.high)
    if one.log:
        from matplotlib.ticker import LogLocator, NullFormatter

        panel.set_xscale("log")
        panel.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 200.0 * low else (1.0,)))
        panel.xaxis.set_major_formatter("{x:g}")
        panel.xaxis.set_minor_formatter(NullFormatter())
        edge = (high / low) ** _EDGE
        panel.set_xlim(low / edge, high * edge)
    else:
        panel.locator_params(axis="x", integer=one.whole)
        panel.set_xlim(low - _EDGE * (high - low), high + _EDGE * (high - low))


def _points(panel: Axes, search: Search, x: Any, y: Any) -> None:
    """Trials as marks: those that break a constraint as crosses, later ones darker."""
    verdicts = search.verdicts()
    order = np.arange(len(verdicts))
    allowed = np.array([verdict.allowed for verdict in verdicts], dtype=bool)
    ends: dict[str, Any] = {"vmin": 0, "vmax": max(1, len(verdicts) - 1), "cmap": _COLOURS}
    for mask, style, label in (
        (allowed, _ALLOWED, "allowed (darker: later)"),
        (~allowed, _BROKEN, "breaks a constraint"),
    ):
        if mask.any():
            panel.scatter(x[mask], y[mask], c=order[mask], label=label, **ends, **style)


def _default_cost(search: Search) -> float:
    scores = search.scores
    return math.inf if scores is None else scores[0].verdicts(search.spec)[0].objective


def _shown(search: Search) -> Any:
    """The objectives; those without a finite one are not drawn."""
    return np.array([v.objective if math.isfinite(v.objective) else math.nan for v in search.verdicts()])


def _limit(panel: Axes, costs: list[float]) -> None:
    """Leave out what is far worse than most, so that differences between good values can be seen."""
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


def _place(one: Searched, value: Any) -> float:
    return float(one.choices.index(value)) if one.choices else float(value)
