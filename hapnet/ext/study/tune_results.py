"""The results of a tuning: tables for a terminal, an object for JSON, its trials as CSV, the values as TOML."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.markup import escape
from rich.table import Table

from hapnet.ext.metrics import METRICS
from hapnet.ext.study.goal import Worth
from hapnet.ext.study.search import Scores, Search, Trial
from hapnet.ext.study.spec import Values, value_words
from hapnet.ext.study.statistics import Spread, spreads
from hapnet.ext.study.tune_spec import TuneSpec
from hapnet.installing import versions
from hapnet.param_values import toml_value
from hapnet.recording.export import write_csv
from hapnet.recording.samples import plain
from hapnet.recording.whole_file import complete_or_absent

PARTS = ("tuning", "scoring")
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def tables(spec: TuneSpec, scores: tuple[Scores, Scores]) -> list[Table]:
    """Two tables: the values found; and objective, metrics and constraints on the tuning and scoring cases."""
    return [_values(spec, scores[0].found), _measured(spec, scores)]


def as_dict(search: Search) -> dict[str, Any]:
    """The results as an object for JSON, equal for equal tunings."""
    spec, scores, best = search.spec, search.scores, search.best
    found = None if best is None else search.trials[best].values
    whole = {
        "parameters": {
            one.name: {
                "default": one.default,
                "found": None if found is None else found[one.name],
                "range": list(one.choices) if one.choices else {"from": one.low, "to": one.high, "log": one.log},
            }
            for one in spec.space
        },
        "objective": [str(term) for term in spec.goal.terms],
        "constraints": [str(one) for one in spec.goal.constraints],
        "trials": len(search.trials),
        "best_trial": best,
        **{part: _part(spec, one) for part, one in zip(PARTS, scores or (), strict=False)},
        "versions": versions(),
    }
    return {str(key): value for key, value in plain(whole).items()}


def trials(search: Search) -> list[dict[str, Any]]:
    """A row for each trial: its values, the objective and its terms, and which constraints held."""
    spec = search.spec
    verdicts = search.verdicts() if search.trials else []
    return [
        {
            "trial": i,
            "generation": i // spec.generation,
            **{one.name: trial.values[one.name] for one in spec.space},
            "objective": verdict.objective,
            **{f"{term.metric} cost": cost for term, cost in zip(spec.goal.terms, verdict.terms, strict=True)},
            **{
                str(one): f"{held.kept}/{held.cases}"
                for one, held in zip(spec.goal.constraints, verdict.held, strict=True)
            },
            "failed": verdict.failed,
            "allowed": verdict.allowed,
            "chosen": i == search.best,
        }
        for i, (trial, verdict) in enumerate(zip(search.trials, verdicts, strict=True))
    ]


def write_trials(search: Search, path: Path) -> None:
    """Write all trials as CSV, a row each. Raises RecordingError."""
    own = {one.name for one in search.spec.space}
    rows = trials(search)
    cells = ([value_words(name, value) if name in own else value for name, value in row.items()] for row in rows)
    with complete_or_absent(path, "trials") as part:
        write_csv(part, rows[0] if rows else [], cells)


def write_found(spec: TuneSpec, values: Values, path: Path) -> None:
    """Write the values that were found as a file for `--params`. Raises RecordingError."""
    lines = [f"{one.name} = {toml_value(values[one.name])}\n" for one in spec.space]
    with complete_or_absent(path, "values") as part:
        part.write_text(f"# found by hapnet tune, {spec.name}\n{''.join(lines)}", encoding="utf-8")


def _values(spec: TuneSpec, found: Trial | None) -> Table:
    table = Table(title="searched parameters", title_justify="left", title_style="bold")
    for heading in ("parameter", "default", "found", "range"):
        table.add_column(heading, justify="left" if heading in ("parameter", "range") else "right", overflow="fold")
    for one in spec.space:
        value = "–" if found is None else value_words(one.name, found.values[one.name])
        table.add_row(one.name, value_words(one.name, one.default), f"[bold]{escape(value)}[/]", escape(str(one)))
    return table


def _measured(spec: TuneSpec, scores: tuple[Scores, Scores]) -> Table:
    tuned, scored = (len(one.default.rows) for one in scores)
    title = f"medians (quartiles) over {tuned} tuning cases and {scored} scoring cases"
    table = Table(title=title, title_justify="left", title_style="bold")
    table.add_column("", overflow="fold")
    for part in PARTS:
        for whose in ("default", "found"):
            table.add_column(f"{part},\n{whose}", justify="right", overflow="fold")
    verdicts = [verdict for one in scores for verdict in one.verdicts(spec)]
    trials = [trial for one in scores for trial in one]
    table.add_row("objective", *("–" if one is None else f"{one.objective:.4g}" for one in verdicts), end_section=True)
    found = [None if one is None else dict(spreads([one.measures])) for one in trials]
    for name in spec.goal.metrics:
        shown = [None if one is None else one.get(name) for one in found]
        power = _power([spread for spread in shown if spread is not None])
        unit = " ".join(filter(None, (f"10{str(power).translate(_RAISED)}" if power else "", METRICS[name].unit)))
        table.add_row(escape(replace(METRICS[name], unit=unit).heading), *(_spread(one, power) for one in shown))
    table.add_section()
    for i, constraint in enumerate(spec.goal.constraints):
        table.add_row(escape(str(constraint)), *(_held(verdict, i) for verdict in verdicts))
    if any(trial is not None and trial.failed for trial in trials):
        table.add_row("cases that failed", *("–" if one is None else str(one.failed) for one in trials))
    return table


def _power(spreads: Sequence[Spread]) -> int:
    """The power of ten, a multiple of 3, by which to scale the numbers so that they are short."""
    ends = [abs(end) for one in spreads for end in (one.q1, one.q3) if math.isfinite(end)]
    most = max(ends, default=0.0)
    return 0 if most == 0.0 or 1e-2 <= most < 1e5 else 3 * math.floor(math.log10(most) / 3.0)


def _spread(spread: Spread | None, power: int) -> str:
    if spread is None:
        return "–"
    median, q1, q3 = (f"{value / 10.0**power:.3g}" for value in (spread.median, spread.q1, spread.q3))
    return f"{median}\n{q1}..{q3}"


def _held(verdict: Worth | None, i: int) -> str:
    if verdict is None:
        return "–"
    held = verdict.held[i]
    words = f"{held.kept} of {held.cases}"
    return words if held.met else f"[red]{words}[/]"


def _part(spec: TuneSpec, scores: Scores) -> dict[str, Any]:
    both = zip(("default", "found"), scores, scores.verdicts(spec), strict=True)
    return {whose: _reported(spec, trial, verdict) for whose, trial, verdict in both}


def _reported(spec: TuneSpec, trial: Trial | None, verdict: Worth | None) -> dict[str, Any] | None:
    if trial is None or verdict is None:
        return None
    return {
        "cases": len(trial.rows),
        "failed": trial.failed,
        "objective": verdict.objective,
        "allowed": verdict.allowed,
        "constraints": [
            {"constraint": str(one), "kept": held.kept, "met": held.met}
            for one, held in zip(spec.goal.constraints, verdict.held, strict=True)
        ],
        "metrics": {name: vars(spread) for name, spread in spreads([trial.measures])},
    }
