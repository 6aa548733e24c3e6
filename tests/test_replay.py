"""A recorded run again: exactly, through another link or coupling, torn, of one side, and with a hand that is gone."""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import signal

from hapnet import cli
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.params import Params
from hapnet.plant.operator import Followed, Impedance
from hapnet.recording.hand import hand_times, recorded_hand
from hapnet.recording.mcap import RecordingWriter, read_recording, save
from hapnet.recording.samples import DeviceSample, Event, Recording, WorldSample
from hapnet.simulation.replay import compare, read_original
from hapnet.simulation.simulation import Result, simulate
from hapnet.transport.config import free_address
from netem import Timeline
from tests.pairs import Running, parameters, running
from tests.processes import started

Capture = pytest.CaptureFixture[str]
QUICK: dict[str, object] = {"duration_s": 1.2, "operator_hand.wait_s": 0.1, "operator_hand.reach_s": 0.4}

OWN = """
import math
from hapnet.plant.operator import Impedance

class Smooth:
    '''x_d = a (1 - cos w t): it starts at rest.'''
    def __init__(self, dof, impedance):
        self.impedance, self.dof = impedance, dof
    def reference(self, t):
        return (0.01 * (1.0 - math.cos(9.0 * t)),) * self.dof
"""


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Every test runs in a directory of its own, with a hand of the user's own in it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    monkeypatch.delitem(sys.modules, "own_hand", raising=False)
    (tmp_path / "own_hand.py").write_text(OWN, "utf-8")
    return tmp_path


def recorded(path: Path, seed: int = 5, **changes: object) -> Result:
    """Simulated, with its recording in a file."""
    result = simulate(Params().set({**QUICK, **{name.replace("__", "."): v for name, v in changes.items()}}), seed)
    save(result.recording, path)
    return result


def replayed(*files: Path, **changes: object) -> tuple[Result, dict[str, Any]]:
    original = read_original(files)
    params = original.params.set({name.replace("__", "."): value for name, value in changes.items()})
    result = simulate(params, original.seed)
    return result, compare(original, result.recording, result.summary)


def rewritten(path: Path, change: Callable[[Recording], Recording], name: str) -> Path:
    """A copy of a recording, with something else in it."""
    target = path.with_name(name)
    save(change(read_recording(path)), target)
    return target


def with_meta(recording: Recording, **meta: Any) -> Recording:
    return dataclasses.replace(recording, meta={**recording.meta, **meta})


def with_params(recording: Recording, **params: Any) -> Recording:
    return with_meta(recording, params={**recording.meta["params"], **params}, operator_sha256=None)


def run(*argv: str | Path) -> int:
    return cli.main([str(word) for word in argv])


# Exactly


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"coupling": "zoh"},
        {"scene": "free", "dof": 2, "operator": "sine"},
        {"scene": "box", "operator": "sine", "device__servo": "sampled", "device__resolution_m": 5.5e-5},
        {"scene": "paper", "operator": "hand.csv", "device__stiffness": (100.0, 100.0, 150.0)},
        {"scene": "free", "operator": "rest", "operator_hand__start_m": 0.01},
        {"operator": "own_hand:Smooth", "link__up_timeline": "at 0.4s: down; at 0.8s: up"},
    ],
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
        assert before is not None
        assert after is not None
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
    assert recording.device is not None
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
        {"operator_hand__stiffness": 300.0},
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
    light: dict[str, object] = {"operator": "sine", "operator_hand__frequency_hz": 2.0, "operator_hand__damping": 1.0}
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
    assert "torn" in original.notes[0]
    result = simulate(original.params, original.seed)
    assert compare(original, result.recording, result.summary)["identical"] is True
    assert original.recording.device is not None
    assert result.recording.device is not None
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
    hand, device = params.operator_hand, params.device
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


