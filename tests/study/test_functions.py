"""`hapnet.compare`, `sweep` and `tune`: what a program gets, the same as the commands write."""

import csv
import json
from pathlib import Path
from typing import Any

import pytest

import hapnet
from hapnet import HapnetError, InvalidParameter, cli
from hapnet.ext.metrics import METRICS
from hapnet.ext.study.case import Measures
from hapnet.params import Params

SHORT: dict[str, object] = {"duration_s": 0.2}
VARY = {"coupling": ["pspm", "zoh"], "link": ["lan", "4g"], "seed": "0:2"}


def test_a_comparison_runs_what_is_named_and_no_more() -> None:
    reported: list[tuple[int, int]] = []
    found = hapnet.compare(["pspm", "zoh"], ["lan", "4g"], params=SHORT, progress=lambda *done: reported.append(done))
    rows = found.rows()
    assert [(row["coupling"], row["link"], row["operator"], row["seed"]) for row in rows] == [
        (coupling, link, "press@light", 0) for coupling in ("pspm", "zoh", "local wall") for link in ("lan", "4g")
    ]
    assert len(found) == 5  # the local wall has no link, so it is run once
    assert reported[0] == (0, 5)
    assert reported[-1] == (5, 5)
    assert all(set(METRICS) <= set(row) and row["error"] is None for row in rows)
    assert all(row["passive"] is (row["margin_J"] >= -1e-9) for row in rows)
    assert [row["energy_out_J"] for row in found.medians()] == [row["energy_out_J"] for row in rows_by_link(rows)]
    assert found.headline == ["every coupling was passive in all cases"]
    assert repr(found) == "Comparison(5 cases; every coupling was passive in all cases)"
    html = found._repr_html_()
    assert html.count("<tr>") == 4
    assert all(f">{word}<" in html for word in ("pspm", "zoh", "lan", "4g"))


