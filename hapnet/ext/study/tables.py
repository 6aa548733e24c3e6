"""The comparison as tables for a terminal, and as an object for JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from math import isinf
from typing import Any, NamedTuple

from rich.markup import escape
from rich.table import Table

from hapnet.ext.metrics import METRICS, Measures
from hapnet.ext.study.compare import Group, Plan, RunMeasures
from hapnet.ext.study.tunings import tunings
from hapnet.installing import versions
from hapnet.recording.samples import plain
from netem.profile import PRESETS

WIDE = 160
"""A terminal of at least this width [columns] has space for more of `_SHOWN`, and for intervals."""


_NAMED = 6
"""The largest number of hands that the note lists by name."""


class _Column(NamedTuple):
    """A metric as a column: its heading, the factor to multiply by, and the digits after the point."""

    metric: str
    heading: str
    factor: float
    digits: int


OUT = (
    _Column("energy_out_J", "out\n[mJ]", 1e3, 1),
    _Column("hand_energy_out_J", "hand\n[mJ]", 1e3, 1),
    _Column("world_energy_out_J", "world\n[mJ]", 1e3, 1),
)
"""The most energy that came out in any case: of both ports together, and of each port alone."""

_SHOWN = (
    _Column("stiffness_percent", "stiff\n[%]", 1.0, 0),
    _Column("felt_N_per_m", "felt\n[N/m]", 1.0, 0),
    _Column("true_force_error_percent", "true\nerror\n[%]", 1.0, 1),
    _Column("true_torque_error_percent", "true\ntorque\n[%]", 1.0, 1),  # of a tool that turns, as free_rms_deg below
    _Column("free_rms_mm", "free\nerror\n[mm]", 1.0, 1),
    _Column("free_rms_deg", "free\nerror\n[°]", 1.0, 2),
    _Column("drag_N", "drag\n[N]", 1.0, 2),
    _Column("free_last_mm", "last\nminute\n[mm]", 1.0, 1),
    _Column("free_first_mm", "first\n10 s\n[mm]", 1.0, 1),
    _Column("stiffness_worst_percent", "worst\ntenth\n[%]", 1.0, 0),
    _Column("contacts_ratio", "contacts\nper one", 1.0, 1),
    _Column("modulated_percent", "modu-\nlated\n[%]", 1.0, 1),
    _Column("swing_N", "oscillation\n[N]", 1.0, 3),
    _Column("first_contact_ms", "first\nfelt\n[ms]", 1.0, 0),
)
"""The columns by priority: a narrow table has the first `_NARROW` that have values, a wide table `_MOST`."""

_NARROW, _MOST = 6, 10

_NOTE = (
    "Medians over {operators}, each with the mean over {seeds}{interval}. A number in brackets "
    "counts the cases with a value, if some have none. A contact that was not felt counts as infinitely late. "
    "passive: cases whose two-port margin stayed above zero. out: the most energy that came out of both ports "
    "together; hand and world: of each port alone. "
    "local wall: the best that this device can render without a network. "
    "hapnet compare --metrics defines all columns."
)
_INTERVAL = ", 95 % intervals by resampling these hands (quartiles of fewer than three) in a terminal of {wide} columns"


def tables(plan: Plan, found: Sequence[Group], width: int) -> list[Table]:
    """One table per link with couplings as rows: medians, and quartiles where there is room for them."""
    wide = width >= WIDE
    result = []
    for link, (up, down) in plan.links.items():
        up, down = PRESETS.get(up, up), PRESETS.get(down, down)
        words = up if up == down else f"up {up}; down {down}"
        title = f"{link}: {words or 'ideal link'}"
        rows = [group for group in found if group.link == link and group.operator is None]
        result.append(_table(escape(title), rows, _columns(found, wide=wide), wide=wide))
    return result


def headline(plan: Plan, found: Sequence[Group]) -> list[str]:
    """A line for each variant that was not passive in all cases: the links, and the energy that came out by port."""
    lines = []
    for variant in plan.variants:
        groups = [one for one in found if one.variant == variant and one.operator is None and one.lost]
        lost = [measures for one in groups for measures in one.lost]
        if not lost:
            continue
        both, hand, world = (_most_mJ(lost, column.metric) for column in OUT)
        inside = sum(measures["hand_energy_out_J"] == 0.0 for measures in lost)
        where = ", ".join(one.link for one in groups)
        nothing = f"; nothing at the hand's in {inside}" if inside else ""
        lines.append(
            f"{variant} was not passive in {len(lost)} case{'s' * (len(lost) > 1)} ({where}): at most {both} mJ came "
            f"out of both ports together, {hand} mJ at the hand's, {world} mJ at the world's, into its walls{nothing}"
        )
    return lines or ["every coupling was passive in all cases"]


def _most_mJ(cases: Sequence[Measures], metric: str) -> str:
    return rounded(1e3 * max((value for one in cases if (value := one[metric]) is not None), default=0.0), 1)


def _columns(found: Sequence[Group], *, wide: bool) -> list[_Column]:
    """The columns for which some group has a value, as far as there is space."""
    known = {metric for group in found for metric in group.spreads}
    return [one for one in _SHOWN if one.metric in known][: _MOST if wide else _NARROW]


def note(plan: Plan) -> str:
    """The note below the tables."""
    seeds = f"{len(plan.seeds)} seeds" if len(plan.seeds) > 1 else f"seed {plan.seeds[0]}"
    count = len(plan.operators)
    operators = ", ".join(plan.operators) if count <= _NAMED else f"{count} hands ({plan.operators[0]}, ...)"
    return _NOTE.format(operators=operators, seeds=seeds, interval=_INTERVAL.format(wide=WIDE))


def failures(outcomes: Sequence[RunMeasures], most: int = 5) -> list[str]:
    """A line for each of the first `most` failed cases, and a line that counts the rest."""
    failed = [one for one in outcomes if one.error is not None]
    lines = [f"failed: {one.case}: {one.error}" for one in failed[:most]]
    return lines + ([f"and {len(failed) - most} more"] if len(failed) > most else [])


def definitions() -> Table:
    """A table with the definition of each metric."""
    table = Table("metric", "unit", "better", "over", "meaning", show_lines=True)
    for metric in METRICS.values():
        table.add_row(
            f"{escape(metric.label)}\n[dim]{metric.name}[/]",
            metric.unit,
            metric.better,
            escape(metric.over),
            escape(metric.meaning),
        )
    return table


def as_dict(plan: Plan, outcomes: Sequence[RunMeasures], found: Sequence[Group]) -> dict[str, Any]:
    """The comparison for JSON, equal for equal comparisons: settings, units, tunings, groups and every case."""
    whole = {
        "settings": {
            "couplings": plan.couplings,
            "links": {name: {"up": up, "down": down} for name, (up, down) in plan.links.items()},
            "operators": plan.operators,
            "seeds": plan.seeds,
            "deadbands": plan.deadbands,
            "parameters": plan.params.as_dict(),
        },
        "metrics": {
            name: {key: getattr(metric, key) for key in ("label", "unit", "better", "meaning", "missed")}
            for name, metric in METRICS.items()
        },
        "headline": headline(plan, found),
        "tunings": {coupling: tunings(plan, coupling) for coupling in plan.couplings},
        "groups": [_group(group) for group in found],
        "cases": [{**one.case.about, "measures": one.measures, "error": one.error} for one in outcomes],
        "versions": versions(),
    }
    return {str(key): value for key, value in plain(whole).items()}


def as_rows(found: Sequence[Group]) -> list[dict[str, Any]]:
    """A row for each group: the median of each metric, its interval ``_low`` and ``_high``, the quartiles ``_q1`` and
    ``_q3``, and ``_missed`` if the metric can be missed.

    A quantile that reaches a miss is ``inf``; None: no case has a value.
    """
    rows = []
    for group in found:
        row = {key: value for key, value in _group(group).items() if key != "metrics"}
        for name, metric in METRICS.items():
            spread = group.spreads.get(name)
            for suffix, figure in (("", "median"), ("_low", "low"), ("_high", "high"), ("_q1", "q1"), ("_q3", "q3")):
                row[name + suffix] = None if spread is None else getattr(spread, figure)
            if metric.missed:
                row[f"{name}_missed"] = 0 if spread is None else spread.missed
        rows.append(row)
    return rows


def _table(title: str, rows: Sequence[Group], columns: Sequence[_Column], *, wide: bool) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold", padding=(0, 1 if wide else 0))
    table.add_column("coupling", min_width=max(len(group.variant.coupling) for group in rows))
    for heading in ("passive", *(column.heading for column in (*OUT, *columns))):
        table.add_column(heading.replace("[", r"\["), justify="right", overflow="fold")
    for group in rows:
        name = escape(str(group.variant)) + (f" [red]({group.failed} failed)[/]" if group.failed else "")
        most = [group.spreads.get(column.metric) for column in OUT]
        table.add_row(
            name,
            _count(group.passive, group.measured),
            *("–" if one is None else rounded(1e3 * one.most, 1) for one in most),
            *(_cell(group, column, wide=wide) for column in columns),
        )
    return table


def _cell(group: Group, column: _Column, *, wide: bool) -> str:
    spread = group.spreads.get(column.metric)
    if spread is None:
        return "–"
    ends = (spread.q1, spread.q3) if spread.low is None or spread.high is None else (spread.low, spread.high)
    median, low, high = (rounded(column.factor * value, column.digits) for value in (spread.median, *ends))
    if isinf(spread.median):
        median = "not felt"
    if spread.count < group.measured:  # the number of values matters as much as the values
        median += f" [dim]({spread.count})[/]"
    return f"{median}\n[dim]{low}..{high}[/]" if wide else median


def rounded(value: float, digits: int) -> str:
    """A fixed number of digits, fewer for a large number; no minus before a zero."""
    if isinf(value):
        return "∞"
    size = abs(value)
    shown = f"{value:.{0 if size >= 100.0 else min(digits, 1) if size >= 10.0 else digits}f}"
    return shown.removeprefix("-") if float(shown) == 0.0 else shown


def _count(part: int, whole: int) -> str:
    words = f"{part}/{whole}"
    return words if part == whole else f"[red]{words}[/]"


def _group(group: Group) -> dict[str, Any]:
    return {
        **group.variant._asdict(),
        "link": group.link,
        "operator": group.operator,
        "cases": group.cases,
        "failed": group.failed,
        "passive": group.passive,
        "hand_passive": group.hand_passive,
        "metrics": {name: asdict(spread) for name, spread in group.spreads.items()},
    }