def test_of_a_person_with_a_real_device_the_positions_are_followed(tmp_path: Path) -> None:
    recorded(tmp_path / "a.mcap", scene="free", operator="sine")

    def real(recording: Recording) -> Recording:
        assert recording.device is not None
        unknown = np.full_like(recording.device["position_m"], np.nan)
        held = with_params(recording, hardware="mine:Device")
        return dataclasses.replace(held, device={**recording.device, "operator_target_m": unknown})

    original = read_original([rewritten(tmp_path / "a.mcap", real, "real.mcap")])
    assert "the device's recorded positions" in original.hand
    assert "the device was mine:Device" in original.hand
    assert original.params.hardware == "simulated"
    result, compared = replayed(tmp_path / "real.mcap")
    assert result.recording.device is not None
    moved = read_recording(tmp_path / "a.mcap").device
    assert moved is not None
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


# Links that were changed during the run


def session(
    tmp_path: Path,
    side: str,
    *,
    link: str = "delay 5ms",
    origin_ns: int = 7_000_000_000,
    begins_s: float = 0.0,
    ends_s: float = 2.0,
    pauses: tuple[tuple[float, float], ...] = (),
    events: tuple[tuple[float, str, str], ...] = (),
    **params: object,
) -> Path:
    """A side's recording in real time, by hand: its device is where its hand is led, x_d = 0.01 m/s t, but in pauses.

    Times count from the session's start; a sample comes every 5 ms, of the world every 20 ms.
    """
    given = {"operator": "mouse", "scene": "free", "link.up": "delay 1ms", "link.down": "delay 1ms", **params}
    way = "up" if side == "device" else "down"
    meta = {
        "params": Params().set({name.replace("__", "."): value for name, value in given.items()}).as_dict(),
        "seed": 3,
        "role": side,
        "clock": "boot:1",
        "origin_ns": origin_ns,
        "coupling": "pspm",
        "links": {way: link},
        "operator_sha256": None,
    }
    path = tmp_path / f"{side}.mcap"
    writer = RecordingWriter(path, meta)
    told = list(events)
    for stop_s, go_s in pauses:
        told += [(stop_s, "pause", "paused"), (go_s, "pause", "goes on")]
    for at_s, kind, text in sorted(told):
        writer.write(Event(origin_ns + round(at_s * 1e9), kind, text))
    step_ms = 5 if side == "device" else 20
    for at_ms in range(step_ms, round(ends_s * 1e3) + 1, step_ms):
        at_s = at_ms / 1e3
        if at_s < begins_s or any(start < at_s <= end for start, end in pauses):
            continue
        lived = at_s - sum(max(0.0, min(at_s, end) - start) for start, end in pauses)
        x, zero = (0.01 * lived,), (0.0,)
        time_ns = origin_ns + at_ms * 1_000_000
        if side == "device":
            writer.write(DeviceSample(time_ns, x, x, x, zero, zero, 0.05, 0.0, 0.0, 0.0, 0.0, 0.1, 0.1, x))
        else:
            energies = (0.0, 0.05, 0.0, 0.0, 0.0, 0.1, 0.1)
            writer.write(WorldSample(time_ns, 0.02, x, zero, x, x, zero, zero, *energies))
    writer.close(None)
    return path


def changed(at_s: float, words: str) -> tuple[float, str, str]:
    return at_s, "netem", f"emulated link, {words}"


def test_a_link_that_was_changed_while_it_ran_is_changed_in_the_replay(tmp_path: Path) -> None:
    up = (changed(0.5, "delay 60ms"), changed(1.2, "ideal"), (1.3, "note", "emulated link, down"))
    down = (changed(0.7, "down"), changed(0.9, "up"))
    device = session(tmp_path, "device", link="delay 5ms", events=up)
    world = session(tmp_path, "world", link="delay 9ms", events=down, origin_ns=7_010_000_000)
    for files in ((device, world), (world, device)):
        original = read_original(files)
        link = original.params.link
        assert (link.up, link.down) == ("delay 5ms", "delay 9ms")
        assert link.up_timeline == "at 500ms: delay 60ms; at 1.2s: ideal"
        assert link.down_timeline == "at 710ms: down; at 910ms: up"  # on the device's clock, as both are on one
        assert [note for note in original.notes if "link was changed" in note] == [
            "the uplink was changed 2 times during the run: the replay makes the same changes",
            "the downlink was changed 2 times during the run: the replay makes the same changes",
        ]
    alone = read_original([device]).params.link
    assert (alone.up_timeline, alone.down, alone.down_timeline) == (link.up_timeline, "delay 1ms", "")
    summary = simulate(original.params, original.seed).summary
    assert summary["links"]["up"]["profile"] == ""
    assert 30 < summary["links"]["up"]["delay_p99_ms"] < 62
    assert summary["links"]["down"]["lost_down"] > 0


