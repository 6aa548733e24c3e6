"""The results of a sweep as a table in CSV and Parquet, with a row for each case, sorted by case."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from hapnet.ext.study.journal import Journal, JournalRow
from hapnet.ext.study.spec import LINK, SEED, flat_of, link_words, value_words
from hapnet.recording.export import write_csv
from hapnet.recording.whole_file import complete_or_absent

NAME = "results"
TIMING = ("wall_s", "worker")
"""The last columns, the only ones that differ between two runs of the same sweep."""
_WORDS = (LINK, "error", "worker")

Table = dict[str, list[Any]]
"""Columns by name; None for a missing value."""


def table(journal: Journal) -> Table:
    """The cases that were run, in columns: number, varied values, seed, link, metrics, error, `TIMING`."""
    rows = [row for row in journal.rows() if row.done]
    metrics = dict.fromkeys(name for row in rows for name in row.measures)
    varied = [name for name in journal.varied if name != LINK]
    columns: Table = {"case": [row.case.number for row in rows]}
    columns |= {name: [_plain(row.case.values[name]) for row in rows] for name in varied}
    columns[SEED] = [row.case.seed for row in rows]
    columns[LINK] = _links(journal, rows)
    columns |= {name: [row.measures.get(name) for row in rows] for name in metrics}
    columns["error"] = [row.error for row in rows]
    return columns | {name: [getattr(row, name) for row in rows] for name in TIMING}


def write(columns: Table, directory: Path, endings: Iterable[str]) -> list[Path]:
    """Write the table as ``results.csv`` and ``results.parquet``; each file appears only when it is complete.

    Raises RecordingError: a file cannot be written.
    """
    paths = []
    for ending in endings:
        path = directory / f"{NAME}.{ending}"
        with complete_or_absent(path, "results") as part:
            if ending == "csv":
                write_csv(part, columns, zip(*columns.values(), strict=True))
            else:
                _parquet(columns, part)
        paths.append(path)
    return paths


def _parquet(columns: Table, path: Path) -> None:
    import pyarrow
    from pyarrow import parquet

    arrays = {}
    for name, values in columns.items():
        kind = _type(name, values)
        plain = [None if x is None else str(x) for x in values] if kind == "string" else values
        arrays[name] = pyarrow.array(plain, kind)
    parquet.write_table(pyarrow.table(arrays), path)


def _type(name: str, values: list[Any]) -> str:
    """Arrow's name for the type of a column; a metric without any value is a number."""
    kinds = {type(value) for value in values} - {type(None)}
    if name in _WORDS or not kinds <= {bool, int, float}:
        return "string"
    return "bool" if kinds == {bool} else "int64" if kinds == {int} else "float64"


def _plain(value: Any) -> Any:
    """A matrix as JSON, as a cell holds a single value; any other value unchanged."""
    return json.dumps(value) if isinstance(value, list) else value


def _links(journal: Journal, rows: list[JournalRow]) -> list[str]:
    """The link of each case, as in the spec if the link varies."""
    known: dict[str, str] = {}
    found = []
    for row in rows:
        link = {name: value for name, value in row.case.values.items() if name.partition(".")[0] == LINK}
        label = json.dumps(link)
        if label not in known:
            every = flat_of(journal.fixed, link)
            words = value_words(LINK, link[LINK]) if LINK in link else link_words(every["link.up"], every["link.down"])
            known[label] = words
        found.append(known[label])
    return found
