"""The table of a sweep, as CSV and as Parquet."""

import csv
from pathlib import Path

import pytest
from pyarrow import parquet

from hapnet.errors import InvalidParameter, MissingLibrary, RecordingError
from hapnet.ext.study import export
from hapnet.ext.study.task import CaseResult
from hapnet.recording import export as tables
from tests.study.sweeps import journal_of
from tests.support.processes import no_room

TEXT = """
[fixed]
link.up = "lan"
[[vary]]
device.stiffness = [50, [[100.0]]]
wire.accept_stale = [true, false]
seed = [3, 4]
[[vary]]
link.down = ["lan", "", "4g"]
"""


def written(tmp_path: Path, *endings: str) -> tuple[export.Table, list[Path]]:
    journal = journal_of(tmp_path, TEXT)
    journal.record([CaseResult(9, {"late_ms": 0.1 + 0.2, "margin_J": 1.0}, None, 0.5, "host:7")])
    journal.record([CaseResult(0, {"margin_J": -1e-20, "contacts": 3}, None, 0.25, "host:8")])
    journal.record([CaseResult(2, {}, 'it said "no", and\tmore', 0.125, "host:7"), CaseResult(10, {}, "died")])
    table = export.table(journal)
    journal.close()
    return table, export.write(table, tmp_path, endings)


def test_a_row_a_case_that_was_run_in_their_order_with_columns_by_name(tmp_path: Path) -> None:
    table, (file,) = written(tmp_path, "csv")
    assert list(table) == [
        *("case", "device.stiffness", "wire.accept_stale", "link.down", "seed", "link"),
        *("margin_J", "contacts", "late_ms", "error", "wall_s", "worker"),
    ]
    assert tuple(list(table)[-2:]) == export.TIMING
    with file.open(newline="", encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines))
    assert [row["case"] for row in rows] == ["0", "2", "9", "10"]
    assert [row["device.stiffness"] for row in rows] == ["50.0", "50.0", "0.0", "0.0"]  # by default
    assert [row["wire.accept_stale"] for row in rows] == ["true", "false", "false", "false"]
    assert [row["seed"] for row in rows] == ["3", "3", "0", "0"]
    assert [row["link"] for row in rows][2:] == ["up lan, down ideal", "up lan, down 4g"]
    assert [row["margin_J"] for row in rows] == ["-1e-20", "", "1.0", ""]
    assert float(rows[2]["late_ms"]) == 0.1 + 0.2
    assert [row["error"] for row in rows] == ["", 'it said "no", and\tmore', "", "died"]
    assert [row["wall_s"] for row in rows] == ["0.25", "0.125", "0.5", ""]


def test_parquet_says_the_same_with_types(tmp_path: Path) -> None:
    table, files = written(tmp_path, "csv", "parquet")
    assert [file.name for file in files] == ["results.csv", "results.parquet"]
    read = parquet.read_table(files[1])
    assert read.to_pydict() == table
    types = dict(zip(read.column_names, map(str, read.schema.types), strict=True))
    assert {name: types[name] for name in ("case", "seed", "contacts", "margin_J", "late_ms", "wall_s", "error")} == {
        **dict.fromkeys(("case", "seed", "contacts"), "int64"),
        **dict.fromkeys(("margin_J", "late_ms", "wall_s"), "double"),
        "error": "string",
    }


def test_matrices_are_text_in_a_cell(tmp_path: Path) -> None:
    journal = journal_of(tmp_path, "[vary]\ndevice.stiffness = [50, [[100.0, 5], [5, 80]]]\ndof = [2]")
    journal.record([CaseResult(n, {"m": None}) for n in (0, 1)])
    table = export.table(journal)
    journal.close()
    export.write(table, tmp_path, ("csv", "parquet"))
    assert table["device.stiffness"] == [50.0, "[[100.0, 5], [5, 80]]"]
    assert parquet.read_table(tmp_path / "results.parquet").to_pydict()["device.stiffness"] == [
        "50.0",
        "[[100.0, 5], [5, 80]]",
    ]


def test_results_are_whole_or_those_of_before(tmp_path: Path) -> None:
    table, (file,) = written(tmp_path, "csv")
    before = file.read_bytes()
    with no_room(len(before) // 2), pytest.raises(RecordingError, match=r"cannot write results .*results\.csv"):
        export.write(table, tmp_path, ("csv",))
    assert file.read_bytes() == before
    assert not list(tmp_path.glob("*.part"))
    with no_room(200), pytest.raises(RecordingError, match=r"cannot write results .*results\.parquet"):
        export.write(table, tmp_path, ("parquet",))
    assert not (tmp_path / "results.parquet").exists()


def test_formats_by_what_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    assert tables.formats("auto") == tables.formats("both") == ("csv", "parquet")
    assert tables.formats("parquet") == ("parquet",)
    monkeypatch.setattr(tables, "find_spec", lambda name: None)
    assert tables.formats("auto") == tables.formats("csv") == ("csv",)
    with pytest.raises(MissingLibrary, match="--format parquet needs pyarrow, of the extra `sweep`"):
        tables.formats("parquet")
    with pytest.raises(InvalidParameter, match="auto, csv, parquet, both"):
        tables.formats("xls")