def test_a_timeline_of_its_own_is_not_applied_twice(tmp_path: Path) -> None:
    own = "at 500ms: delay 60ms; at 1s: up"
    events = (changed(0.5, "at 500ms: delay 60ms"), changed(0.8, "loss 1%"), changed(1.0, "at 1s: up"))
    link = read_original([session(tmp_path, "device", events=events, link__up_timeline=own)]).params.link
    assert link.up_timeline == "at 500ms: delay 60ms; at 800ms: loss 1%; at 1s: up"
    quiet = read_original([session(tmp_path, "device", link__up_timeline="at 9s: down; at 10s: repeat")]).params.link
    assert quiet.up_timeline == "at 9s: down; at 10s: repeat"  # it ended before the first change


@pytest.mark.parametrize(
    ("flags", "up", "down"),
    [
        ((), "at 500ms: delay 60ms", "at 700ms: down"),
        (("--uplink", "delay 5ms"), "", "at 700ms: down"),
        (("--downlink", "delay 5ms"), "at 500ms: delay 60ms", ""),
        (("--delay", "5ms"), "", ""),
        (("--delay", "5ms", "--up-timeline", "at 1s: up"), "at 1s: up", ""),
    ],
    ids=" ".join,
)
def test_a_link_that_is_asked_for_is_the_replays_from_end_to_end(
    tmp_path: Path, capsys: Capture, flags: tuple[str, ...], up: str, down: str
) -> None:
    device = session(tmp_path, "device", ends_s=0.8, events=(changed(0.5, "delay 60ms"),))
    world = session(tmp_path, "world", ends_s=0.8, events=(changed(0.7, "down"),))
    assert run("replay", device, world, *flags, "--out", "again") == 0
    capsys.readouterr()
    link = read_recording(tmp_path / "again" / "run.mcap").meta["params"]["link"]
    assert (link["up_timeline"], link["down_timeline"]) == (up, down)


def test_a_recording_that_begins_in_the_middle_is_replayed_from_its_beginning(tmp_path: Path) -> None:
    events = (changed(40.0005, "down"), changed(40.5, "up"), changed(41.0, "delay 60ms"))
    own = "at 3s: delay 200ms; at 41s: down"
    device = session(
        tmp_path, "device", link="delay 70ms", begins_s=40.0, ends_s=42.0, events=events[1:], link__up_timeline=own
    )
    world = session(tmp_path, "world", link="delay 80ms", begins_s=40.0, ends_s=42.0, link__down_timeline=own)
    original = read_original([device, world])
    params = original.params
    assert params.duration_s == pytest.approx(2.0, abs=1e-9)
    assert (params.link.up, params.link.up_timeline) == ("delay 70ms", "at 500ms: up; at 1s: delay 60ms")
    assert (params.link.down, params.link.down_timeline) == ("delay 80ms", "")
    assert any("begins 40.0 s after its session:" in note for note in original.notes)
    times = hand_times(original.recording)
    assert times[0] == 0.0
    assert times[-1] == pytest.approx(2.0, abs=1e-9)
    hand = recorded_hand(str(device), 1, Impedance())
    for t in (0.0, 0.005, 1.0, 2.0):
        assert hand.reference(t)[0] == pytest.approx(0.4 + 0.01 * t, abs=1e-12)
    result = simulate(params, original.seed)
    target = result.recording.device
    assert target is not None
    assert target["operator_target_m"][-1, 0] == pytest.approx(0.42, abs=1e-4)
    compared = compare(original, result.recording, result.summary)
    assert compared["max_position_difference_m"] is not None

    held = session(tmp_path, "device", begins_s=40.0, ends_s=42.0, operator="press")
    assert "the recording begins in the middle of its session" in read_original([held]).hand


