"""The comparison as tables for a terminal, and as one object for machines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from math import isinf
from typing import Any, NamedTuple

from rich.markup import escape
from rich.table import Table

from hapnet.metrics import METRICS
from hapnet.recording.samples import plain
from hapnet.study.compare import Group, Outcome, Plan
from hapnet.study.tunings import tunings
from hapnet.versions import versions
from netem.profile import PRESETS

WIDE = 160
"""From this width of a terminal on [columns], a table has room for `_FULL` and its quartiles, and for no more."""


class _Column(NamedTuple):
    """How a table shows a metric: its heading, the factor to multiply by, and the digits after the point."""

    metric: str
    heading: str
    factor: float
    digits: int


_BRIEF = (
    _Column("margin_end_J", "end\n[mJ]", 1e3, 0),
    _Column("stiffness_percent", "stiff\n[%]", 1.0, 0),
    _Column("true_force_error_percent", "true\nerror\n[%]", 1.0, 1),
    _Column("free_rms_mm", "free\nerror\n[mm]", 1.0, 1),
    _Column("drag_N", "drag\n[N]", 1.0, 2),
    _Column("swing_N", "swing\n[N]", 1.0, 3),
    _Column("first_contact_ms", "felt\n[ms]", 1.0, 0),
)
_FULL = (
    _Column("stiffness_percent", "rendered\nstiffness\n[%]", 1.0, 0),
    _Column("true_force_error_percent", "true\nerror\n[%]", 1.0, 1),
    _Column("free_rms_mm", "error,\nfree\n[mm]", 1.0, 1),
    _Column("drag_N", "drag\n[N]", 1.0, 2),
    _Column("swing_N", "swing\n[N]", 1.0, 3),
    _Column("buzz_N2", "buzz\n[10⁻³ N²]", 1e3, 2),
    _Column("drift_mm_per_min", "drift\n[mm/min]", 1.0, 1),
    _Column("first_contact_ms", "first\nfelt\n[ms]", 1.0, 0),
    _Column("later_contact_ms", "later\nfelt\n[ms]", 1.0, 0),
    _Column("packets_per_s", "packets\n[1/s]", 1.0, 0),
)
_NOTE = (
    "Medians over {operators} and {seeds}, quartiles in a terminal of {wide} columns or more; a number in brackets "
    "counts the cases that have a value, if not all do; a contact that was not felt counts as infinitely late. "
    "passive: cases whose two-port margin stayed above zero; hand: the same for the margin at the hand's port alone; "
    "out: the most energy that ever came out of both ports together; end: the margin at the end. "
    "hapnet compare --metrics defines all columns."
)


def tables(plan: Plan, found: Sequence[Group], width: int) -> list[Table]:
    """One table per link with couplings as rows: medians, and quartiles where there is room for them."""
    wide = width >= WIDE
    made = []
    for link, (up, down) in plan.links.items():
        up, down = PRESETS.get(up, up), PRESETS.get(down, down)
        words = up if up == down else f"up {up}; down {down}"
        title = f"{link}: {words or 'nothing in the way'}"
        made.append(_table(escape(title), [g for g in found if g.link == link and g.operator is None], wide=wide))
    return made


def note(plan: Plan) -> str:
    """The note below the tables."""
    seeds = f"{len(plan.seeds)} seeds" if len(plan.seeds) > 1 else f"seed {plan.seeds[0]}"
    return _NOTE.format(wide=WIDE, operators=", ".join(plan.operators), seeds=seeds)


def failures(outcomes: Sequence[Outcome], most: int = 5) -> list[str]:
    """A line for each of the first `most` failed cases, and one that counts the rest."""
    failed = [one for one in outcomes if one.error is not None]
    lines = [f"failed: {one.case}: {one.error}" for one in failed[:most]]
    return lines + ([f"and {len(failed) - most} more"] if len(failed) > most else [])


def definitions() -> Table:
    """A table of what each metric means."""
    table = Table("metric", "unit", "better", "meaning", show_lines=True)
    for metric in METRICS.values():
        table.add_row(
            f"{escape(metric.label)}\n[dim]{metric.name}[/]", metric.unit, metric.better, escape(metric.meaning)
        )
    return table


def as_dict(plan: Plan, outcomes: Sequence[Outcome], found: Sequence[Group]) -> dict[str, Any]:
    """Everything that two equal comparisons have in common: settings, units, tunings, groups and every case."""
    whole = {
        "settings": {
            "couplings": plan.couplings,
            "links": {name: {"up": up, "down": down} for name, (up, down) in plan.links.items()},
            "operators": plan.operators,
            "seeds": plan.seeds,
            "deadbands": plan.deadbands,
            "parameters": plan.params.as_dict(),
        },
        "metrics": {name: {k: v for k, v in asdict(metric).items() if k != "name"} for name, metric in METRICS.items()},
        "tunings": {coupling: tunings(plan, coupling) for coupling in plan.couplings},
        "groups": [_group(group) for group in found],
        "cases": [_case(outcome) for outcome in outcomes],
        "versions": versions(),
    }
    return {str(key): value for key, value in plain(whole).items()}


def as_rows(found: Sequence[Group]) -> list[dict[str, Any]]:
    """A row per group: of each metric the median, ``_q1`` and ``_q3``, and where it can be missed ``_missed``.

    A quantile that reaches a miss is ``inf``; None: no case has a value.
    """
    rows = []
    for group in found:
        row = {key: value for key, value in _group(group).items() if key != "metrics"}
        for name, metric in METRICS.items():
            spread = group.spreads.get(name)
            for suffix, figure in (("", "median"), ("_q1", "q1"), ("_q3", "q3")):
                row[name + suffix] = None if spread is None else getattr(spread, figure)
            if metric.missed:
                row[f"{name}_missed"] = 0 if spread is None else spread.missed
        rows.append(row)
    return rows


def _table(title: str, rows: Sequence[Group], *, wide: bool) -> Table:
    columns = _FULL if wide else _BRIEF
    table = Table(title=title, title_justify="left", title_style="bold", padding=(0, 1 if wide else 0))
    table.add_column("coupling", min_width=max(len(group.variant.coupling) for group in rows))
    for heading in ("passive", "hand", "out\n[mJ]", *(column.heading for column in columns)):
        table.add_column(heading.replace("[", r"\["), justify="right", overflow="fold")
    for group in rows:
        name = escape(str(group.variant)) + (f" [red]({group.failed} failed)[/]" if group.failed else "")
        out = group.spreads.get("energy_out_J")
        table.add_row(
            name,
            _count(group.passive, group.measured),
            _count(group.hand_passive, group.measured),
            "–" if out is None else _number(1e3 * out.most, 1),
            *(_cell(group, column, wide=wide) for column in columns),
        )
    return table


def _cell(group: Group, column: _Column, *, wide: bool) -> str:
    spread = group.spreads.get(column.metric)
    if spread is None:
        return "–"
    median, q1, q3 = (_number(column.factor * v, column.digits) for v in (spread.median, spread.q1, spread.q3))
    if isinf(spread.median):
        median = "not felt"
    if spread.count < group.measured:  # how often matters as much as how much
        median += f" [dim]({spread.count})[/]"
    return f"{median}\n[dim]{q1}..{q3}[/]" if wide else median


def _number(value: float, digits: int) -> str:
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


def _case(outcome: Outcome) -> dict[str, Any]:
    case = outcome.case
    about: Mapping[str, Any] = {
        **case.variant._asdict(), "link": case.link, "operator": case.operator, "seed": case.seed
    }  # fmt: skip
    return {**about, "measures": outcome.measures, "error": outcome.error}
