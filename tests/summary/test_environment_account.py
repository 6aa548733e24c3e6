"""The environment's own account: from the recorded forces and positions, and what the verdict says of it."""

import math
from typing import Any

import numpy as np
import pytest

from hapnet.checks import Vector
from hapnet.errors import HapnetError
from hapnet.params import Params
from hapnet.plant.worlds.scene import Scene
from hapnet.plant.worlds.walls import Contacts, Wall
from hapnet.recording.samples import Recording
from hapnet.simulation.batch import simulate_batch
from hapnet.simulation.simulation import simulate
from hapnet.summary.run import merge
from hapnet.summary.verdict import judge
from tests.conftest import mostly_slow
from tests.support.theorem_cases import random_case

STIFFNESS, DAMPING, AT = 3000.0, 10.0, 0.02


def put_in(recording: Recording) -> np.ndarray[Any, np.dtype[np.float64]]:
    """The work that the proxy has done on the environment by the end of each step [J]."""
    world = recording.world
    start = np.zeros((1, world["position_m"].shape[1]))
    moved = np.diff(np.concatenate([start, world["position_m"]]), axis=0)
    return -np.cumsum(np.einsum("ij,ij->i", world["contact_force_N"], moved))


def stored(recording: Recording) -> np.ndarray[Any, np.dtype[np.float64]]:
    return 0.5 * STIFFNESS * np.maximum(recording.world["position_m"][:, 0] - AT, 0.0) ** 2


def test_a_wall_that_rests_dissipates_what_its_damper_takes() -> None:
    result = simulate(Params().set({"scene": "wall", "duration_s": 6.0, "link.up": "wifi", "link.down": "4g"}), seed=4)
    slack = put_in(result.recording) - stored(result.recording)
    reported = result.summary["environment"]
    assert reported["env_slack_J"] == pytest.approx(slack.min(), abs=1e-12)
    assert reported["env_slack_J"] >= -1e-14
    assert reported["env_stored_J"] == pytest.approx(stored(result.recording)[-1], abs=1e-12)
    assert reported["env_supplied_J"] == 0.0
    assert slack[-1] > 1e-5  # a damper was at work: the account is not idle
    assert stored(result.recording).max() > 5e-4
    hand = result.summary["hand"]["work_J"]
    assert result.summary["verdict"]["reason"].endswith(f"energy came from the hand ({hand * 1e3:.4g} mJ)")


@pytest.mark.parametrize("index", mostly_slow(range(6), 1))
def test_flat_walls_give_nothing_over_any_link(index: int) -> None:
    params = random_case(index).set({"duration_s": 3.0})
    slack = simulate(params, index).summary["environment"]["env_slack_J"]
    assert -1e-14 <= slack <= 0.1


def test_what_moves_a_wall_is_counted_and_told() -> None:
    """A wall comes by 5 mm and goes back: S is what a spring of the same depth takes, at these two instants."""
    words = "at 2s: shift -5mm; at 3s: shift 5mm"
    changes = {"scene": "moving", "world.wall.timeline": words, "world.wall.damping": 0.0, "duration_s": 5.0}
    result = simulate(Params().set(changes), seed=3)
    world = result.recording.world
    reported = result.summary["environment"]
    x, t = world["position_m"][:, 0], np.cumsum(world["step_s"])
    supplied = 0.0
    for at_s, before, after in ((2.0, AT, AT - 0.005), (3.0, AT - 0.005, AT)):
        there = x[np.searchsorted(t, at_s)]
        supplied += 0.5 * STIFFNESS * (max(there - after, 0.0) ** 2 - max(there - before, 0.0) ** 2)
    assert reported["env_supplied_J"] == pytest.approx(supplied, abs=1e-12)
    assert abs(supplied) > 1e-4
    assert reported["env_slack_J"] == pytest.approx(0.0, abs=1e-12)  # springs only: all that was put in is there


def test_in_a_batch_each_seed_has_a_world_of_its_own() -> None:
    """A wall that moves has a state: with one for all seeds, the second run would begin where the first ended."""
    words = "at 0.5s: shift -5mm; at 1s: shift 5mm"
    params = Params().set({"scene": "moving", "world.wall.timeline": words, "duration_s": 1.5})
    alone = [simulate(params, seed).summary["environment"] for seed in (0, 1)]
    assert alone[1]["env_supplied_J"] != 0.0
    assert [run.summary["environment"] for run in simulate_batch(params, (0, 1))] == alone


class Pump(Contacts):
    """A wall that pushes twice as hard as its spring explains: an active environment."""

    def solve(self, *arguments: Any) -> Any:
        force, _ = super().solve(*arguments)
        _, _, velocity, inverse = arguments
        more = [2.0 * f for f in force]
        return more, [v + r for v, r in zip(velocity, inverse(tuple(more)), strict=True)]


def pump(*, dof: int = 1) -> Scene:
    scene = Scene("pump", dof, (Wall((1.0,), AT, STIFFNESS),))
    object.__setattr__(scene, "contacts", Pump(scene.walls))
    return scene


def test_a_world_that_gives_energy_is_told_from_the_coupling_which_stays_passive() -> None:
    result = simulate(Params().set({"scene": f"{__name__}:pump", "duration_s": 4.0}), seed=1)
    reported = result.summary["environment"]
    slack = put_in(result.recording) - stored(result.recording)
    assert reported["env_slack_J"] == pytest.approx(slack.min(), abs=1e-12)
    assert slack.min() < -1e-3
    verdict = result.summary["verdict"]
    assert verdict["passive"] is True
    assert f"energy came from the world itself ({-slack.min() * 1e3:.4g} mJ)" in verdict["reason"]


def test_of_two_processes_the_world_tells_it_and_an_older_file_tells_nothing() -> None:
    whole = simulate(Params().set({"duration_s": 1.0}), seed=2).summary
    device: Any = {**whole, "world": None}
    world: Any = {**whole, "device": None}
    assert merge(device, world)["environment"] == whole["environment"]
    older: Any = {**whole, "world": {name: of for name, of in whole["world"].items() if name != "environment"}}
    found = merge(device, older)
    assert found["environment"]["env_slack_J"] is None
    assert "energy came" not in judge(found)["reason"]


class Forgetful:
    """A world whose own energy is no number for a while."""

    supplied_J = 0.0

    def __init__(self, *, dof: int = 1) -> None:
        self.dof, self._steps = dof, 0

    @property
    def stored_J(self) -> float:
        return math.nan if 20 < self._steps < 40 else 0.0

    def step(self, dt: float, position: Vector, velocity: Vector) -> Vector:
        self._steps += 1
        return (0.0,) * self.dof


def test_a_world_whose_energy_is_no_number_ends_the_run_with_one_line() -> None:
    with pytest.raises(HapnetError, match="the scene Forgetful failed: its stored_J is nan, not a finite number"):
        simulate({"scene": f"{__name__}:Forgetful", "duration_s": 3.0}, seed=1)
