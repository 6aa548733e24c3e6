"""Sorts the results of a sweep into cells along one or two varied parameters."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.metrics.measured import value_of
from hapnet.ext.pictures.grid import USUAL, Cell, Grid, GridAxis, numeric
from hapnet.ext.study.case import was_passive
from hapnet.ext.study.journal import Journal, JournalRow
from hapnet.ext.study.spec import LINK, SEED, value_words


def grid(
    journal: Journal,
    x: str | None,
    y: str | None,
    metric: str | None,
    where: Mapping[str, str],
    units: Mapping[str, str],
) -> Grid:
    """The runs of `journal` that match `where`, sorted into cells.

    Without `x` and `y` the axes are the two names with the most values; with `x` alone `x` is the only axis.

    where : values by name. units : of the parameters by name.

    Raises InvalidParameter: the sweep has no such name or value. HapnetError: no case has a result.
    """
    names = [*journal.varied, SEED]
    for flag, name in (("--x", x), ("--y", y), *(("--where", name) for name in where)):
        if name is not None and name not in names:
            raise InvalidParameter(flag, name, f"a name that varies in this sweep: {', '.join(names)}", names)
    rows = list(journal.rows())
    for name, words in where.items():
        kept = [row for row in rows if _is(name, _value(row, name), words)]
        if not kept:
            raise InvalidParameter(f"--where {name}", words, ", ".join(_axis(name, rows, units).words))
        rows = kept
    metrics = list(dict.fromkeys(name for row in rows for name in row.measures))
    if not metrics:
        raise HapnetError("nothing to draw: no case has a result")
    if metric is not None and metric not in metrics:
        raise InvalidParameter("--value", metric, ", ".join(metrics), metrics)
    metric = metric or (USUAL if USUAL in metrics else metrics[0])
    axes = {name: _axis(name, rows, units) for name in names}
    x, y = _chosen(axes, x, y)
    along = [axes[name] for name in (x, y) if name is not None]
    index = [{_key(value): i for i, value in enumerate(each.values)} for each in along]
    cells: dict[tuple[int, int], Cell] = {}
    for row in rows:
        where_is = [at[_key(_value(row, each.name))] for at, each in zip(index, along, strict=True)]
        place = (where_is[0], where_is[1] if len(where_is) > 1 else 0)
        cell, found = cells.setdefault(place, Cell()), value_of(row.measures, metric)
        cell.not_passive += not was_passive(row.measures)
        if not row.done:
            cell.missing += 1
        elif row.error is not None:
            cell.failed += 1
        elif found is not None:
            cell.values.append(float(found))
    over = [f"{len(axes[n].values)} {_plural(n)}" for n in names if n not in (x, y) and len(axes[n].values) > 1]
    return Grid(axes[x], None if y is None else axes[y], cells, metric, tuple(over))


def _axis(name: str, rows: Iterable[JournalRow], units: Mapping[str, str]) -> GridAxis:
    """The axis `name`, with the values in these rows."""
    values = list({_key(value): value for value in (_value(row, name) for row in rows)}.values())
    if numeric(values):
        values.sort()
    return GridAxis(name, units.get(name, ""), tuple(values), tuple(shown(name, value) for value in values))


def _chosen(axes: Mapping[str, GridAxis], x: str | None, y: str | None) -> tuple[str, str | None]:
    """The axes to draw: as given, otherwise the names with the most values; the seed only if nothing else varies."""
    if x is not None:
        if x == y:
            others = ", ".join(name for name in axes if name != x)
            raise InvalidParameter("--y", y, "", why=f"--x shows it already; choose one of {others}")
        return x, y
    free = sorted((n for n in axes if n not in (SEED, y)), key=lambda name: -len(axes[name].values))
    most = [name for name in free if len(axes[name].values) > 1] or [SEED]
    if y is not None:
        return most[0], y
    return most[0], most[1] if len(most) > 1 else None


def _value(row: JournalRow, name: str) -> Any:
    return row.case.seed if name == SEED else row.case.values[name]


def _key(value: Any) -> str:
    return repr(value)


def shown(name: str, value: Any) -> str:
    """A value as text for an axis: a number with four digits, a whole number without a point."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value_words(name, value)
    return f"{value:.0f}" if value == round(value) and abs(value) < 1e6 else f"{value:.4g}"


def _is(name: str, value: Any, text: str) -> bool:
    """Whether this text, from an axis or a table, stands for this value."""
    return text.strip() in (shown(name, value), value_words(name, value))


def _plural(name: str) -> str:
    return f"{name}s" if name in (SEED, LINK, "coupling", "operator", "scene") else f"values of {name}"
