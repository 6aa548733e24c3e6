"""Which runs fall into which cell of a figure."""

import statistics
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.metrics import METRICS
from hapnet.ext.pictures.grid import GridAxis, metric_label, statistic, usual_statistic
from hapnet.ext.study.grid import grid, shown
from hapnet.ext.study.journal import Journal
from hapnet.ext.study.task import CaseResult
from tests.study.sweeps import journal_of

TEXT = """
[vary]
link = ["4g", "lan"]
device.stiffness = { from = 400, to = 50, steps = 4, scale = "log" }
coupling = ["pspm", "zoh"]
seed = "0:5"
"""


def filled(tmp_path: Path) -> Journal:
    """Values that show where they come from; over the link lan every third case failed, and the last was not run."""
    journal = journal_of(tmp_path, TEXT)
    results = []
    for case in journal.pending()[:-1]:
        failed = case.values["link"] == "lan" and case.number % 3 == 0
        value = case.values["device.stiffness"] + case.seed
        measures = {"gap_m": value, "extra": None} if case.values["coupling"] == "pspm" else {"gap_m": -value}
        results.append(CaseResult(case.number, {}, "broken") if failed else CaseResult(case.number, measures))
    journal.record(results)
    return journal


def test_cells_hold_their_runs(tmp_path: Path) -> None:
    journal = filled(tmp_path)
    found = grid(journal, "device.stiffness", "link", "gap_m", {"coupling": "pspm"}, {"device.stiffness": "N/m"})
    assert found.x.values == pytest.approx((50.0, 100.0, 200.0, 400.0))
    assert found.y.values == ("4g", "lan")
    assert found.over == ("5 seeds",)
    assert found.x.label == "device.stiffness [N/m], log scale"
    for i, stiffness in enumerate(found.x.values):
        assert found.cells[i, 0].values == [stiffness + seed for seed in range(5)]
        numbers = [40 + 10 * (3 - i) + seed for seed in range(5)]  # the file goes down from 400
        assert found.cells[i, 1].failed == sum(number % 3 == 0 for number in numbers)
        assert len(found.cells[i, 1].values) == 5 - found.cells[i, 1].failed
    journal.close()


def test_what_is_chosen_where_nothing_is_asked_for(tmp_path: Path) -> None:
    journal = filled(tmp_path)
    found = grid(journal, None, None, None, {}, {})
    assert (found.x.name, found.y and found.y.name, found.metric) == ("device.stiffness", "link", "gap_m")
    assert found.over == ("2 couplings", "5 seeds")
    assert sum(cell.missing for cell in found.cells.values()) == 1
    alone = grid(journal, "link", None, None, {}, {})
    assert alone.y is None
    assert alone.cells[0, 0].values == sorted(alone.cells[0, 0].values, key=alone.cells[0, 0].values.index)
    assert len(alone.cells[0, 0].values) == 40
    one = grid(journal, None, None, None, {"link": "4g", "coupling": "zoh"}, {})
    assert (one.x.name, one.y) == ("device.stiffness", None)
    seeds = grid(journal, None, None, None, {"link": "4g", "coupling": "zoh", "device.stiffness": "100"}, {})
    assert (seeds.x.name, seeds.x.values) == ("seed", (0, 1, 2, 3, 4))
    assert grid(journal, None, "coupling", None, {}, {}).x.name == "device.stiffness"
    journal.close()


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"x": "device.mass"}, "--x is 'device.mass'; allowed: .*link, device.stiffness, coupling, seed"),
        ({"y": "sed"}, "unknown --y 'sed'; did you mean seed"),
        ({"x": "link", "y": "link"}, "--x shows it already"),
        ({"metric": "gap"}, "unknown --value 'gap'; did you mean gap_m"),
        ({"where": {"link": "5g"}}, "--where link is '5g'; allowed: 4g, lan"),
        ({"where": {"device.stiffness": "60"}}, "allowed: 50, 100, 200, 400"),
        ({"where": {"device.stiffness": "soft"}}, "allowed: 50"),
        ({"where": {"mass": "1"}}, "--where is 'mass'"),
    ],
)
def test_what_the_sweep_has_not_is_refused(tmp_path: Path, asked: dict[str, object], said: str) -> None:
    journal = filled(tmp_path)
    given: dict[str, Any] = {"x": None, "y": None, "metric": None, "where": {}, "units": {}} | asked
    with pytest.raises(InvalidParameter, match=said):
        grid(journal, **given)
    journal.close()


