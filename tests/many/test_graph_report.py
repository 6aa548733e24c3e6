"""`hapnet report` of the directory of a graph's run: a page for each pair, and one with the verdict on all."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hapnet import cli
from hapnet.summary.causes import INCOMPLETE
from tests.support.commands import Capture, empty_directory as empty_directory
from tests.support.processes import started, without_progress
from tests.support.wrong_graphs import GOOD, LEADS

Change = Callable[[dict[str, Any]], None]


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The directory of a graph's run, which no test changes."""
    directory = tmp_path_factory.mktemp("graph")
    (directory / "g.toml").write_text(GOOD, "utf-8")
    assert cli.main(["simulate", "--graph", str(directory / "g.toml"), "--out", str(directory / "run")]) == 0
    return directory / "run"


@pytest.fixture
def run(simulated: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(simulated, tmp_path / "run"))


def change(run: Path, by: Change) -> None:
    """Change what the run has written down about itself."""
    summary = json.loads((run / "summary.json").read_text("utf-8"))
    by(summary)
    (run / "summary.json").write_text(json.dumps(summary), "utf-8")


def colours(page: str) -> list[str]:
    """The colour of each pair in the picture of the graph."""
    return re.findall(r"stroke: var\(--(\w+)\)", page)


def test_one_page_has_the_verdict_all_pairs_and_all_nodes(run: Path, capsys: Capture) -> None:
    written = json.loads((run / "summary.json").read_text("utf-8"))
    assert cli.main(["report", str(run), "--json", str(run / "again.json")]) == 0
    shown = capsys.readouterr().out
    assert "PASSIVE: each of 2 pairs" in shown
    again = json.loads((run / "again.json").read_text("utf-8"))
    assert again["verdict"] == written["verdict"]
    assert again["nodes"] == written["nodes"]
    for name, edge in written["edges"].items():
        assert again["edges"][name]["theorem"] == edge["theorem"]
    page = (run / "report.html").read_text("utf-8")
    assert colours(page) == ["good", "good"]
    pages = re.findall(r'href="([^"]+)"', page)
    assert pages == ["alice-table.html", "bob-table.html"]
    assert all("<h2>Summary</h2>" in (run / one).read_text("utf-8") for one in pages)
    sent = written["nodes"]["alice"]["sent_nJ"]
    assert f"<td>{1e-6 * sent:.4g}</td>" in page


def test_a_follower_that_leads_is_at_the_end_of_two_pairs(tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "g.toml").write_text(LEADS, "utf-8")
    assert cli.main(["simulate", "--graph", str(tmp_path / "g.toml"), "--out", str(tmp_path / "run")]) == 0
    assert cli.main(["report", str(tmp_path / "run")]) == 0
    assert "PASSIVE: each of 2 pairs" in capsys.readouterr().out
    page = (tmp_path / "run" / "report.html").read_text("utf-8")
    assert colours(page) == ["good", "good"]
    assert re.findall(r'href="([^"]+)"', page) == ["alice-bob.html", "bob-carl.html"]


def test_a_node_that_sent_more_than_its_ledgers_count_is_named(run: Path, capsys: Capture) -> None:
    def more(summary: dict[str, Any]) -> None:
        summary["nodes"]["alice"]["sent_nJ"] += 10**9

    change(run, more)
    cli.main(["report", str(run)])
    assert "NOT PASSIVE: alice sent 1e+03 mJ" in capsys.readouterr().out
    assert "NOT PASSIVE: alice sent" in (run / "report.html").read_text("utf-8")


def test_a_pair_without_a_recording_leaves_the_verdict_open(run: Path, capsys: Capture) -> None:
    (run / "bob-table.mcap").unlink()
    assert cli.main(["report", str(run), "--out", str(run / "more")]) == INCOMPLETE
    said = capsys.readouterr()
    assert "PASSIVITY NOT KNOWN: bob-table" in said.out
    assert "bob-table: there is no recording of it" in said.err
    page = (run / "more" / "report.html").read_text("utf-8")
    assert colours(page) == ["good", "unknown"]
    assert not (run / "more" / "bob-table.html").exists()


BAD: dict[str, tuple[Change, str]] = {
    "a name that is a path": (
        lambda summary: summary["nodes"]["alice"].update(edges=["../../elsewhere"]),
        "elsewhere",
    ),
    "nodes in a list": (lambda summary: summary.update(nodes=[1]), "its settings do not fit"),
    "a node that is no table": (lambda summary: summary["nodes"].update(alice=3), "its settings do not fit"),
    "a node without a kind": (lambda summary: summary["nodes"]["alice"].pop("kind"), "its settings do not fit"),
    "an account of texts": (lambda summary: summary["nodes"]["alice"].update(sent_nJ="much"), "do not fit"),
    "seats of numbers": (
        lambda summary: summary["nodes"]["table"].update(reservoirs={"seats": {"alice-table": 1}}),
        "do not fit",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_a_summary_that_does_not_fit_is_answered_in_one_line(name: str, run: Path, capsys: Capture) -> None:
    by, says = BAD[name]
    change(run, by)
    assert cli.main(["report", str(run)]) != 0
    lines = without_progress(capsys.readouterr().err).splitlines()
    assert len(lines) == 1, lines
    assert says in lines[0]
    assert not (run / "report.html").exists()


def test_names_are_shown_as_they_are(run: Path, capsys: Capture) -> None:
    change(run, lambda summary: summary["nodes"].update({"<b>": {"kind": "device", "edges": []}}))
    assert cli.main(["report", str(run)]) == 0
    page = (run / "report.html").read_text("utf-8")
    assert "<b>" not in page
    assert "&lt;b&gt;" in page


@pytest.mark.slow
def test_a_run_in_real_time_has_a_recording_of_each_side(tmp_path: Path) -> None:
    file, out = tmp_path / "g.toml", tmp_path / "run"
    file.write_text(GOOD, "utf-8")
    with started("run", "--graph", file, "--duration", "2", "--out", out) as live:
        assert live.end()[0] in (0, INCOMPLETE)
    with started("report", out, "--json", "-") as report:
        code, found, _ = report.end()
    assert code in (0, INCOMPLETE)
    edges = json.loads(found)["edges"]
    assert all(edges[name]["device"] and edges[name]["world"] for name in ("alice-table", "bob-table"))
    assert (out / "report.html").exists()
