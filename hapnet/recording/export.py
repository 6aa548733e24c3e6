"""A recording as tables in files: CSV for everything, Parquet (pyarrow, extra `sweep`) for much data."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Sequence
from importlib.util import find_spec
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapnet.errors import InvalidParameter, MissingLibrary
from hapnet.recording import rosbag
from hapnet.recording.frames import knows_utc, table
from hapnet.recording.opened import Recorded, opened
from hapnet.recording.samples import Recording, plain, utc_less_clock_ns
from hapnet.recording.whole_file import complete_or_absent

FORMATS = ("auto", "csv", "parquet", "both")
ROSBAG = "rosbag2"
"""A further format of a recording: one directory for both sides."""
SETTINGS = b"hapnet"
"""The settings of a recording in a Parquet file: a JSON text under this key of its metadata."""


def formats(word: str, *others: str) -> tuple[str, ...]:
    """The file endings for ``auto``, ``csv``, ``parquet`` or ``both``; `others`: further formats that an error names.

    Raises InvalidParameter: `word` is none of these. MissingLibrary: `word` includes Parquet, but pyarrow is not
    installed.
    """
    if word not in FORMATS:
        raise InvalidParameter("--format", word, ", ".join((*FORMATS, *others)), (*FORMATS, *others))
    there = find_spec("pyarrow") is not None
    if word in ("parquet", "both") and not there:
        raise MissingLibrary(f"--format {word}", "pyarrow", "sweep")
    return {"csv": ("csv",), "parquet": ("parquet",)}.get(word, ("csv", "parquet") if there else ("csv",))


def export(what: Recorded, directory: str | PathLike[str] | None = None, *, format: str = "auto") -> list[Path]:
    """Write the recording of a run as tables, as `hapnet export` does; returns their paths.

    ``export("runs/1", format="csv")``. The recording may be a run's result, a file, the device's and the world's file,
    or a run's directory.

    directory : for the tables; None: beside the file. format : csv, parquet, both, or auto: both if pyarrow is
        installed; or rosbag2, one directory for both sides (`hapnet.recording.rosbag`).

    Raises InvalidParameter: there are no samples, or no directory and no file. MissingLibrary: pyarrow is needed and
    not installed. RecordingError: a recording cannot be read, or a table cannot be written.
    """
    endings = () if format == ROSBAG else formats(format, ROSBAG)
    found = opened(what)
    whole = found.whole
    if whole.device is None and whole.world is None and not whole.events:
        raise InvalidParameter("FILE", str(found.files[0] if found.files else whole), "a recording with samples")
    if directory is None and not found.files:
        raise InvalidParameter("directory", None, "", why="name one for the tables: the recording is not from a file")
    if not endings:
        path = (found.files[0].parent if directory is None else Path(directory)) / ROSBAG
        rosbag.write(whole, path)
        return [path]
    ordered = sorted(zip(found.files, found.parts, strict=False), key=lambda one: one[1].device is None)
    into = found.files[0].parent if directory is None else Path(directory)
    return write(whole, into, [file.stem for file, _ in ordered] or ["run"], endings)


def write(recording: Recording, directory: Path, stems: Sequence[str], endings: Iterable[str]) -> list[Path]:
    """Write a table for each side and a table of the events; each file appears only when it is complete.

    stems : the names of the recordings' files, without endings. With the device only, ``device.mcap`` becomes
        ``device.csv`` and ``device-events.csv``; with both sides, ``run.mcap`` becomes ``run-device.csv``,
        ``run-world.csv`` and ``run-events.csv``.

    Raises RecordingError: a table cannot be written.
    """
    tables: dict[str, dict[str, Any]] = {}
    for k, side in enumerate(side for side in ("device", "world") if getattr(recording, side) is not None):
        stem = stems[min(k, len(stems) - 1)]
        tables[stem if stem == side else f"{stem}-{side}"] = dict(table(recording, side))
    if recording.events:
        tables["-".join(dict.fromkeys([*stems, "events"]))] = _events(recording)
    paths = []
    for ending in endings:
        for name, columns in tables.items():
            path = directory / f"{name}.{ending}"
            with complete_or_absent(path, "table") as part:
                if ending == "csv":
                    write_csv(part, columns, zip(*map(_cells, columns.values()), strict=True))
                else:
                    _parquet(columns, part, recording.meta)
            paths.append(path)
    return paths


def _events(recording: Recording) -> dict[str, Any]:
    times = np.array([event.time_ns for event in recording.events], dtype=np.int64)
    found: dict[str, Any] = {"time_s": (times - int(recording.meta["origin_ns"])) / 1e9}
    if knows_utc(recording):
        found["utc_ns"] = times + utc_less_clock_ns(recording.meta)
    return {
        **found, "time_ns": times, "kind": [event.kind for event in recording.events],
        "level": [event.level for event in recording.events],
        "text": [event.text for event in recording.events],
    }  # fmt: skip


def write_csv(path: Path, names: Iterable[str], rows: Iterable[Iterable[Any]]) -> None:
    """Write rows below the names of their columns; None is an empty cell. Raises OSError."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        writer.writerows([str(x).lower() if isinstance(x, bool) else x for x in row] for row in rows)


def _cells(values: NDArray[Any] | list[str]) -> list[Any]:
    """The values as cells; an unknown value is an empty cell."""
    if isinstance(values, list) or values.dtype.kind != "f":
        return list(values)
    cells: list[Any] = values.tolist()
    for at in np.flatnonzero(np.isnan(values)).tolist():
        cells[at] = ""
    return cells


def _parquet(columns: dict[str, Any], path: Path, meta: dict[str, Any]) -> None:
    """Write a Parquet file; an unknown value is null."""
    import pyarrow
    from pyarrow import parquet

    arrays = {name: pyarrow.array(values, from_pandas=True) for name, values in columns.items()}
    settings = json.dumps(plain(meta), allow_nan=False)
    parquet.write_table(pyarrow.table(arrays, metadata={SETTINGS: settings}), path)
