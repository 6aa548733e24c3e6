"""The stiffest stable spring of a device, against the eigenvalues of a sampled mass and Colgate's bound."""

import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from hapnet import cli
from hapnet.errors import InvalidParameter
from hapnet.ext.metrics.impedance import ImpedanceAtFrequency
from hapnet.ext.study import stable_stiffness
from hapnet.ext.study.impedance import Transmission
from hapnet.ext.study.stable_stiffness import StiffnessCase, ZWidth, bound, cases, stable, stiffest
from hapnet.ext.study.transparency import SearchTask
from hapnet.params import Params
from hapnet.processes import pool
from tests.conftest import mostly_slow
from tests.support.paper import PAPER

MASS_KG, HAND_N_M = 0.045, 135.0
HELD = PAPER.set({"coupling": "zoh"})
"""The plain spring, whose only damper is B."""


def radius(K: float, B: float, b: float, hz: float) -> float:
    """By how much a mass swings more after a tick: m x'' = -b x' - K_h x + u, with u = -K x - B x' held for the tick.

    The state is (x, x', u). Over a tick it is multiplied by the exponential of the matrix below, and then u is new.
    """
    flow = np.array([[0.0, 1.0, 0.0], [-HAND_N_M / MASS_KG, -b / MASS_KG, 1.0 / MASS_KG], [0.0, 0.0, 0.0]]) / hz
    power, whole = np.eye(3), np.eye(3)
    for order in range(1, 20):
        power = power @ flow / order
        whole = whole + power
    held = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-K, -B, 0.0]])
    return float(np.abs(np.linalg.eigvals(held @ whole)).max())


def crossing(B: float, b: float, hz: float) -> float:
    """The K at which that mass begins to swing for ever [N/m]."""
    low, high = 1.0, 1e6
    while high > 1.0001 * low:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if radius(middle, B, b, hz) < 1.0 else (low, middle)
    return low


def test_the_eigenvalues_cross_where_colgate_says_if_nothing_but_the_spring_is_held() -> None:
    for b, hz in ((0.3, 1000.0), (1.0, 1000.0), (0.3, 4000.0)):
        assert crossing(0.0, b, hz) == pytest.approx(2.0 * b * hz, rel=0.005)
        assert crossing(0.1, b, hz) > bound(b, hz, 0.1) == pytest.approx(2.0 * (b - 0.1) * hz)
    assert bound(0.1, 1000.0, 0.3) == 0.0


@pytest.mark.parametrize("B", [1e-6, 0.1])
def test_a_held_spring_swings_from_where_the_eigenvalues_cross(B: float) -> None:
    """With next to no B that is Colgate's 2 b/T = 600 N/m."""
    K = crossing(B, 0.3, 1000.0)
    device = HELD.set({"device.damping": B})
    assert stable(device.set({"device.stiffness": 0.95 * K}))
    assert not stable(device.set({"device.stiffness": 1.05 * K}))


@pytest.mark.parametrize(("b", "hz"), [(0.3, 1000.0), (1.0, 1000.0), (0.3, 500.0), (0.3, 4000.0)])
@pytest.mark.parametrize("B", mostly_slow([0.1, 1e-6], 0, 1))
def test_the_search_ends_where_the_eigenvalues_cross(B: float, b: float, hz: float) -> None:
    case = StiffnessCase("zoh", hz, b, 0.0)
    found = stiffest(case.of(HELD.set({"device.damping": B})))
    assert found.free < found.cycles <= 1.0301 * found.free
    assert found.free == pytest.approx(crossing(B, b, hz), rel=0.06)


def test_a_wall_that_is_not_rendered_is_not_stable() -> None:
    """Nothing swings where PSPM has nothing left to pay a stiff spring with."""
    assert not stable(PAPER.set({"device.stiffness": 3000.0}))


def test_rates_and_dampings_of_the_parameters_are_searched_too() -> None:
    params = Params().set({"device.servo_hz": 2000.0, "device.own_damping": 0.2})
    found = cases(params)
    assert {case.servo_hz for case in found} == {500.0, 1000.0, 2000.0, 4000.0}
    assert {case.own_damping for case in found} == {0.1, 0.2, 0.3, 1.0}
    assert {(case.coupling, case.resolution_m) for case in found} == {
        (coupling, resolution) for coupling in ("pspm", "zoh") for resolution in (0.0, 55e-6)
    }
    assert len(found) == 4 * 4 * 4
    device = StiffnessCase("zoh", 500.0, 0.2, 55e-6).of(params).device
    assert (device.servo_hz, device.own_damping, device.resolution_m) == (500.0, 0.2, 55e-6)
    with pytest.raises(InvalidParameter, match=r"device\.damping"):
        cases(Params().set({"device.damping": (0.1, 0.2)}))


def test_the_command_shows_them_beside_the_bound_in_table_figure_and_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The searches themselves are replaced: they take seconds, and are tried above."""
    some = [
        StiffnessCase("pspm", 1000.0, 0.3, 0.0),
        StiffnessCase("zoh", 1000.0, 0.3, 55e-6),
        StiffnessCase("zoh", 500.0, 0.05, 0.0),
    ]
    found = {some[0]: ZWidth(750.0, 770.0), some[1]: ZWidth(600.0, None), some[2]: ZWidth(None, 10.0)}
    device = {case: case.of(Params()).device for case in some}
    transmission = Transmission((ImpedanceAtFrequency(1.0, 90.0 + 0.0j, 0.0),), (100.0 + 0.0j,), None)

    def deal(work: object, tasks: Sequence[SearchTask], *_: object) -> list[object]:
        for task in tasks:
            if task.case is not None:
                assert task.case.of(task.params).device == device[task.case]
        return [
            transmission if task.case is None and task.hand is None else found.get(task.case, ZWidth(80.0, 82.0))
            for task in tasks
        ]

    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr(stable_stiffness, "cases", lambda params: some)
    monkeypatch.setattr(pool, "dealt", deal)
    words = ["--coupling", "zoh", "--link", "lan", "--seeds", "0:1", "--z-width", "--workers", "1"]
    assert cli.main(["transparency", *words, "--out", str(tmp_path)]) == 0
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in capsys.readouterr().out.splitlines()]
    assert ["1000", "0.3", "400", "750", "above 600", "-"] in rows
    assert ["500", "0.05", "none", "-", "-", "below 10"] in rows
    reported = json.loads((tmp_path / "transparency.json").read_text("utf-8"))["stable_stiffness"]
    assert reported["searches"][0] == {
        "coupling": "pspm", "servo_hz": 1000.0, "own_damping": 0.3, "resolution_m": 0.0,
        "bound_N_per_m": pytest.approx(400.0), "stable_N_per_m": 750.0, "unstable_N_per_m": 770.0,
    }  # fmt: skip
    assert "oscillates" in reported["judged"]
    assert (tmp_path / "stable-stiffness.png").stat().st_size > 10_000
