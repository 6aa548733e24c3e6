"""What the force on the device is made of, in recordings of simulated runs."""

import numpy as np
import pytest

from hapnet.params import Params
from hapnet.recording.samples import Columns
from hapnet.simulation.simulation import Simulation, simulate
from tests.conftest import mostly_slow

K, K_WORLD, K_WALL, WALL_M = 600.0, 500.0, 3000.0, 0.02
PARTS = ("spring_force_N", "damper_force_N", "model_force_N", "added_damping_force_N")


def device(**changes: object) -> Columns:
    columns = simulate(Params().set({"duration_s": 2.5, **changes}), 1).recording.device
    assert columns is not None
    return columns


@pytest.mark.parametrize("changes", [
    {}, {"rendering": "paper"}, {"rendering": "paper", "device.servo": "sampled"}, {"coupling": "zoh", "scene": "box"},
])  # fmt: skip
def test_spring_and_damper_are_the_force_and_the_model_a_part_of_the_spring(changes: dict[str, object]) -> None:
    columns = device(**changes)
    spring, damper, model, added = (columns[name] for name in PARTS)
    away = np.abs(spring + damper - columns["force_N"]).max(axis=1)
    assert np.median(away) < 1e-12  # where no limit acts
    stretched = (100.0 if changes.get("rendering") == "paper" else K) * (
        columns["set_position_m"] - columns["position_m"]
    )
    np.testing.assert_allclose(spring, stretched, atol=1e-9)
    if changes.get("rendering") == "paper":
        assert not model.any()
        assert not added.any()
    else:
        assert np.abs(model).max() > 0.5


def test_at_rest_in_a_wall_the_model_makes_the_force_of_springs_in_series() -> None:
    columns = device()
    held = (columns["time_s"] > 1.8) & (columns["time_s"] < 2.3)
    depth = columns["position_m"][held, 0] - WALL_M
    assert depth.min() > 0.002
    expected = -K * depth * K_WALL / (K_WALL + K_WORLD)
    np.testing.assert_allclose(columns["model_force_N"][held, 0], expected, rtol=0.02)
    np.testing.assert_allclose(columns["force_N"][held, 0], expected, rtol=0.02)


def test_a_saturated_spring_has_parts_that_are_not_larger_than_it() -> None:
    columns = device(**{"device.force_limit_N": 0.5})
    assert np.abs(columns["spring_force_N"]).max() == pytest.approx(0.45, rel=1e-6)
    assert np.abs(columns["model_force_N"]).max() <= 0.46


def test_a_law_that_does_not_tell_leaves_them_unknown() -> None:
    columns = device(coupling="wave")
    assert all(np.isnan(columns[name]).all() for name in PARTS)


@pytest.mark.parametrize(
    ("changes", "planes"), mostly_slow([({}, 1), ({"scene": "free"}, 0), ({"rendering": "paper"}, None)], 1)
)
def test_the_wire_half_keeps_the_planes_that_the_device_knows(changes: dict[str, object], planes: int | None) -> None:
    run = Simulation(Params().set({"duration_s": 0.5, **changes}), 1, kernel=False)  # it hands over at each message
    run.run()
    known = run.device_endpoint.planes
    assert (known if known is None else len(known)) == planes
    if known:
        assert known[0][:3] == ((1.0,), WALL_M, K_WALL)