def test_a_link_that_was_down_when_the_recording_began_is_down_at_the_start(tmp_path: Path) -> None:
    events = (changed(39.99, "down"), changed(41.0, "up"))
    link = read_original([session(tmp_path, "device", begins_s=40.0, ends_s=42.0, events=events)]).params.link
    assert (link.up, link.up_timeline) == ("delay 5ms", "at 0ms: down; at 1s: up")


def test_pauses_are_left_out(tmp_path: Path) -> None:
    pauses = ((0.502, 1.502), (1.702, 3.702))
    events = (changed(0.3, "delay 60ms"), changed(1.0, "delay 70ms"), changed(4.0, "delay 80ms"))
    both: dict[str, Any] = {"pauses": pauses, "ends_s": 5.0}
    device = session(tmp_path, "device", events=events, **both)
    world = session(tmp_path, "world", **both)
    original = read_original([device, world])
    assert "the replay leaves out pauses: 2, 3.0 s in all" in original.notes
    assert original.params.duration_s == pytest.approx(2.0, abs=0.012)
    times = hand_times(original.recording)
    assert np.diff(times) == pytest.approx(0.005, abs=1e-9)
    hand = recorded_hand(str(device), 1, Impedance())
    for t in np.linspace(0.1, 1.9, 50):
        assert hand.reference(t)[0] == pytest.approx(0.01 * t, abs=1e-4)  # two samples' way, one for each pause
    entries = Timeline.parse(original.params.link.up_timeline).entries
    assert [entry.at_ns / 1e9 for entry in entries] == pytest.approx([0.3, 0.502, 1.0], abs=0.012)
    made = read_original([session(tmp_path, "device", operator="press", **both)])
    assert made.hand == "press, generated again from its parameters"  # its own time stood still, too


def test_samples_that_are_missing_are_no_pause(tmp_path: Path) -> None:
    path = session(tmp_path, "device", ends_s=3.0)

    def lossy(whole: Recording) -> Recording:
        assert whole.device is not None
        kept = (whole.device["time_s"] < 1.0) | (whole.device["time_s"] > 2.0)
        told = [Event(7_500_000_000, "pause", "paused"), Event(7_500_100_000, "pause", "goes on")]
        return dataclasses.replace(whole, device={k: v[kept] for k, v in whole.device.items()}, events=told)

    original = read_original([rewritten(path, lossy, "lossy.mcap")])
    assert original.params.duration_s == pytest.approx(3.0, abs=1e-9)
    assert hand_times(original.recording)[-1] == pytest.approx(3.0, abs=1e-9)


def test_a_real_hand_moves_on_in_a_pause(tmp_path: Path) -> None:
    path = session(tmp_path, "device", pauses=((0.5, 1.5),), hardware="mine:Device")
    assert read_original([path]).params.duration_s == pytest.approx(2.0, abs=1e-9)


