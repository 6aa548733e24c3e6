"""`hapnet export`: recordings as tables, in files that others read."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet

from hapnet import cli
from hapnet.recording import export
from hapnet.recording.frames import table
from hapnet.recording.mcap import read_recording, save
from tests.recording.test_samples import META, ORIGIN, device_sample, halves, memory, run
from tests.support.commands import Capture, empty_directory as empty_directory
from tests.support.processes import no_room

UTC = META | {"utc_origin_ns": ORIGIN + 5_000, "utc_clock": "system"}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Both sides and two events, of two axes; in every other sample the hand's force is unknown."""
    save(memory(run(2), UTC), tmp_path / "run.mcap")
    return tmp_path / "run.mcap"


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as lines:
        return list(csv.DictReader(lines))


def test_a_table_a_side_and_one_of_the_events(file: Path, capsys: Capture) -> None:
    assert cli.main(["export", str(file), "--format", "csv"]) == 0
    assert f"files: run-device.csv, run-world.csv, run-events.csv in {file.parent}" in capsys.readouterr().out
    device = rows(file.with_name("run-device.csv"))
    assert len(device) == 300
    assert list(device[0])[:5] == ["time_s", "utc_ns", "time_ns", "position_m_x", "position_m_y"]
    sample = device_sample(7)
    assert (int(device[7]["time_ns"]), int(device[7]["utc_ns"])) == (sample.time_ns, sample.time_ns + 5_000)
    assert float(device[7]["time_s"]) == 0.007
    assert (float(device[7]["position_m_x"]), float(device[7]["position_m_y"])) == sample.position_m
    assert (float(device[7]["age_s"]), float(device[7]["velocity_mps_x"])) == (sample.age_s, sample.target_m[0] / 3.0)
    assert [row["operator_force_N_x"] == "" for row in device[:4]] == [False, True, False, True]
    assert len(rows(file.with_name("run-world.csv"))) == 10
    events = rows(file.with_name("run-events.csv"))
    assert [(row["kind"], row["text"]) for row in events] == [("paired", "session ‘a’"), ("note", "two")]
    assert [int(row["utc_ns"]) for row in events] == [ORIGIN + 5_000, ORIGIN + 5_005]


def test_parquet_says_the_same_and_keeps_the_settings(file: Path, tmp_path: Path) -> None:
    assert cli.main(["export", str(file), "--format", "both", "--out", str(tmp_path / "tables")]) == 0
    read = parquet.read_table(tmp_path / "tables" / "run-device.parquet")
    expected = table(read_recording(file))
    assert read.column_names == list(expected)
    for name, values in expected.items():
        column = read.column(name)
        assert column.null_count == np.count_nonzero(np.isnan(values))
        found = column.to_numpy()
        np.testing.assert_array_equal(found, values, err_msg=name)
    assert str(read.schema.field("utc_ns").type) == "int64"
    assert json.loads(read.schema.metadata[export.SETTINGS]) == read_recording(file).meta
    with (tmp_path / "tables" / "run-device.csv").open(encoding="utf-8") as lines:
        assert next(lines).strip().split(",") == read.column_names


def test_one_side_keeps_its_name_and_json_says_what_was_written(tmp_path: Path, capsys: Capture) -> None:
    device, _ = halves({}, 0)
    save(device, tmp_path / "device.mcap")
    assert cli.main(["export", str(tmp_path / "device.mcap"), "--format", "csv", "--json", "-"]) == 0
    out, err = capsys.readouterr()
    reported = json.loads(out)
    assert reported["files"] == [str(tmp_path / "device.csv")]
    assert reported["samples"] == {"device": 5, "world": None}
    assert "files: device.csv" in err
    assert "utc_ns" not in rows(tmp_path / "device.csv")[0]  # an older recording does not say


def test_of_clocks_that_cannot_be_compared_it_says_so(tmp_path: Path, capsys: Capture) -> None:
    for part, name in zip(halves({"clock": "boot-2", "origin_ns": 5_000}, 6_000), ("device", "world"), strict=True):
        save(part, tmp_path / f"{name}.mcap")
    files = [str(tmp_path / "world.mcap"), str(tmp_path / "device.mcap")]
    assert cli.main(["export", *files, "--format", "csv"]) == 0
    out = capsys.readouterr().out
    assert "clocks: the two hosts' clocks cannot be compared: each side begins at its own start" in out
    assert "files: device.csv, world.csv, device-world-events.csv" in out


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["nothing.mcap"], "cannot read recording nothing.mcap"),
        (["a.mcap", "b.mcap", "c.mcap"], "one recording, or the device's and the world's"),
        (["run.mcap", "--format", "xls"], "--format is 'xls'; allowed: auto, csv, parquet, both"),
        ([], "Missing argument"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(words: list[str], says: str, capsys: Capture) -> None:
    assert cli.main(["export", *words]) == 2
    err = capsys.readouterr().err
    assert says in err
    assert err.count("\n") == 1


def test_without_pyarrow_parquet_names_the_extra(file: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    monkeypatch.setattr(export, "find_spec", lambda name: None)
    assert cli.main(["export", str(file), "--format", "parquet"]) == 2
    err = capsys.readouterr().err
    assert "--format parquet needs pyarrow, of the extra `sweep`, which is not installed" in err
    assert err.count("\n") == 1
    assert cli.main(["export", str(file)]) == 0
    assert not list(file.parent.glob("*.parquet"))


def test_a_table_that_cannot_be_written_is_told_and_leaves_nothing(file: Path, capsys: Capture) -> None:
    with no_room(10_000):
        assert cli.main(["export", str(file), "--format", "csv"]) == 3
    assert "cannot write table" in capsys.readouterr().err
    assert [path.name for path in file.parent.iterdir() if path.is_file()] == ["run.mcap"]
