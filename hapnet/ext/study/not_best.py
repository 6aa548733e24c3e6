"""Where a law is not the best: computed from the tables of a comparison, in Markdown.

A table has a row for each coupling and a column for each link or setting; a cell has several figures, joined by " · ".
Only what the table shows counts: figures that are equal there are equal here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

SEPARATOR = " · "
Table = Mapping[str, Mapping[str, str]]
"""The cells of a table, by row and then by column."""


class CellFigure(NamedTuple):
    """A figure of a cell: its name, unit and best value."""

    name: str
    unit: str
    best: float = 0.0


FELT = (
    CellFigure("stiffness", "%", 100.0),
    CellFigure("force error", "%"),
    CellFigure("free motion", "mm"),
    CellFigure("drag", "N"),
)
"""The figures of the first table's cells, after the count of passive cases."""

ENERGY = (
    CellFigure("energy out of both ports", "mJ"),
    CellFigure("energy out at the hand's port", "mJ"),
    CellFigure("energy out at the world's port", "mJ"),
)
"""The figures of the second table's cells."""


def lines(law: str, felt: Table, energy: Table, leave_out: Sequence[str] = ()) -> list[str]:
    """A line for each figure in which a row is better than `law`: for each column the best row, and the best passive.

    felt, energy : the first two tables, with `FELT` after a count of passive cases, and `ENERGY`. leave_out : rows
    that do not count, such as the local wall.
    """
    every = [row for row in felt if row not in (law, *leave_out)]
    found: dict[str, list[str]] = {}
    for figure, column, values in (*_figures(felt, FELT, 1), *_figures(energy, ENERGY, 0)):
        counts = {row: felt[row][column].split(SEPARATOR)[0] for row in felt}

        def distance(row: str, values: Mapping[str, float] = values, figure: CellFigure = figure) -> float:
            return abs(values[row] - figure.best)

        if law not in values:
            continue
        better = [row for row in every if row in values and distance(row) < distance(law)]
        passive = [row for row in better if _all(counts[row])]
        best = [min(rows, key=distance) for rows in (better, passive) if rows]
        if not best:
            continue
        shown = [f"{_number(values[row])} with `{row}`{_lost(counts[row])}" for row in dict.fromkeys(best)]
        words = f"{column} {', '.join(shown)}, {_number(values[law])} with `{law}`"
        found.setdefault(f"{figure.name} [{figure.unit}]", []).append(words)
    return [f"{name}: {'; '.join(each)}" for name, each in found.items()]


def section(law: str, felt: Table, energy: Table, leave_out: Sequence[str] = ()) -> list[str]:
    """The lines below a heading, or one that says that there are none."""
    where = lines(law, felt, energy, leave_out)
    if not where:
        return [f"**`{law}` is the best in every figure of these tables.**", ""]
    return [f"**Where `{law}` is not the best:**", "", *(f"* {line}" for line in where), ""]


def read(text: Sequence[str], after: str) -> Table:
    """The first table after the line that contains `after`, by its rows' and columns' names."""
    start = next(number for number, line in enumerate(text) if after in line)
    rows = []
    for line in text[start + 1 :]:
        if line.startswith("|"):
            rows.append([cell.strip() for cell in line.strip().strip("|").split("|")])
        elif rows:
            break
    (_, *columns), _, *body = rows
    return {name.replace("`", ""): dict(zip(columns, cells, strict=True)) for name, *cells in body}


def _figures(
    table: Table, figures: Sequence[CellFigure], first: int
) -> Iterator[tuple[CellFigure, str, Mapping[str, float]]]:
    """Each figure of each column, with its value in each row that has one."""
    columns = next(iter(table.values()), {})
    for place, figure in enumerate(figures, first):
        for column in columns:
            words = {row: cells[column].split(SEPARATOR) for row, cells in table.items()}
            values = {row: value for row, parts in words.items()
                      if place < len(parts) and (value := _value(parts[place])) is not None}  # fmt: skip
            yield figure, column, values


def _value(word: str) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None


def _all(count: str) -> bool:
    part, _, whole = count.partition("/")
    return part == whole


def _lost(count: str) -> str:
    return "" if _all(count) else f" (passive in {count.replace('/', ' of ')} cases)"


def _number(value: float) -> str:
    return f"{value:g}"
