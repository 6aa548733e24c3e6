"""The table of a hand's motion in a CSV file: its columns by name and unit, its faults by line."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from hapnet.checks import Array
from hapnet.errors import InvalidParameter
from hapnet.file_content import read_text

COLUMNS = "columns"
"""The parameter of `operator_model` that names the columns of a file with other names."""

_TIMES = {"time_s": 1.0, "time_ms": 1e-3, "time_us": 1e-6, "time_ns": 1e-9}
_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}
_PLACES = {f"{axis}_{unit}": (f"{axis}_m", scale) for axis in "xyz" for unit, scale in _LENGTHS.items()}
_PEN = ("pressure", "pen_down")
_KNOWN: Mapping[str, tuple[str, float]] = {
    **{name: ("time_s", scale) for name, scale in _TIMES.items()}, **_PLACES, **{name: (name, 1.0) for name in _PEN},
}  # fmt: skip
"""The accepted names of columns: the quantity, and the factor to its unit."""

_WANTED = "time_s and x_m (or time_ms, x_mm, ...), and y_m, z_m, pressure, pen_down if there are any"
_LARGEST = 16 << 20  # of a file [bytes]
_HUGE = 1e12  # a number, in any unit
_LONGEST_S, _SPARSE_S, _ROW_S = 3600.0, 60.0, 1.0  # longest motion: in all; with few rows; per row, if that is more
_SHORTEST_S = 0.05
_SLOW_MPS, _SLOW_ROWS, _SLOW_S = 5e-3, 50, 0.25  # no hand that is recorded by many rows moves as slowly as this


def read_columns(name: str, columns: str = "") -> dict[str, Array]:
    """The columns of the file `name`: ``time_s`` [s], ``x_m`` [m] and further ones, each with at least two numbers.

    columns : pairs such as ``time_ms=stamp x_mm=px``, for columns with other names.

    Raises InvalidParameter: names the line, or the column, that is wrong.
    """
    try:
        text = read_text(name, _LARGEST)
        heading = text.partition("\n")[0]
        delimiter = next((mark for mark in ";\t" if mark in heading), ",")
        rows = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter)
        names = [one.strip() for one in next(rows, [])]
        used = _used(name, names, columns)
        table = [numbers for row in rows if (numbers := _numbers(name, rows.line_num, row, used, delimiter))]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise _refused(name, f"this CSV file cannot be read ({why})") from None
    lines = [line for line, _ in table]
    if len(table) < 2:
        raise _refused(name, f"{len(table)} rows of numbers; at least 2 are needed, below a heading with {_WANTED}")
    values = np.array([numbers for _, numbers in table])
    found = {quantity: scale * values[:, i] for i, (quantity, scale, _) in enumerate(used)}
    _check_times(name, found, lines)
    return found


def _used(name: str, names: Sequence[str], columns: str) -> list[tuple[str, float, int]]:
    """The columns that are read: quantity, factor and place. Other columns are ignored."""
    chosen = dict(_pairs(columns))
    for column in chosen.values():
        if column not in names:
            parameter = f"operator_model.{COLUMNS}"
            raise InvalidParameter(parameter, columns, f"columns of {name}, which are {', '.join(names)}", names)
    places = {_KNOWN[given]: names.index(column) for given, column in chosen.items()}
    taken = {quantity for quantity, _ in places}
    for i, column in enumerate(names):
        if column in _KNOWN and _KNOWN[column][0] not in taken and i not in places.values():
            places[_KNOWN[column]] = i
            taken.add(_KNOWN[column][0])
    if missing := {"time_s", "x_m"} - taken:
        if all(_is_number(column) for column in names):
            raise _refused(name, f"line 1 has no names; write a heading with {_WANTED}")
        others = [*(column for column in names if column not in _KNOWN), "COLUMN", "COLUMN"]
        chosen_by = " ".join(f"{one}={other}" for one, other in zip(sorted(missing), others, strict=False))
        flag = f'--set {"operator_model." + COLUMNS}="{chosen_by}"'
        lacks = " and ".join(sorted(missing))
        raise _refused(name, f"line 1 has the columns {', '.join(names) or 'none'}, and no {lacks}; wanted: {_WANTED}. "
                             f"Columns with other names are chosen by {flag}")  # fmt: skip
    return [(quantity, scale, i) for (quantity, scale), i in places.items()]


def _pairs(columns: str) -> Iterator[tuple[str, str]]:
    for pair in columns.replace(",", " ").split():
        given, _, column = pair.partition("=")
        if given not in _KNOWN or not column:
            allowed = f"pairs NAME=COLUMN, with the names {', '.join(_KNOWN)}"
            raise InvalidParameter(f"operator_model.{COLUMNS}", columns, allowed)
        yield given, column


def _numbers(
    name: str, line: int, row: Sequence[str], used: Sequence[tuple[str, float, int]], delimiter: str
) -> tuple[int, list[float]] | None:
    """A row's line and its numbers; None: the row is empty."""
    if not any(cell.strip() for cell in row):
        return None
    numbers = []
    for quantity, _, place in used:
        cell = row[place].strip() if place < len(row) else ""
        text = cell.replace(",", ".") if delimiter != "," else cell
        if not _is_number(text) or not abs(float(text)) < _HUGE:
            what = "is missing" if not cell else f"is {cell[:40]!r}, not a finite number below {_HUGE:g}"
            raise _refused(name, f"line {line}: {quantity} {what}")
        numbers.append(float(text))
    return line, numbers


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _check_times(name: str, table: Mapping[str, Array], lines: Sequence[int]) -> None:
    t = table["time_s"]
    if len(wrong := np.flatnonzero(np.diff(t) <= 0.0)):
        at = int(wrong[0]) + 1
        raise _refused(
            name, f"line {lines[at]}: its time, {t[at]:.10g} s, is not after the one before, {t[at - 1]:.10g} s"
        )
    lasts_s, rows = float(np.ptp(t)), len(t)
    if rows >= 10 and lasts_s < _SHORTEST_S:
        raise _refused(name, f"it lasts {1e3 * lasts_s:.3g} ms in {rows} rows (are the times in another unit than s?)")
    step_s = lasts_s / (rows - 1)
    places = np.column_stack([table[axis] for axis in ("x_m", "y_m", "z_m") if axis in table])
    fastest = float((np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(t)).max())
    if rows >= _SLOW_ROWS and step_s > _SLOW_S and fastest < _SLOW_MPS:
        slow = f"its rows are {step_s:.3g} s apart, and it moves at {1e3 * fastest:.3g} mm/s at most"
        raise _refused(name, f"{slow}: are the times milliseconds? Then name the column time_ms")
    most_s = min(_LONGEST_S, max(_SPARSE_S, _ROW_S * rows))
    if lasts_s > most_s:
        allowed = f"{most_s:g} s at most: {_LONGEST_S:g} s, and {_ROW_S:g} s a row above {_SPARSE_S:g} s"
        raise InvalidParameter("operator", f"{Path(name)}, {lasts_s:g} s", allowed)


def _refused(name: str, why: str) -> InvalidParameter:
    return InvalidParameter("operator", name, "", why=why)
