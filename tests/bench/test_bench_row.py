import json
import math

import numpy as np
import pytest
from matplotlib.patches import StepPatch

from hapnet.errors import InvalidParameter
from hapnet.ext.bench import report
from hapnet.ext.bench.registry import ROWS, select
from hapnet.ext.bench.row import Distribution, Limit, RoundFigures, Row

REQUIRED = {
    "servo_idle", "servo_traffic", "servo_traffic_5khz", "servo_busy_thread", "device_tick", "pspm_update_3dof",
    "world_step_wall", "codec_position", "codec_energy", "one_way_latency", "one_way_latency_realtime", "link_release",
    "energy_recovery", "simulate_1dof", "simulate_3dof", "batch_1000",
}  # fmt: skip
HUNDRED = Distribution.of(range(1, 101))


def test_quantiles_are_measured_values() -> None:
    assert [HUNDRED.quantile(q) for q in (0.0, 0.5, 0.99, 1.0)] == [1.0, 50.0, 99.0, 100.0]
    assert Distribution.of([3.0, 1.0, 2.0], scale=1e-3).values.tolist() == [0.001, 0.002, 0.003]


def test_bins_count_as_often_as_they_say() -> None:
    """98 values of 10 and 2 of 500: p50 10, p99 500, as of the hundred values one by one."""
    bins, values = Distribution.of_bins([(10, 98), (500, 2)]), Distribution.of([10.0] * 98 + [500.0] * 2)
    for q in (0.01, 0.5, 0.98, 0.99, 1.0):
        assert bins.quantile(q) == values.quantile(q)
    assert bins.quantile(0.99) == 500.0
    both = Distribution.together([bins, Distribution.of([20.0] * 100)])
    assert both.values.tolist() == sorted(both.values.tolist())
    assert both.counts.sum() == 200
    assert (both.quantile(0.49), both.quantile(0.5)) == (10.0, 20.0)


def test_figures_are_medians_over_rounds() -> None:
    rounds = [Distribution.of(np.arange(1, 101) * scale) for scale in (1.0, 10.0, 2.0)]
    assert RoundFigures.of(rounds) == RoundFigures(1.0, 100.0, 198.0)
    assert RoundFigures.of(rounds, higher_is_better=True) == RoundFigures(1.0, 100.0, 2.0)


def test_ratios_are_of_the_medians_over_rounds() -> None:
    """p99 of the rounds: 99, 990, 198 and 49.5, 99, 9.9; the median of the rounds' own ratios would be 10."""
    ours = [Distribution.of(np.arange(1, 101) * scale) for scale in (1.0, 10.0, 2.0)]
    bare = [Distribution.of(np.arange(1, 101) * scale) for scale in (0.5, 1.0, 0.1)]
    found = Row("a_row", "us", "something", ours, "something bare", bare)
    assert (found.ratio, found.ratio_p99) == pytest.approx((100.0 / 25.0, 198.0 / 49.5))


def measured(**more: object) -> Row:
    limits = (Limit("ratio", 2.5), Limit("ratio_p99", 1.5), Limit("median", 100.0, at_least=True), Limit("excess", 0.1))
    bare = [Distribution.of(np.arange(1, 101) * 0.5)]
    return Row("a_row", "us", "something", [HUNDRED], "something bare", bare, more={"excess": 0.2}, limits=limits)


def test_limits_are_compared_with_the_figure_they_name() -> None:
    found = {str(limit): met for limit, met in measured().verdicts()}
    assert found == {"ratio ≤ 2.5": True, "ratio_p99 ≤ 1.5": False, "median ≥ 100": False, "excess ≤ 0.1": False}


def test_json_has_the_keys_that_stay() -> None:
    value = json.loads(json.dumps(measured().as_dict(), allow_nan=False))
    assert {"name", "unit", "median", "p99", "reference", "ratio", "ratio_p99"} <= set(value)
    assert (value["median"], value["p99"], value["ratio"], value["ratio_p99"]) == (50.0, 99.0, 2.0, 2.0)
    assert (value["reference"]["median"], value["reference"]["p99"]) == (25.0, 49.5)
    assert value["allowed"][0] == {"limit": "ratio ≤ 2.5", "met": True}


def test_what_is_not_available_is_null_and_says_why() -> None:
    absent = Row("batch", "1/s", "many", note="not available here", limits=(Limit("median", 1.0),))
    value = absent.as_dict()
    assert [value[key] for key in ("median", "p99", "reference", "ratio", "ratio_p99")] == [None] * 5
    assert value["note"] == "not available here"
    assert not absent.verdicts()
    assert not report.has_histogram(absent)
    alone = Row("alone", "us", "no reference", [HUNDRED])
    assert (alone.reference, alone.ratio) == (None, None)


def test_rows_are_selected_by_name_and_pattern() -> None:
    assert set(ROWS) >= REQUIRED
    assert select(()) == ROWS
    assert list(select(["codec_position", "device_*"])) == ["device_tick", "codec_position"]
    assert "pspm_update_3dof" in select(["pspm_*"])
    with pytest.raises(InvalidParameter, match=r"nosuch.*servo_idle"):
        select(["device_tick", "nosuch"])


def test_table_marks_what_is_missed() -> None:
    from rich.console import Console

    console = Console(width=160, record=True, quiet=False, file=None, force_terminal=False)
    with console.capture() as captured:
        console.print(report.table([measured(), Row("absent", "us", "x", note="not available")]))
    text = captured.get()
    assert "ratio ≤ 2.5 ok" in text
    assert "ratio_p99 ≤ 1.5 MISSED" in text
    assert "absent: not available" in text


def test_figure_has_a_panel_for_every_row_with_values() -> None:
    few = Row("few", "x", "too few", [Distribution.of([1.0, 2.0])])
    zeros = Row("zeros", "us", "zeros too", [Distribution.of([0.0] * 60 + [5.0])])
    fig = report.figure([measured(), few, Row("absent", "us", "x"), zeros])
    visible = [axes for axes in fig.axes if axes.get_visible()]
    assert [axes.get_xlabel() for axes in visible] == ["a_row [us]", "zeros [us]"]
    assert all(axes.get_xscale() == "log" for axes in visible)
    fig.canvas.draw()


def test_figure_marks_the_figures_of_the_table() -> None:
    """Medians over three rounds are 100 and 198, and not the quantiles of all values together."""
    rounds = [Distribution.of(np.arange(1, 101) * scale) for scale in (1.0, 10.0, 2.0)]
    (panel,) = report.figure([Row("a_row", "us", "something", rounds)]).axes
    assert [np.asarray(line.get_xdata())[0] for line in panel.lines] == [100.0, 198.0]


def test_histogram_holds_every_value() -> None:
    (panel,) = report.figure([Row("a_row", "us", "something", [HUNDRED])]).axes
    shares = [patch.get_data().values for patch in panel.patches if isinstance(patch, StepPatch)]
    assert shares
    assert all(math.isclose(share.sum(), 1.0) for share in shares)