def rows_by_link(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return sorted(rows, key=lambda row: ["lan", "4g"].index(row["link"]))


def test_the_command_measures_the_same(tmp_path: Path) -> None:
    found = hapnet.compare("zoh", {"slow": "delay 30ms", "apart": ("delay 5ms", "delay 9ms")}, params=SHORT)
    flags = ["--coupling", "zoh", "--link", "slow=delay 30ms", "--link", "apart=delay 5ms|delay 9ms"]
    to = tmp_path / "whole.json"
    assert cli.main(["compare", *flags, "--duration", "0.2", "--workers", "1", "--no-files", "--json", str(to)]) == 0
    reported = json.loads(to.read_text("utf-8"))
    del reported["wall_clock"]
    assert leaves(reported) == leaves(json.loads(json.dumps(found.as_dict())))


def leaves(tree: Any, at: str = "") -> dict[str, Any]:
    """Each number of a JSON tree by its path, so that a difference is named."""
    if not isinstance(tree, dict | list):
        return {at: tree}
    items = tree.items() if isinstance(tree, dict) else enumerate(tree)
    return {path: value for name, part in items for path, value in leaves(part, f"{at}/{name}").items()}


def test_a_directory_keeps_what_was_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = hapnet.compare("zoh", "lan", params=SHORT, directory=tmp_path)

    def never(params: Params, seed: int) -> Measures:
        raise AssertionError

    monkeypatch.setattr("hapnet.ext.study.task.measure", never)
    again = hapnet.compare("zoh", "lan", params=SHORT, directory=tmp_path)
    assert again.rows() == first.rows()
    with pytest.raises(HapnetError, match="of another spec"):
        hapnet.compare("zoh", "4g", params=SHORT, directory=tmp_path)
    with pytest.raises(InvalidParameter, match="no case could run: "):
        hapnet.compare("zoh", "lan", params=SHORT)


def test_what_is_wrong_is_said_before_anything_runs() -> None:
    with pytest.raises(InvalidParameter, match="unknown coupling 'psmp'; did you mean pspm"):
        hapnet.compare("psmp", "4g")
    with pytest.raises(InvalidParameter, match="unknown --link '4gg'; did you mean 4g"):
        hapnet.compare("zoh", "4gg")
    with pytest.raises(InvalidParameter, match="unknown table 'varry'; did you mean vary"):
        hapnet.sweep({"varry": VARY})
    with pytest.raises(InvalidParameter, match=r"SPEC is 'nowhere\.toml'"):
        hapnet.sweep("nowhere.toml")


def test_a_sweep_is_rows_that_a_file_has_too(tmp_path: Path) -> None:
    spec = tmp_path / "study.toml"
    spec.write_text(
        '[fixed]\nduration_s = 0.2\n[vary]\ncoupling = ["pspm", "zoh"]\nlink = ["lan", "4g"]\nseed = "0:2"\n'
    )
    found = hapnet.sweep({"fixed": SHORT, "vary": VARY})
    rows = found.rows()
    assert len(rows) == len(found) == 8
    assert [(row["coupling"], row["link"], row["seed"]) for row in rows] == [
        (coupling, link, seed) for coupling in ("pspm", "zoh") for link in ("lan", "4g") for seed in (0, 1)
    ]
    of_file = hapnet.sweep(spec, directory=tmp_path / "kept").rows()
    timing = ("wall_s", "worker")
    assert [{**row, **dict.fromkeys(timing)} for row in of_file] == [{**row, **dict.fromkeys(timing)} for row in rows]
    (file,) = found.write(tmp_path)
    with file.open(newline="", encoding="utf-8") as text:
        written = list(csv.DictReader(text))
    assert [row["link"] for row in written] == [row["link"] for row in rows]
    assert [float(row["energy_out_J"]) for row in written] == [row["energy_out_J"] for row in rows]
    assert repr(found) == "SweepResult(8 cases, 0 failed)"
    assert found._repr_html_().count("<tr>") == 9
    changed = hapnet.sweep(spec, changes={"duration_s": 0.1}).rows()
    assert changed != rows


def test_a_case_that_fails_says_why() -> None:
    found = hapnet.sweep({"fixed": SHORT, "vary": {"world.wall.stiffness": [3000.0, -1.0]}})
    assert [row["error"] is None for row in found.rows()] == [True, False]
    assert sum(found.errors.values()) == 1
    assert repr(found) == "SweepResult(2 cases, 1 failed)"


def test_a_sweep_is_a_table_of_pandas() -> None:
    pandas = pytest.importorskip("pandas", reason="the extra pandas is not installed")
    found = hapnet.sweep({"fixed": SHORT, "vary": {"link": ["lan", "4g"]}})
    assert list(found.to_pandas()["link"]) == ["lan", "4g"]
    assert list(pandas.DataFrame(found.rows()).columns) == list(found.to_pandas().columns)


def formula(params: Params, seed: int) -> Measures:
    """Free motion wants a lead of 0.3, the wall one of 0.4 at least."""
    lead = params.contact_model.lead
    return {
        "free_rms_mm": abs(lead - 0.3),
        "stiffness_percent": 50.0 + 100.0 * lead,
        "margin_J": 0.1,
        "claim_kept": 1.0,
    }


def test_a_tuning_finds_what_the_formula_asks_for(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("optuna", reason="the extra tune is not installed")
    monkeypatch.setattr("hapnet.ext.study.task.measure", formula)
    spec = {
        "tune": {"objective": {"free_rms_mm": 1.0}, "constraints": ["stiffness_percent >= 90"], "trials": 40},
        "search": {"contact_model.lead": {"from": 0.0, "to": 1.0}},
        "fixed": SHORT,
        "vary": {"link": ["lan"]},
        "score": {"link": ["wifi"]},
    }
    found = hapnet.tune(spec)
    assert found.found["contact_model.lead"] == pytest.approx(0.4, abs=0.05)
    assert found.params().contact_model.lead == found.found["contact_model.lead"] >= 0.4
    rows = found.rows()
    assert len(rows) == 40
    (chosen,) = [row for row in rows if row["chosen"]]
    assert chosen["allowed"]
    assert chosen["objective"] == pytest.approx(abs(chosen["contact_model.lead"] - 0.3))
    assert found.as_dict()["best_trial"] == chosen["trial"]
    assert "contact_model.lead" in repr(found)
    assert "contact_model.lead" in found._repr_html_()
