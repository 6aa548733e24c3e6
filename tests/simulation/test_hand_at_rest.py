"""Hands that start from rest, and hands that hold still at the end."""

from pathlib import Path

import numpy as np
import pytest

from hapnet.assembly.operators import operator
from hapnet.params import Params
from hapnet.plant.operator import Followed, HeldAtEnd, Impedance, Sine
from hapnet.plant.worlds.registry import make_scene
from hapnet.recording.mcap import save
from hapnet.simulation.replay import read_original
from hapnet.simulation.simulation import simulate

HAND = Impedance()


@pytest.mark.parametrize("axes", [1, 2])
def test_a_sine_that_starts_from_rest(axes: int) -> None:
    """Speed and acceleration are zero at first; Flash and Hogan's share of the sine then, and the sine itself later."""
    plain, grown = Sine(axes, HAND), Sine(axes, HAND, start_s=1.0)
    assert grown.reference(0.0) == (0.0,) * axes
    h = 1e-3
    early = np.array([grown.reference(k * h) for k in range(3)])
    assert np.abs(np.diff(early, axis=0)).max() / h < 1e-4  # m/s; the plain sine has 0.09
    assert np.abs(np.diff(early, 2, axis=0)).max() / h**2 < 0.1  # m/s^2
    share = 10.0 * 0.25**3 - 15.0 * 0.25**4 + 6.0 * 0.25**5
    assert grown.reference(0.25) == pytest.approx(share * np.array(plain.reference(0.25)))
    for t in (1.0, 1.3, 7.7):
        assert grown.reference(t) == plain.reference(t)


def test_the_sine_of_the_parameters_grows_over_half_a_period() -> None:
    params = Params().set({"operator": "sine", "operator_model.frequency_hz": 2.0})
    for periods, grown_s in ((None, 0.25), (1.5, 0.75)):
        given = params if periods is None else params.set({"operator_model.start_periods": periods})
        hand = operator(given, make_scene("wall"))
        wanted = Sine(1, HAND, frequency=2.0, start_s=grown_s)
        for t in (0.0, 0.1, 0.24, 0.5, 3.0):
            assert hand.reference(t) == wanted.reference(t)
    old = operator(params.set({"operator_model.start_periods": 0.0}), make_scene("wall"))
    assert old.reference(0.1) == Sine(1, HAND, frequency=2.0).reference(0.1)
    assert operator(params.set({"operator_model.frequency_hz": 0.0}), make_scene("wall")).reference(1.0) == (0.0,)


@pytest.mark.parametrize(("name", "rests"), [("sine", 0.0), ("press", 0.04)])
def test_a_hand_that_holds_still_at_the_end(name: str, rests: float) -> None:
    """For the last 3 s of 10 s: in free space after a sine, at its goal after a press; the same motion before that."""
    params = Params().set({"operator": name, "duration_s": 10.0})
    plain = operator(params, make_scene("wall"))
    held = operator(params.set({"operator_model.end_hold_s": 3.0}), make_scene("wall"))
    grid = np.arange(0.0, 10.0, 0.001).tolist()
    path = np.array([held.reference(t)[0] for t in grid])
    before = [k for k, t in enumerate(grid) if t <= 6.0]
    assert path[before].tolist() == [plain.reference(t)[0] for t in grid if t <= 6.0]
    assert np.all(path[7000:] == rests)
    assert np.abs(np.diff(path)).max() < 1.3e-4  # 0.13 m/s: no jump
    short = operator(params.set({"operator_model.end_hold_s": 3.0, "duration_s": 6.9}), make_scene("wall"))
    assert short.reference(6.8) == plain.reference(6.8)


def test_a_recorded_hand_stops_where_it_is() -> None:
    moving = Followed(np.linspace(0.0, 9.0, 10), np.linspace(0.0, 0.09, 10)[:, None], HAND)
    held = HeldAtEnd(moving, 4.0, 1.0)
    assert held.impedance is HAND
    assert held.reference(3.5) == moving.reference(3.5)
    assert held.reference(4.5)[0] == pytest.approx(0.5 * (0.04 + 0.045))
    assert held.reference(5.0) == held.reference(8.0) == pytest.approx((0.04,))


def test_a_recording_from_before_is_replayed_with_the_sine_that_it_had(tmp_path: Path) -> None:
    """It has no start_periods among its parameters: its sine was full from the start."""
    params = Params().set({"operator": "sine", "duration_s": 0.2, "operator_model.start_periods": 0.0})
    recording = simulate(params, 1).recording
    del recording.meta["params"]["operator_model"]["start_periods"]
    save(recording, tmp_path / "old.mcap")
    assert read_original([tmp_path / "old.mcap"]).params.operator_model.start_periods == 0.0
    now = simulate(params.set({"operator_model.start_periods": 0.7}), 1).recording
    save(now, tmp_path / "new.mcap")
    assert read_original([tmp_path / "new.mcap"]).params.operator_model.start_periods == 0.7


def test_a_recorded_motion_is_not_brought_to_rest_twice(tmp_path: Path) -> None:
    """The hand's class is gone, so its recorded motion is followed: with the end that it had."""
    params = Params().set({"operator": "tests.assembly.test_user_operator:Circle", "duration_s": 2.0})
    recording = simulate(params.set({"operator_model.end_hold_s": 0.3}), 1).recording
    recording.meta["params"]["operator"] = "tests.assembly.test_user_operator:Gone"
    save(recording, tmp_path / "run.mcap")
    again = read_original([tmp_path / "run.mcap"]).params
    assert again.operator.endswith("run.mcap")
    assert again.operator_model.end_hold_s == 0.0
