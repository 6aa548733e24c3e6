"""The comparison as tables in Markdown, as in comparison.md; `hapnet compare` writes them to compare.md."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hapnet.ext.metrics import METRICS
from hapnet.ext.pictures.html import element, join, table
from hapnet.ext.study import not_best
from hapnet.ext.study.compare import LOCAL, Group, Plan
from hapnet.ext.study.statistics import Spread
from hapnet.ext.study.tables import OUT, headline, rounded

_CELL = (("stiffness_percent", 0), ("true_force_error_percent", 1), ("free_rms_mm", 1), ("drag_N", 2))
"""The metrics in a cell of the first table, after the count of passive cases, and their digits after the point."""

_SPREADS = (
    ("felt_N_per_m", "felt stiffness [N/m]", 1.0, 0),
    ("stiffness_worst_percent", "worst tenth's stiffness [%]", 1.0, 0),
    ("true_force_error_percent", "force error [%]", 1.0, 1),
    ("true_force_error_last_percent", "force error, last minute [%]", 1.0, 1),
    ("free_rms_mm", "free motion [mm]", 1.0, 2),
    ("free_first_mm", "free motion, first 10 s [mm]", 1.0, 2),
    ("free_last_mm", "free motion, last minute [mm]", 1.0, 2),
    ("drag_N", "drag [N]", 1.0, 3),
    ("drag_p95_N", "drag, 95th percentile [N]", 1.0, 3),
    ("world_force_error_percent", "contact force error in the world [%]", 1.0, 1),
    ("contacts_ratio", "contacts per contact", 1.0, 2),
    ("modulated_percent", "modulated at the world [%]", 1.0, 1),
    ("modulated_device_percent", "modulated at the device [%]", 1.0, 1),
    ("force_step_N", "largest force step [N]", 1.0, 3),
    ("buzz_N2", "buzz [10⁻⁶ N²]", 1e6, 1),
    ("swing_N", "residual oscillation [mN]", 1e3, 2),
)
"""Metrics of the last table, with the factor to multiply by and the digits after the point."""


_PSPM = "pspm"


def page(plan: Plan, found: Sequence[Group], title: str) -> str:
    """The comparison's tables below a heading."""
    count = {group.link: group.cases for group in found if group.operator is None}
    hands = f"{len(plan.operators)} hands" if len(plan.operators) > 1 else plan.operators[0]
    seeds = f"{len(plan.seeds)} seeds" if len(plan.seeds) > 1 else f"seed {plan.seeds[0]}"
    lines = [
        f"## {title}",
        "",
        f"{max(count.values())} cases a cell: {hands}, {seeds}, {plan.params.duration_s:g} s each.",
        "",
        *(f"- {line}" for line in headline(plan, found)),
        "",
        f"{_CELLS}:",
        "",
        *_table(plan, found, _medians),
        "",
        "The most energy that came out [mJ]: of both ports together · at the hand's · at the world's:",
        "",
        *_table(plan, found, _energy),
        "",
        *_not_best(plan, found),
        "Medians over hands, their 95 % intervals (bootstrap over hands), and the worst of all cases:",
        "",
        *_head(plan, ("", "coupling")),
    ]
    for metric, heading, factor, digits in _SPREADS:
        known = [group for group in found if group.operator is None and metric in group.spreads]
        for row, variant in enumerate(dict.fromkeys(group.variant for group in known)):
            cells = [_interval(_group(found, variant, link), metric, factor, digits) for link in plan.links]
            lines.append(_row(["" if row else heading, f"`{variant}`", *cells]))
    return "\n".join([*lines, ""])


def _not_best(plan: Plan, found: Sequence[Group]) -> list[str]:
    """Where PSPM is not the best of these; nothing if it is not among them, or alone."""
    if len(plan.variants) < 2 or _PSPM not in map(str, plan.variants):
        return []
    felt, energy = (
        {str(one): {link: cell(_group(found, one, link)) for link in plan.links} for one in plan.rows}
        for cell in (_medians, _energy)
    )
    return not_best.section(_PSPM, felt, energy, [str(LOCAL)])


def html(plan: Plan, found: Sequence[Group]) -> str:
    """The first table, below the headline, for a notebook."""
    rows = [(str(variant), *(_medians(_group(found, variant, link)) for link in plan.links)) for variant in plan.rows]
    lines = [element("p", line) for line in headline(plan, found)]
    return join(*lines, table(("", *plan.links), rows, caption=_CELLS))


_CELLS = "Passive cases · rendered stiffness [%] · force error [%] · free motion [mm] · drag [N] (medians over hands)"


def _table(plan: Plan, found: Sequence[Group], cell: Callable[[Group], str]) -> list[str]:
    rows = [
        _row([f"`{variant}`", *(cell(_group(found, variant, link)) for link in plan.links)]) for variant in plan.rows
    ]
    return [*_head(plan, ("",)), *rows]


def _head(plan: Plan, before: Sequence[str]) -> list[str]:
    names = [*before, *plan.links]
    return [_row(names), "|---" * len(names) + "|"]


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _group(found: Sequence[Group], variant: object, link: str) -> Group:
    return next(one for one in found if (one.variant, one.link, one.operator) == (variant, link, None))


def _medians(group: Group) -> str:
    medians = [(group.median(metric), digits) for metric, digits in _CELL]
    shown = ["–" if median is None else rounded(median, digits) for median, digits in medians]
    return " · ".join([f"{group.passive}/{group.measured}", *shown])


def _energy(group: Group) -> str:
    most = [group.spreads.get(column.metric) for column in OUT]
    return " · ".join("–" if one is None else rounded(1e3 * one.most, 1) for one in most)


def _interval(group: Group, metric: str, factor: float, digits: int) -> str:
    spread = group.spreads.get(metric)
    if spread is None:
        return "–"
    middle, worst = (rounded(factor * value, digits) for value in (spread.median, _worst(metric, spread)))
    if spread.low is None or spread.high is None:
        return f"{middle} (worst {worst})"
    low, high = (rounded(factor * value, digits) for value in (spread.low, spread.high))
    return f"{middle} ({low} to {high}; worst {worst})"


def _worst(metric: str, spread: Spread) -> float:
    """The worst value of all cases, by the direction in the metric's definition."""
    better = METRICS[metric].better
    if better in ("lower", "higher"):
        return spread.most if better == "lower" else spread.least
    wanted = 0.0 if better == "nearer 0" else 100.0
    return max(spread.least, spread.most, key=lambda value: abs(value - wanted))
