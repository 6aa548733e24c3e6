"""How stiff a wall is felt: the formula against a simulated hand that presses, and everywhere it is said."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from examples.own_law import Mine
from hapnet import CouplingSpec, ForceWorld, cli
from hapnet.assembly.build import prepare
from hapnet.couplings.stiffness import through
from hapnet.params import Params
from hapnet.recording.mcap import read_recording, save
from hapnet.simulation.simulation import simulate
from hapnet.summary.recorded import from_recording
from hapnet.summary.run import combine, merge
from hapnet.summary.tables import felt_line
from hapnet.summary.words import felt
from tests.conftest import mostly_slow
from tests.support.commands import Capture

POSITIVE = st.floats(0.1, 1e6)
PRESSED: dict[str, object] = {
    "link.up": "", "link.down": "", "world.step_min_s": 0.001, "world.step_max_s": 0.001, "duration_s": 4.0,
    "operator_model.hold_s": 5.0,
}  # fmt: skip
"""Without a link, and held until the end."""


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"device.stiffness": 60.0, "world.stiffness": 900.0, "world.wall.stiffness": 700.0},
        {"coupling": "pd", "world.wall.stiffness": 300.0},
    ],
    ids=str,
)
def test_what_is_said_is_what_a_hand_that_holds_still_feels(changes: dict[str, object]) -> None:
    params = Params().set({**PRESSED, **changes})
    result = simulate(params, 1)
    device = result.recording.device
    last = device["time_s"] > 3.5
    depth = float(np.mean(device["position_m"][last, 0])) - params.world.wall.position_m
    rendered = -float(np.mean(device["force_N"][last, 0])) / depth
    assert result.summary["environment"]["felt_stiffness_N_m"] == pytest.approx(rendered, rel=0.02)


@given(POSITIVE, POSITIVE, POSITIVE)
def test_no_wall_is_felt_stiffer_than_the_devices_spring(K: float, K_world: float, wall: float) -> None:
    """And a hard wall is felt as K."""
    assert 0.0 < through((K, K_world), wall) <= K
    assert through((K, K_world), wall) == pytest.approx(1.0 / (1.0 / K + K_world / (K * wall)))
    assert through((K, K_world), 1e6 * K_world) == pytest.approx(K, rel=1e-5)
    assert through((K,), wall) == pytest.approx(1.0 / (1.0 / K + 1.0 / wall))


@pytest.mark.parametrize(
    ("changes", "wall", "springs"),
    [
        ({"device.stiffness": 400.0}, 3000.0, [400.0, 500.0]),
        ({"scene": "box", "world.wall.stiffness": 50.0}, 50.0, [550.0, 500.0]),
        ({"scene": "moving"}, 3000.0, [600.0, 500.0]),
        ({"scene": "sphere"}, 3000.0, [600.0, 500.0]),
        ({"scene": "sphere", "rendering": "paper"}, 3000.0, [100.0, 500.0]),
        ({"coupling": "pd", "link.up": "", "link.down": ""}, 3000.0, [100.0]),
        ({"coupling": "pd", "pd.stiffness": 10.0}, 3000.0, [10.0]),
        ({"coupling": "tdpa", "tdpa.stiffness": 70.0}, 3000.0, [70.0]),
        ({"coupling": "wave", "wave.stiffness": 70.0}, 3000.0, None),  # in series with the line
        ({"scene": "free"}, None, None),
        ({"scene": "examples.planet:planet"}, None, None),
        ({"scene": "box", "dof": 2, "device.stiffness": (100.0, 120.0)}, 3000.0, None),
    ],
    ids=str,
)
def test_of_what_is_felt_of_which_scene(
    changes: dict[str, object], wall: float | None, springs: list[float] | None
) -> None:
    reported = prepare(Params().set(changes)).felt
    assert (reported["stiffness_N_m"], reported["springs_N_m"]) == (wall, springs)
    assert (reported["felt_stiffness_N_m"] is None) == (springs is None)


def one_side(role: str, felt: Any) -> Any:
    return combine(None, None, {"up": None, "down": None}, seed=1, duration_s=1.0, coupling="pspm", felt=felt)


def test_of_two_processes_the_device_knows_its_spring_and_the_world_its_wall() -> None:
    """What each was started with may differ."""
    device = one_side("device", {"stiffness_N_m": 3000.0, "felt_stiffness_N_m": 1.0, "springs_N_m": [200.0, 500.0]})
    world = one_side("world", {"stiffness_N_m": 900.0, "felt_stiffness_N_m": 1.0, "springs_N_m": [100.0, 300.0]})
    environment = merge(device, world)["environment"]
    assert environment["stiffness_N_m"] == 900.0
    assert environment["springs_N_m"] == [200.0, 300.0]
    assert environment["felt_stiffness_N_m"] == pytest.approx(200.0 * 900.0 / 1200.0)
    old = merge(one_side("device", None), world)["environment"]
    assert old["springs_N_m"] == [100.0, 300.0]


@pytest.mark.parametrize(
    "felt", [None, {}, {"stiffness_N_m": "hard"}, {"stiffness_N_m": 0.0, "springs_N_m": [0.0, 0.0]},
             {"stiffness_N_m": 3000.0, "springs_N_m": "100"}, {"stiffness_N_m": -1.0, "springs_N_m": [None, {}]}]
)  # fmt: skip
def test_of_a_file_that_says_anything_nothing_is_believed(felt: Any) -> None:
    assert one_side("device", felt)["environment"]["felt_stiffness_N_m"] is None


def test_a_torn_recording_still_says_it(tmp_path: Any) -> None:
    recording = simulate(Params().set({"duration_s": 0.3}), 1).recording
    save(recording, tmp_path / "run.mcap")
    reported = from_recording(read_recording(tmp_path / "run.mcap"))["environment"]
    assert reported["felt_stiffness_N_m"] == pytest.approx(600.0 * 3000.0 / 3500.0)


def test_in_words() -> None:
    reported = {"stiffness_N_m": 3000.0, "felt_stiffness_N_m": 85.7142, "springs_N_m": [100.0, 500.0]}
    assert felt(reported) == "3000 N/m, felt as 85.71 N/m through springs of 100 and 500 N/m"
    assert felt(reported, springs=False) == "3000 N/m, felt as 85.71 N/m"
    assert felt(reported | {"springs_N_m": [100.0]}) == "3000 N/m, felt as 85.71 N/m through a spring of 100 N/m"
    assert felt(reported | {"springs_N_m": None}) == "3000 N/m, felt as 85.71 N/m"
    for nothing in (None, 3, {}, reported | {"felt_stiffness_N_m": None}, reported | {"stiffness_N_m": "hard"}):
        assert felt(nothing) is None


def test_a_run_says_it_once_and_one_without_walls_does_not(capsys: Capture) -> None:
    short = ["--duration", "0.3", "--no-files"]
    assert cli.main(["simulate", *short, "-v"]) == 0
    assert capsys.readouterr().out.count("wall: 3000 N/m, felt as 514.3 N/m through springs of 600 and 500 N/m\n") == 1
    assert cli.main(["simulate", *short, "--scene", "free"]) == 0
    assert "felt" not in capsys.readouterr().out
    assert cli.main(["simulate", *short, "-v"]) == 0
    table = capsys.readouterr().out
    assert "felt stiffness of the wall [N/m]" in table
    assert cli.main(["simulate", *short, "--json", "-"]) == 0
    environment = json.loads(capsys.readouterr().out)["environment"]
    assert environment["stiffness_N_m"] == 3000.0
    assert environment["felt_stiffness_N_m"] == pytest.approx(600.0 * 3000.0 / 3500.0)


SILENT = replace(Mine, springs=CouplingSpec.springs)
"""A law that does not say which springs it has."""


def test_a_law_of_the_users_own_says_its_springs_or_nothing_is_claimed() -> None:
    """device.stiffness may be no part of it."""
    link = {"link.up": "", "link.down": "", "mine.stiffness": 10.0}
    own = prepare(Params().set({"coupling": "examples.own_law:Mine", **link})).felt
    assert own["springs_N_m"] == [10.0]
    assert own["felt_stiffness_N_m"] == pytest.approx(1.0 / (1.0 / 10.0 + 1.0 / 3000.0))
    silent = prepare(Params().set({"coupling": f"{__name__}:SILENT"})).felt
    assert silent == {
        "stiffness_N_m": 3000.0,
        "felt_stiffness_N_m": None,
        "springs_N_m": None,
        "local_limit_N_m": 600.0,
    }


def pushing(*, dof: int = 1) -> ForceWorld:
    """2 N from 1 s on, without energy to give."""
    return ForceWorld(lambda x, v, t: (2.0 if t > 1.0 else 0.0,), dof=dof)


def pushing_with_energy(*, dof: int = 1) -> ForceWorld:
    return ForceWorld(lambda x, v, t: (2.0 if t > 1.0 else 0.0,), dof=dof, energy_J=0.1)


@pytest.mark.parametrize(("scene", "said"), mostly_slow([(pushing, True), (pushing_with_energy, False)], 1))
def test_the_last_line_says_that_a_force_which_pushes_was_held_back(scene: Any, said: bool) -> None:
    result = simulate({"scene": f"{__name__}:{scene.__name__}", "duration_s": 3.0}, 1)
    assert ((result.summary["environment"]["env_given_J"] or 0.0) > 1e-3) == said
    assert ("of their own, and were held back." in felt_line(result.summary)) == said