async def test_a_session_whose_link_was_changed_by_hand_is_replayed(tmp_path: Path) -> None:
    address, params = (
        free_address(),
        parameters(operator="sine", link__up="", link__down="delay 2ms", link__up_timeline="at 100ms: delay 4ms"),
    )
    device, world = Running("device", address, params), Running("world", address, params)
    async with running(device, world):
        await device.until(lambda: device.count > 600)
        await device.until(lambda: str(device.side.profile) == "delay 4ms")
        device.side.record(tmp_path / "device.mcap")
        world.side.record(tmp_path / "world.mcap")
        began = device.count
        await device.until(lambda: device.count > began + 150)
        device.side.change_link("delay 60ms")
        world.side.change_link("")
        began = device.count
        await device.until(lambda: device.count > began + 150)
        device.side.pause(True)
        world.side.pause(True)
        began = device.count
        await device.until(lambda: device.count > began + 400)
        device.side.pause(False)
        world.side.pause(False)
        await device.until(lambda: device.count > began + 600)
        await device.end()
        await world.end()
    original = read_original([tmp_path / "device.mcap", tmp_path / "world.mcap"])
    link = original.params.link
    assert (link.up, link.down) == ("delay 4ms", "delay 2ms")
    [up] = Timeline.parse(link.up_timeline).entries
    [down] = Timeline.parse(link.down_timeline).entries
    assert (str(up.action), str(down.action)) == ("delay 60ms", "")
    assert 0.1 < up.at_ns / 1e9 < original.params.duration_s
    assert original.recording.device is not None
    recorded_s = float(np.ptp(original.recording.device["time_s"]))
    told = [event.time_ns for event in read_recording(tmp_path / "device.mcap").events if event.kind == "pause"]
    paused_s = (told[1] - told[0]) / 1e9
    assert paused_s > 0.3
    assert hand_times(original.recording)[-1] == pytest.approx(recorded_s - paused_s, abs=0.1)
    assert any("the replay leaves out pauses: 1" in note for note in original.notes)
    assert any("s after its session:" in note for note in original.notes)
    result = simulate(original.params, original.seed)
    assert result.summary["links"]["up"]["profile"] == "delay 60ms"
    assert compare(original, result.recording, result.summary)["rms_position_difference_m"] < 0.02


# The command


def test_the_command_writes_all_and_compares_in_words(tmp_path: Path, capsys: Capture) -> None:
    recorded(tmp_path / "a.mcap")
    assert run("replay", "a.mcap", "--out", "again") == 0
    out, err = capsys.readouterr()
    assert not err
    assert "hand: press, generated again from its parameters" in out
    assert "identical to the original" in out
    assert "original   replay" in out
    files = {path.name for path in (tmp_path / "again").iterdir()}
    assert files == {"run.mcap", "figure.png", "replay.png", "summary.json"}
    assert run("replay", "again/run.mcap", "--coupling", "zoh", "--delay", "150ms", "--out", "other") == 0
    out, _ = capsys.readouterr()
    assert "differs from the original: the device by" in out
    summary = json.loads((tmp_path / "other" / "summary.json").read_text("utf-8"))
    assert summary["coupling"] == "zoh"
    assert summary["links"]["up"]["profile"].startswith("delay 150ms")
    assert summary["replay"]["of"] == ["again/run.mcap"]
    assert summary["replay"]["identical"] is False
    assert summary["replay"].keys() >= {"hand", "max_position_difference_m", "rms_position_difference_m"}
    assert summary["replay"]["original"].keys() == summary["replay"]["replay"].keys()
    kept = read_recording(tmp_path / "other" / "run.mcap").summary
    assert kept is not None
    assert kept["replay"] == summary["replay"]
    assert kept["motion"] == summary["motion"]


def test_a_recording_is_an_operator_everywhere(tmp_path: Path) -> None:
    recorded(tmp_path / "a.mcap")
    assert run("simulate", "--operator", "a.mcap", "--duration", "1", "--out", "b") == 0
    first, second = read_recording("a.mcap").device, read_recording("b/run.mcap").device
    assert first is not None
    assert second is not None
    n = len(second["time_ns"])
    assert second["operator_target_m"] == pytest.approx(first["operator_target_m"][:n], abs=1e-12)
    hand = recorded_hand("a.mcap", 1, Impedance())
    assert hand.reference(5.0) == tuple(first["operator_target_m"][-1])


