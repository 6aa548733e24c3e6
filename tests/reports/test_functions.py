"""`hapnet.report` and `hapnet.export`, and a result in a notebook: the same as the commands write."""

import csv
import json
from html import unescape
from pathlib import Path

import pytest

import hapnet
from hapnet import InvalidParameter, cli
from hapnet.errors import MissingLibrary
from hapnet.recording.mcap import save
from hapnet.simulation.result import Result


@pytest.fixture(scope="module")
def result() -> Result:
    return hapnet.simulate({"duration_s": 1.5}, seed=3)


def test_a_report_is_made_of_a_result_its_file_and_its_directory(result: Result, tmp_path: Path) -> None:
    file = tmp_path / "device.mcap"
    save(result.recording, file)
    (tmp_path / "out").mkdir()
    made = hapnet.report(result, tmp_path / "out")
    assert {each.name for each in (tmp_path / "out").iterdir()} == {"report.html", "report.png", "report-link.png"}
    assert made.summary["verdict"] == result.summary["verdict"]
    for what in (file, str(file), [file], tmp_path, result.recording):
        assert hapnet.report(what).summary["verdict"] == result.summary["verdict"]
    assert hapnet.report(file).sources[0].path == file
    assert repr(made) == f"Report(PASSIVE: {result.summary['verdict']['reason']})"


@pytest.mark.slow
def test_the_command_writes_the_same(result: Result, tmp_path: Path) -> None:
    file, to = tmp_path / "run.mcap", tmp_path / "told.json"
    save(result.recording, file)
    made = hapnet.report(file)
    assert hapnet.report(tmp_path).summary == made.summary  # as the directory of a simulation
    assert cli.main(["report", str(file), "--json", str(to)]) == 0
    assert json.loads(to.read_text("utf-8")) == json.loads(json.dumps(made.summary))
    assert (tmp_path / "run.html").read_text("utf-8") == made.page


def test_tables_are_written_beside_the_file_or_where_they_are_wanted(result: Result, tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    save(result.recording, file)
    beside = hapnet.export(file, format="csv")
    (tmp_path / "out").mkdir()
    wanted = hapnet.export(result, tmp_path / "out", format="csv")
    assert [each.relative_to(tmp_path) for each in beside] == [Path("run-device.csv"), Path("run-world.csv")]
    assert [each.read_text("utf-8") for each in wanted] == [each.read_text("utf-8") for each in beside]
    device = result.recording.device
    with wanted[0].open(newline="", encoding="utf-8") as text:
        rows = list(csv.DictReader(text))
    assert [float(row["position_m_x"]) for row in rows] == device["position_m"][:, 0].tolist()
    with pytest.raises(InvalidParameter, match="directory None: name one for the tables"):
        hapnet.export(result)
    with pytest.raises(InvalidParameter, match="--format is 'csw'; allowed: auto, csv"):
        hapnet.export(result, tmp_path, format="csw")


def test_a_result_shows_its_verdict_key_figures_and_picture(result: Result, monkeypatch: pytest.MonkeyPatch) -> None:
    html = result._repr_html_()
    text = unescape(html)
    assert text.count(f"PASSIVE: {result.summary['verdict']['reason']}") == 1
    peak = result.summary["motion"]["peak_force_N"]
    assert f"largest force: {peak:.4g} N" in text
    assert html.count("<img") == 1
    assert hapnet.report(result)._repr_html_() == html

    def missing(*given: object, **more: object) -> None:
        raise MissingLibrary("a figure", "matplotlib", "report")

    monkeypatch.setattr("hapnet.ext.pictures.run.figure", missing)
    assert "<img" not in result._repr_html_()
    assert f"largest force: {peak:.4g} N" in unescape(result._repr_html_())
