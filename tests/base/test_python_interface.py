"""What somebody meets who types: names, wrong arguments, short words for long objects, tables and figures."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hapnet
from hapnet import InvalidParameter, Params, read_recording, simulate
from hapnet.params import LinkParams
from hapnet.recording.mcap import save
from hapnet.simulation.result import Result


@pytest.fixture(scope="module")
def result() -> Result:
    return simulate(Params().set({"duration_s": 2.0, "scene": "box", "dof": 2}), seed=3, kernel=False)


def test_every_public_name_is_offered_and_explained() -> None:
    assert set(hapnet.__all__) <= set(dir(hapnet))
    assert not {name for name in dir(hapnet) if not name.startswith("__")} - set(hapnet.__all__)
    for name in hapnet.__all__:
        assert getattr(hapnet, name).__doc__, name


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: Params(link="4g"), r'^link is .4g.; allowed: a LinkParams, or .*set\(\{"link.up": \.\.\.\}\)'),
        (lambda: Params(world=LinkParams()), "^world is LinkParams"),
        (lambda: simulate("4g"), r"^params is .4g.; allowed: a Params, or changes such as"),
        (lambda: simulate(seed=-1), "^seed is -1; allowed: a whole number, 0 or above"),
        (lambda: simulate(seed=0.5), "^seed is 0.5"),
        (lambda: Params().set({"linkk.up": "4g"}), "link.up"),
        (lambda: Params(duration_s="x"), "^duration_s is 'x'; allowed: a number"),
        (lambda: Params(1), "^scene is 1; allowed: a text"),
        (lambda: Params().set("x"), "^changes is 'x'; allowed: names and values"),
        (lambda: hapnet.prepare("4g"), "^params is '4g'"),
        (lambda: hapnet.prepare(None), "^params is None"),
        (lambda: hapnet.simulate_batch(["4g"], seeds=[1]), "^params is '4g'"),
        (lambda: hapnet.simulate_batch("4g"), "^params is '4g'"),
        (lambda: hapnet.simulate_batch(3), "^params is 3"),
        (lambda: hapnet.simulate_batch([None]), "^params is None"),
        (lambda: hapnet.simulate_batch(Params(), seeds=3), "^seeds is 3; allowed: whole numbers"),
        (lambda: hapnet.simulate_batch([Params()], seeds=[-1]), "^seeds is -1"),
        (lambda: read_recording(3), "^path is 3; allowed: a recording's file"),
    ],
)
def test_a_wrong_argument_is_named_with_what_is_allowed(call: Any, says: str) -> None:
    with pytest.raises(InvalidParameter, match=says):
        call()


def test_changes_to_the_defaults_do_for_parameters() -> None:
    changes: dict[str, object] = {"duration_s": 0.3, "link.up": "4g", "scene": "box"}
    whole = simulate(Params().set(changes), seed=2)
    assert simulate(changes, seed=2).summary == whole.summary
    assert hapnet.prepare(changes).params == hapnet.prepare(Params().set(changes)).params
    for several in (changes, [changes], [Params().set(changes)]):
        (run,) = hapnet.simulate_batch(several, seeds=[2])
        assert run.summary == whole.summary
    with pytest.raises(InvalidParameter, match=r"link\.up"):
        simulate({"linkk.up": "4g"})


def test_parameters_show_what_differs_from_the_defaults() -> None:
    assert repr(Params()) == "Params()"
    params = Params().set({"link.up": "4g", "device.stiffness": (100.0, 50.0)})
    assert repr(params) == "Params().set({'device.stiffness': (100.0, 50.0), 'link.up': '4g'})"
    assert eval(repr(params)) == params


def test_a_result_is_one_line(result: Result) -> None:
    assert repr(result).startswith("Result(PASSIVE: gave out at most ")
    assert "seed 3, 2" in repr(result)
    assert "Recording(device " in repr(result)
    assert "\n" not in repr(result)
    assert len(repr(result)) < 300


def test_a_result_draws_itself(result: Result, tmp_path: Path) -> None:
    result.plot().savefig(tmp_path / "run.png")
    assert (tmp_path / "run.png").stat().st_size > 20_000


def test_from_a_file_to_a_table_in_three_lines(result: Result, tmp_path: Path) -> None:
    pytest.importorskip("pandas", reason="the extra pandas is not installed")
    file = tmp_path / "run.mcap"
    save(result.recording, file)
    table = read_recording(file).to_pandas()
    np.testing.assert_array_equal(table["position_m_y"], result.recording.device["position_m"][:, 1])
    np.testing.assert_array_equal(table.index, result.recording.device["time_s"])
    assert table.index.name == "time_s"
    world = result.to_pandas("world")
    assert len(world) == len(result.recording.world["time_s"])
    with pytest.raises(InvalidParameter, match="device or world"):
        result.to_pandas("robot")
