"""A recorded run again: exactly, through another link or coupling, torn, of one side, and with a hand that is gone."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import signal

from hapnet.errors import InvalidParameter
from hapnet.plant.operator import Followed, Impedance
from hapnet.recording.hand import hand_times
from hapnet.recording.mcap import RecordingWriter, read_recording, save
from hapnet.recording.samples import Recording
from hapnet.simulation.replay import compare, read_original
from hapnet.simulation.simulation import simulate
from tests.conftest import mostly_slow
from tests.plant.arms.test_urdf import ARM
from tests.support.replays import QUICK, here as here, recorded, replayed, rewritten, with_meta, with_params

# Exactly


@pytest.mark.parametrize(
    "changes",
    mostly_slow(
        [
            {},
            {"coupling": "zoh"},
            {"scene": "free", "dof": 2, "operator": "sine"},
            {"scene": "box", "operator": "sine", "device__servo": "sampled", "device__resolution_m": 5.5e-5},
            {"scene": "paper", "operator": "hand.csv", "device__stiffness": (100.0, 100.0, 150.0)},
            {"scene": "free", "operator": "rest", "operator_model__start_m": 0.01},
            {"hardware": "omni", "device__substeps": 1},
            {"operator": "own_hand:Smooth", "link__up_timeline": "at 0.4s: down; at 0.8s: up"},
        ],
        3,
    ),
    ids=lambda changes: "-".join(str(value) for value in changes.values() if isinstance(value, str)) or "default",
)
def test_a_simulated_recording_is_made_again_to_the_last_bit(tmp_path: Path, changes: dict[str, object]) -> None:
    (tmp_path / "hand.csv").write_text("time_s,x_m,y_m,z_m\n0,0,0,0.01\n0.5,0.01,0.01,-0.005\n1,0.02,0,0.01\n", "utf-8")
    first = recorded(tmp_path / "a.mcap", **changes)
    result, compared = replayed(tmp_path / "a.mcap")
    for before, after in (
        (first.recording.device, result.recording.device),
        (first.recording.world, result.recording.world),
    ):
        assert before.keys() == after.keys()
        assert len(before["time_ns"]) > 20
        for name in before:
            np.testing.assert_array_equal(before[name], after[name], err_msg=name)
    assert result.summary == first.summary
    assert compared["identical"] is True
    assert compared["max_position_difference_m"] == compared["rms_position_difference_m"] == 0.0
    assert compared["original"] == compared["replay"]


def test_where_the_hand_wants_to_be_is_recorded(tmp_path: Path) -> None:
    recorded(tmp_path / "a.mcap", operator="own_hand:Smooth")
    recording = read_recording(tmp_path / "a.mcap")
    times = hand_times(recording)
    assert times == pytest.approx(0.005 * np.arange(1, len(times) + 1), abs=1e-12)  # every fifth tick from the first
    expected = 0.01 * (1.0 - np.cos(9.0 * times))
    assert recording.device["operator_target_m"][:, 0] == pytest.approx(expected, abs=1e-15)


# Otherwise


@pytest.mark.parametrize(
    "changes",
    [
        {"coupling": "zoh"},
        {"link__up": "delay 150ms", "link__down": "delay 150ms"},
        {"world__wall__stiffness": 1000.0},
        {"operator_model__stiffness": 300.0},
    ],
    ids=["coupling", "link", "scene", "hand"],
)
def test_with_something_else_it_differs(tmp_path: Path, changes: dict[str, object]) -> None:
    recorded(tmp_path / "a.mcap")
    _, compared = replayed(tmp_path / "a.mcap", **changes)
    assert compared["identical"] is False
    assert compared["max_position_difference_m"] > 1e-5
    assert 0.0 < compared["rms_position_difference_m"] < compared["max_position_difference_m"]


def test_on_a_bad_link_pspm_is_passive_where_the_plain_coupling_was_not(tmp_path: Path) -> None:
    """A bad session, studied again: the hand of a session without PSPM, with it."""
    light: dict[str, object] = {"operator": "sine", "operator_model__frequency_hz": 2.0, "operator_model__damping": 1.0}
    link: dict[str, object] = {"link__up": "delay 150ms", "link__down": "delay 150ms"}
    recorded(tmp_path / "a.mcap", coupling="zoh", duration_s=4.0, **light, **link)
    _, compared = replayed(tmp_path / "a.mcap", coupling="pspm")
    assert compared["original"]["margin_J"] < 0.0 <= compared["replay"]["margin_J"]


@pytest.mark.parametrize("lost", [1, 30_000])
def test_a_torn_recording_is_replayed_as_far_as_it_goes(tmp_path: Path, lost: int) -> None:
    whole = recorded(tmp_path / "whole.mcap", duration_s=3.0).recording
    writer = RecordingWriter(tmp_path / "cut.mcap", whole.meta)
    for sample in whole.samples():
        writer.write(sample)
        writer.flush(sample.time_ns)
    (tmp_path / "torn.mcap").write_bytes((tmp_path / "cut.mcap").read_bytes()[:-lost])  # as of a killed process
    writer.close()
    original = read_original([tmp_path / "torn.mcap"])
    assert original.recording.torn
    assert "is incomplete" in original.incomplete[0]
    result = simulate(original.params, original.seed)
    assert compare(original, result.recording, result.summary)["identical"] is True
    n = len(original.recording.device["time_ns"])
    assert 100 < n < 600
    np.testing.assert_array_equal(
        result.recording.device["time_ns"][:n], original.recording.device["time_ns"], strict=True
    )


# Two sides, as real time records them


def sides(tmp_path: Path, **world: Any) -> tuple[Path, Path]:
    """A device's and a world's recording of one run, each with its own process's settings."""
    recorded(tmp_path / "both.mcap", world__wall__stiffness=2000.0, link__up="delay 20ms", link__down="delay 30ms")
    meta = {"clock": "boot:1", "session": "s"}

    def device(whole: Recording) -> Recording:
        params = {**whole.meta["params"], "link": {**whole.meta["params"]["link"], "down": ""}, "scene": "free"}
        own = with_meta(whole, **meta, role="device", params=params, origin_ns=whole.meta["device_origin_ns"])
        return dataclasses.replace(own, world=None, events=[], summary=None)

    def other(whole: Recording) -> Recording:
        params = {**whole.meta["params"], "link": {**whole.meta["params"]["link"], "up": ""}, "operator": "rest"}
        own = with_meta(whole, **meta, role="world", **{"params": params, **world})
        return dataclasses.replace(own, device=None, events=[], summary=None)

    return (
        rewritten(tmp_path / "both.mcap", device, "device.mcap"),
        rewritten(tmp_path / "both.mcap", other, "world.mcap"),
    )