@pytest.mark.parametrize(
    ("argv", "told"),
    [
        (["replay", "nothing.mcap"], "cannot read recording nothing.mcap"),
        (["replay", "own_hand.py"], "own_hand.py is not a recording"),
        (["replay", "a.mcap", "a.mcap", "a.mcap"], "one recording, or the device's and the world's"),
        (["replay", "a.mcap", "a.mcap"], "one must hold a device's samples"),
        (["replay", "a.mcap", "--duration", "0"], "above 0 in virtual time"),
        (["replay", "a.mcap", "--delay", "soon"], "soon"),
        (["replay", "a.mcap", "--set", "hardware=mine:Device"], "a real device does not run in virtual time"),
        (["replay", "run.mcap", "--out", "."], "a directory other than the recording's"),
        (["replay", "bare.mcap"], "does not say with which parameters"),
        (["simulate", "--operator", "a.mcap", "--dof", "2", "--scene", "free"], "a recording with 2 axes"),
        (["simulate", "--operator", "nothing.mcap"], "cannot read recording nothing.mcap"),
        (["simulate", "--operator", "empty.mcap"], "a recording with the device's side"),
    ],
    ids=lambda value: "-".join(value)[:40] if isinstance(value, list) else "",
)
def test_what_cannot_be_replayed_is_told_in_one_line(
    tmp_path: Path, argv: list[str], told: str, capsys: Capture
) -> None:
    recorded(tmp_path / "a.mcap", duration_s=0.2)
    save(read_recording("a.mcap"), "run.mcap")
    rewritten(tmp_path / "a.mcap", lambda whole: with_meta(whole, params=None), "bare.mcap")
    rewritten(tmp_path / "a.mcap", lambda whole: dataclasses.replace(whole, device=None), "empty.mcap")
    before = (tmp_path / "run.mcap").read_bytes()
    assert run(*argv) == 2
    _, err = capsys.readouterr()
    assert err.startswith("hapnet: ")
    assert told in err
    assert len(err.splitlines()) == 1
    assert (tmp_path / "run.mcap").read_bytes() == before


@pytest.mark.parametrize(
    ("meta", "told"),
    [
        ({"seed": "one"}, "seed of the recording"),
        ({"seed": None}, "seed of the recording"),
        ({"params": [1]}, "does not say with which parameters"),
        ({"params": {"duration_s": "long"}}, "duration_s"),
        ({"params": {"device": {"servo_hz": -1.0}}}, "device.servo_hz"),
        ({"params": {"coupling": "glue"}}, "coupling"),
    ],
)
def test_settings_that_are_none_are_told_in_one_line(tmp_path: Path, meta: dict[str, Any], told: str) -> None:
    recorded(tmp_path / "a.mcap", duration_s=0.2)
    rewritten(tmp_path / "a.mcap", lambda whole: with_meta(whole, **meta), "b.mcap")
    with pytest.raises(HapnetError, match=told) as info:
        read_original([tmp_path / "b.mcap"])
    assert "\n" not in str(info.value)


@pytest.mark.parametrize("summary", [{"a": 1}, {"device": 7, "world": None, "theorem": {"margin_J": 0.0}}, [1]])
def test_a_summary_that_does_not_fit_is_told_in_one_line(tmp_path: Path, summary: Any) -> None:
    recorded(tmp_path / "a.mcap", duration_s=0.2)
    rewritten(tmp_path / "a.mcap", lambda whole: dataclasses.replace(whole, summary=summary), "b.mcap")
    with pytest.raises(HapnetError, match="summary does not fit"):
        read_original([tmp_path / "b.mcap"])


def test_settings_of_another_version_are_told(tmp_path: Path) -> None:
    recorded(tmp_path / "a.mcap", duration_s=0.2)

    def newer(recording: Recording) -> Recording:
        params = {**recording.meta["params"], "device": {"new": 3, "servo_hz": 1000.0}, "feel": "soft"}
        return with_meta(recording, params=params)

    original = read_original([rewritten(tmp_path / "a.mcap", newer, "new.mcap")])
    assert original.notes == ("this version does not know these parameters and leaves them out: device.new, feel",)
    assert original.params.device == Params().device


@pytest.mark.slow
def test_a_run_in_real_time_is_replayed(tmp_path: Path) -> None:
    with started("run", "--duration", 3, "--seed", 4, "--out", tmp_path / "run") as program:
        code, _, stderr = program.end()
    assert code == 0, stderr
    files = [tmp_path / "run" / f"{side}.mcap" for side in ("device", "world")]
    result, compared = replayed(*files)
    assert compared["identical"] is False
    assert compared["rms_position_difference_m"] < 0.003  # of the 0.04 m that the hand wants to go
    assert result.summary["theorem"]["margin_J"] >= 0.0
    assert result.summary["links"]["up"]["profile"] == "delay 40ms 10ms loss 2%"