def test_nothing_to_draw_yet(tmp_path: Path) -> None:
    journal = journal_of(tmp_path, TEXT)
    with pytest.raises(HapnetError, match="nothing to draw"):
        grid(journal, None, None, None, {}, {})
    journal.close()


def test_statistics_are_those_of_the_library() -> None:
    values = [3.0, -1.0, 7.0, 8.0]
    assert statistic("median")(values) == statistics.median(values)
    assert statistic("mean")(values) == statistics.fmean(values)
    assert (statistic("min")(values), statistic("max")(values)) == (-1.0, 8.0)
    assert statistic("p100")(values) == 8.0
    assert statistic("p25")(values) == statistics.quantiles(values, n=4, method="inclusive")[0]
    for wrong in ("p101", "medain", ""):
        with pytest.raises(InvalidParameter, match=r"did you mean median|or a percentile"):
            statistic(wrong)


def test_of_a_margin_the_least_is_shown() -> None:
    usual = {name: usual_statistic(name) for name in METRICS}
    least = {name for name, word in usual.items() if word == "min"}
    margins = {"margin_J", "margin_end_J", "margin_later_J", "hand_margin_J", "actuator_margin_J"}
    assert least == margins | {"claim_kept"}
    assert {name for name, word in usual.items() if word == "max"} == {"energy_out_J"}
    assert {word for name, word in usual.items() if name not in least | {"energy_out_J"}} == {"median"}


def test_scales_are_seen_in_the_values() -> None:
    def axis(*values: object) -> GridAxis:
        return GridAxis("a", "N", values, ())

    assert axis(1, 10, 100).log
    assert axis(*np.geomspace(3.0, 7.0, 9)).log
    assert not axis(1.0, 2.0, 3.0).log
    assert not axis(1, 10).log
    assert not axis(0, 1, 10).log
    assert not axis("1", "10", "100").log
    assert not axis(1.0, 2.0, 10.0).log
    assert axis(1.0, 2.0, 3.0).label == "a [N]"
    assert [shown("a", value) for value in (True, False)] == ["true", "false"]
    assert not axis(True, False).numeric
    numbers = (12345, 30000.0, 84.0896415, 1e-3, 2.5e7)
    assert [shown("a", value) for value in numbers] == ["12345", "30000", "84.09", "0.001", "2.5e+07"]


@pytest.mark.parametrize("words", ["84.09", "84.0896415254"])
def test_a_value_is_asked_for_as_it_is_printed(tmp_path: Path, words: str) -> None:
    journal = journal_of(tmp_path, "[vary]\ndevice.stiffness = { from = 50, to = 400, steps = 5, scale = 'log' }")
    journal.record([CaseResult(number, {"m": float(number)}) for number in range(5)])
    found = grid(journal, "seed", None, None, {"device.stiffness": words}, {})
    assert found.cells[0, 0].values == [1.0]
    with pytest.raises(InvalidParameter, match=r"allowed: 50, 84\.09, 141\.4"):
        grid(journal, "seed", None, None, {"device.stiffness": "84"}, {})
    journal.close()


@pytest.mark.parametrize(
    ("metric", "figures", "label", "scale"),
    [
        ("margin_J", [3.0, -0.01], "two-port margin [J]", 1.0),
        ("margin_J", [0.03, -0.01], "two-port margin [mJ]", 1e3),
        ("free_rms_mm", [0.03], "position error, free [mm]", 1.0),
        ("of_another_version_m", [0.001], "of another version m", 1.0),
        ("margin_J", [], "two-port margin [J]", 1.0),
        ("margin_J", [0.0], "two-port margin [J]", 1.0),
    ],
)
def test_labels_and_units_are_those_of_the_metrics(metric: str, figures: list[float], label: str, scale: float) -> None:
    assert metric_label(metric, figures) == (label, scale)