def test_each_side_says_what_is_its_own(tmp_path: Path) -> None:
    device, world = sides(tmp_path)
    for files in ((device, world), (world, device)):
        original = read_original(files)
        params = original.params
        assert (params.link.up, params.link.down) == ("delay 20ms", "delay 30ms")
        assert (params.scene, params.operator, params.world.wall.stiffness) == ("wall", "press", 2000.0)
        assert params.device.servo == "sampled"  # what "auto" is in real time
        assert original.in_virtual_time is False
        assert "real time" in original.notes[0]
        assert len(original.notes) == 1
    assert original.params.duration_s == pytest.approx(QUICK["duration_s"], abs=0.06)


def test_of_the_device_alone_its_own_word_counts(tmp_path: Path) -> None:
    device, world = sides(tmp_path)
    params = read_original([device]).params
    assert (params.link.up, params.link.down, params.scene) == ("delay 20ms", "", "free")
    result, compared = replayed(device)
    assert compared["identical"] is False  # a sampled servo, and nothing pushes back
    assert compared["original"]["world_margin_J"] is None
    assert result.recording.world is not None
    with pytest.raises(InvalidParameter, match="the world's has no hand"):
        read_original([world])


def test_what_both_sides_said_differently_is_told(tmp_path: Path) -> None:
    device, world = sides(tmp_path, seed=8, coupling="zoh")
    original = read_original([device, world])
    assert original.seed == 5
    assert original.params.coupling == "pspm"
    assert ["world's seed was 8" in note for note in original.notes] == [False, True, False]
    assert "world's coupling was zoh" in original.notes[2]


# A hand that cannot be generated again


def led_live(recording: Recording) -> Recording:
    """As of a hand that somebody led with the mouse: the motion is known at its samples, what made it is not."""
    return with_params(recording, operator="mouse")


def test_a_hand_led_live_is_followed(tmp_path: Path) -> None:
    """The replay's motion keeps to the original's as cubic curves do, and the device as its impedance allows.

    With the links down the device's coupling is a spring to a point: device and hand are linear, and the device's error
    is the motion's, at most, times the integral of the absolute impulse response from the one to the other.
    """
    a, w, h = 0.01, 9.0, 0.005
    link = {"link__up_timeline": "at 0s: down", "link__down_timeline": "at 0s: down", "scene": "free"}
    recorded(tmp_path / "own.mcap", operator="own_hand:Smooth", duration_s=2.0, **link)
    live = rewritten(tmp_path / "own.mcap", led_live, "live.mcap")
    original = read_original([live])
    assert "mouse cannot be generated again" in original.hand
    assert original.params.operator == str(live)
    error = max(
        a * w**2 * h**2 / 2,  # before the first sample it rests, where it should begin to move
        a * w**2 * h**2 / 8,  # from there on the slope is off by h x''/2
        a * w**3 * h**3 / 24 + a * w**4 * h**4 / 384,
    )
    params = original.params
    hand, device = params.operator_model, params.device
    mass, damping = hand.mass + device.mass, hand.damping + device.own_damping + float(str(device.damping))
    stiffness = hand.stiffness + float(str(device.stiffness))
    t, response = signal.impulse(([hand.damping, hand.stiffness], [mass, damping, stiffness]), N=20_000)
    gain = float(np.sum(np.abs(response)) * (t[1] - t[0]))
    assert gain > hand.stiffness / stiffness  # what a step is followed by in the end

    result, compared = replayed(live)
    assert compared["identical"] is False
    assert 0.0 < compared["max_position_difference_m"] <= gain * error
    again = tmp_path / "again.mcap"
    save(result.recording, again)
    second, compared = replayed(again)  # live.mcap is still there
    assert compared["identical"] is True
    live.unlink()
    original = read_original([again])
    assert "has changed or is missing" in original.hand
    assert original.params.operator == str(again)
    _, compared = replayed(again)
    assert compared["max_position_difference_m"] <= 2.0 * gain * error
    assert second.summary["motion"] == result.summary["motion"]


