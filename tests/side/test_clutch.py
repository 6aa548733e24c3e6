"""The clutch: the device moves alone, and is coupled again from where it then is."""

import numpy as np
import pytest

from hapnet import simulate
from hapnet.errors import InvalidParameter
from hapnet.mechanics.frame import Frame
from hapnet.mechanics.pose import rotation_vectors
from hapnet.side.clutch import ALLOWED, Clutch, button, spans
from tests.conftest import mostly_slow


def test_while_it_is_open_the_coupled_position_stands_still() -> None:
    opened = {2, 3, 4}
    clutch = Clutch(Frame(1.0, 1.0, (0.0,)), lambda t: round(t) in opened)
    path = [0.0, 0.01, 0.02, 0.05, 0.09, 0.10, 0.12]  # it opens with the reading at 0.02, and closes with that at 0.10
    seen = [clutch.move(float(t), (x,), (1.0,), (0.0,)) for t, x in enumerate(path)]
    assert [x for (x,), _ in seen] == pytest.approx([0.0, 0.01, 0.02, 0.02, 0.02, 0.02, 0.04])
    assert [v for _, (v,) in seen] == [1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0]
    assert clutch.frame.offset == pytest.approx((0.08,))


def test_as_long_as_a_force_is_held_the_motion_counts() -> None:
    """The actuator goes on for two readings after the clutch has opened."""
    clutch = Clutch(Frame(1.0, 1.0, (0.0,)), lambda t: t > 0.5)
    forces = [1.0, 1.0, 0.6, 0.2, 0.0, 0.0]
    seen = [clutch.move(float(t), (0.01 * t,), (1.0,), (force,))[0][0] for t, force in enumerate(forces)]
    assert seen == pytest.approx([0.0, 0.01, 0.02, 0.03, 0.03, 0.03])


def test_between_two_ticks_the_coupling_has_the_device_where_the_next_tick_will() -> None:
    """A servo that is late follows the device tick by tick, whether the clutch is open and whether a force is held."""
    clutch = Clutch(Frame(1.0, 1.0, (0.0,)), lambda t: 0.5 < t < 4.5)
    for t, (x, force) in enumerate(((0.0, 1.0), (0.01, 0.5), (0.02, 0.0), (0.05, 0.0), (0.09, 0.0), (0.1, 0.0))):
        before = clutch.place((x,), (force,))
        assert before == clutch.move(float(t), (x,), (1.0,), (force,))[0]
    assert before == pytest.approx((0.01,))  # where it was when the force had gone
    assert clutch.place((0.13,), (0.0,)) == pytest.approx((0.04,))


@pytest.mark.parametrize("rendering", mostly_slow(["paper", "hapnet"], 1))
def test_the_follower_rests_and_nothing_jumps(rendering: str) -> None:
    params = {
        "follower.robot": "simulated", "scene": "free", "operator": "sine", "operator_model.amplitude_m": 0.06,
        "rendering": rendering, "device.servo": "sampled", "duration_s": 3.0, "device.clutch": "1-2.2",
        "link.up": "delay 40ms", "link.down": "delay 40ms", "record_hz": 1000.0,
    }  # fmt: skip
    result = simulate(params, 1)
    device, world = result.recording.device, result.recording.world
    since = device["time_s"]
    alone = (since > 1.0) & (since < 2.1)  # its times count from its own start, a little before the run's
    assert np.ptp(device["position_m"][alone]) == 0.0
    assert np.abs(device["force_N"][alone]).max() == 0.0
    assert np.abs(np.diff(device["force_N"], axis=0)[since[1:] > 0.97]).max() <= 0.5 + 1e-9
    later = world["time_s"]
    rests = (later > 1.6) & (later < 2.1)  # once what was on the way has come
    assert np.ptp(world["position_m"][rests]) < 1e-3
    hand = device["operator_target_m"][since > 2.3]
    assert np.abs(hand - device["position_m"][since > 2.3]).max() < 0.06  # in the coupling's frame too
    assert result.summary["verdict"]["passive"]


@pytest.mark.slow
def test_a_tool_rests_while_the_hand_turns_without_it() -> None:
    params = {
        "follower.robot": "simulated", "scene": "tool:box", "operator": "hand-23", "device.clutch": "0.6-1.2",
        "duration_s": 2.0, "link.up": "delay 20ms", "link.down": "delay 20ms", "record_hz": 1000.0,
    }  # fmt: skip
    result = simulate(params, 1)
    device, world = result.recording.device, result.recording.world
    since = device["time_s"]  # from its own start, a little before the run's
    alone = (since > 0.6) & (since < 1.17)
    assert np.ptp(device["position_m"][alone], axis=0).max() < 1e-15
    assert np.abs(device["force_N"][alone]).max() == 0.0
    assert np.linalg.norm(np.diff(device["force_N"], axis=0), axis=1)[since[1:] > 0.5].max() <= 0.5 + 1e-9
    rests = (world["time_s"] > 0.9) & (world["time_s"] < 1.15)
    assert np.ptp(world["position_m"][rests], axis=0).max() < 1e-3
    hand, handle = rotation_vectors(device["operator_target_m"]), rotation_vectors(device["position_m"])
    apart = np.linalg.norm(hand - handle, axis=-1)
    assert apart[since > 1.3].max() > 2.0 * apart[since < 0.55].max()  # what it turned alone is left
    assert result.summary["verdict"]["passive"]


def test_texts_of_a_clutch() -> None:
    assert spans("device.clutch", "0-3, 5-6.5", ALLOWED) == [(0.0, 3.0), (5.0, 6.5)]
    assert button("button 1") == 1
    assert button("1-2") is None
    for wrong in ("3-2", "2-2", "-1-2", "x", "1", "nan-2", "1-inf"):
        with pytest.raises(InvalidParameter):
            spans("device.clutch", wrong, ALLOWED)
    with pytest.raises(InvalidParameter):
        simulate({"device.clutch": "button 0"})
    with pytest.raises(InvalidParameter):
        simulate({"device.clutch": "1-2", "device.servo": "continuous", "rendering": "paper"})
