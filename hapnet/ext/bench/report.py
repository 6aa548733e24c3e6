"""The output of a benchmark: the table, and the histograms of subject and reference."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from hapnet.ext.bench.row import Distribution, RoundFigures, Row
from hapnet.ext.pictures.distributions import Panel, Values, draw

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

_ENOUGH = 50  # values, for a histogram


def table(rows: Sequence[Row]) -> RenderableType:
    """A line for each row: min, median, p99; the reference's median and p99; ratios; limits, and if each is met."""
    from rich import box
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    out = Table(box=box.SIMPLE_HEAD, pad_edge=False, title_justify="left")
    out.add_column("", no_wrap=True)
    out.add_column("unit")
    for heading in ("min", "median", "p99", "bare median", "bare p99", "ratio", "ratio p99"):
        out.add_column(heading, justify="right")
    out.add_column("allowed")
    for row in rows:
        allowed = Text("\n").join(
            Text(f"{limit} {'ok' if met else 'MISSED'}", style="" if met else "bold red")
            for limit, met in row.verdicts()
        )
        out.add_row(
            row.name, row.unit, *_numbers(row.figures), *_numbers(row.reference)[1:], _number(row.ratio),
            _number(row.ratio_p99), allowed,
        )  # fmt: skip
    remarks = [Text(line) for row in rows for line in _remarks(row)]
    key = [Text(f"{row.name}: {row.what}; bare: {row.against}", style="dim") for row in rows if row.panel]
    return Group(out, *remarks, *key)


def has_histogram(row: Row) -> bool:
    """Whether the figure has a panel for this row, which needs enough values."""
    return row.panel and sum(part.counts.sum() for part in row.rounds) >= _ENOUGH


def figure(rows: Sequence[Row]) -> Figure:
    """A panel for every row with enough values: the shares of values in each bin, for subject and reference."""
    panels = []
    for row in filter(has_histogram, rows):
        ratio = "" if row.ratio is None else f"{_number(row.ratio)} times the reference, p99 {_number(row.ratio_p99)}"
        subject = _shown(row.rounds, row.figures)
        bare = _shown(row.bare_rounds, row.reference) if row.bare_rounds else None
        panels.append(Panel(f"{row.name} [{row.unit}]", ratio, subject, bare))
    return draw(panels)


def _shown(rounds: Sequence[Distribution], figures: RoundFigures | None) -> Values:
    """The values with the table's figures, as the title has their ratio; quantiles over all rounds would differ."""
    assert figures is not None
    samples = Distribution.together(rounds)
    return Values(samples.values, samples.counts, figures.median, figures.p99)


def _remarks(row: Row) -> list[str]:
    out = []
    if row.note:
        out.append(f"{row.name}: {row.note}")
    if "late_period" in row.more:
        ours, theirs, skipped, bare_skipped = (
            f"{100.0 * row.more[name]:.3f} %" for name in ("late_period", "late_period_bare", "skipped", "skipped_bare")
        )
        out.append(
            f"{row.name}: deadlines late by a period or more: {ours}, of the bare loop's {theirs}; "
            f"skipped: {skipped}, of the bare loop's {bare_skipped}"
        )
    return out


def _numbers(figures: RoundFigures | None) -> list[str]:
    if figures is None:
        return ["-"] * 3
    return [_number(value) for value in (figures.minimum, figures.median, figures.p99)]


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