def test_a_file_that_has_changed_is_not_read_again(tmp_path: Path) -> None:
    hand = tmp_path / "hand.csv"
    hand.write_text("time_s,x_m\n0,0\n0.5,0.03\n1,0\n", "utf-8")
    recorded(tmp_path / "a.mcap", operator="hand.csv")
    assert read_original([tmp_path / "a.mcap"]).params.operator == "hand.csv"
    hand.write_text("time_s,x_m\n0,0\n0.5,0.01\n1,0\n", "utf-8")
    original = read_original([tmp_path / "a.mcap"])
    assert original.params.operator == str(tmp_path / "a.mcap")
    assert "hand.csv has changed or is missing" in original.hand
    _, compared = replayed(tmp_path / "a.mcap")
    assert 0.0 < compared["max_position_difference_m"] < 1e-4


def test_of_an_arm_whose_file_has_changed_a_note_says_so(tmp_path: Path) -> None:
    """The replay has the arm of now: its masses are not those of then, and the motion is another."""
    (tmp_path / "arm.urdf").write_text(ARM, "utf-8")
    arm = "arm:arm.urdf?tip=tip&home=0.3,1.2,0.2"
    recorded(tmp_path / "a.mcap", hardware=arm, device__substeps=1, scene="free", operator="sine", duration_s=0.5)
    assert read_original([tmp_path / "a.mcap"]).notes == ()
    assert replayed(tmp_path / "a.mcap")[1]["identical"] is True
    (tmp_path / "arm.urdf").write_text(ARM.replace('mass value="0.5"', 'mass value="0.9"'), "utf-8")
    (note,) = read_original([tmp_path / "a.mcap"]).notes
    assert note.startswith("arm.urdf has changed since")
    assert replayed(tmp_path / "a.mcap")[1]["identical"] is False


def test_of_a_person_with_a_real_device_the_positions_are_followed(tmp_path: Path) -> None:
    recorded(tmp_path / "a.mcap", scene="free", operator="sine")

    def real(recording: Recording) -> Recording:
        unknown = np.full_like(recording.device["position_m"], np.nan)
        held = with_params(recording, hardware="mine:Device")
        return dataclasses.replace(held, device={**recording.device, "operator_target_m": unknown})

    original = read_original([rewritten(tmp_path / "a.mcap", real, "real.mcap")])
    assert "the device's recorded positions" in original.hand
    assert "the device was mine:Device" in original.hand
    assert original.params.hardware == "simulated"
    result, compared = replayed(tmp_path / "real.mcap")
    moved = read_recording(tmp_path / "a.mcap").device
    followed = result.recording.device["operator_target_m"]
    assert followed == pytest.approx(moved["position_m"], abs=1e-12)
    assert compared["max_position_difference_m"] > 1e-4  # a simulated hand gives way


@pytest.mark.parametrize("n", [1, 3])
def test_the_recorded_hand_keeps_to_the_theory_of_cubic_curves(n: int) -> None:
    """h^3/24 max|x'''| from the slopes, h^4/384 max|x''''| from Hermite's formula; through the samples exactly."""
    a, w, h = 0.03, 12.0, 0.005
    times = 0.2 + h * np.arange(200)
    path = np.column_stack([a * np.sin(w * times + axis) for axis in range(n)])
    hand = Followed(times, path, Impedance())
    for t, point in zip(times[1:-1], path[1:-1], strict=True):
        assert hand.reference(t) == pytest.approx(tuple(point), abs=1e-15)
    bound = a * (w * h) ** 3 / 24 + a * (w * h) ** 4 / 384
    worst = 0.0
    for t in np.linspace(times[1], times[-2], 3001):
        worst = max(worst, max(abs(hand.reference(t)[axis] - a * math.sin(w * t + axis)) for axis in range(n)))
    assert bound / 20 < worst <= bound
    assert hand.reference(0.0) == hand.reference(0.1) == tuple(path[0])
    assert hand.reference(9.0) == tuple(path[-1])
