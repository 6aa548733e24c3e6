"""The link and the pauses of a recorded session, in its replay."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet.plant.operator import Impedance
from hapnet.recording.hand import hand_times, recorded_hand
from hapnet.recording.mcap import read_recording
from hapnet.recording.samples import Event, Recording
from hapnet.simulation.replay import compare, read_original
from hapnet.simulation.simulation import simulate
from netem import Timeline
from tests.conftest import mostly_slow
from tests.support.replays import Capture, changed, here as here, rewritten, run, session


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
    mostly_slow(
        [
            ((), "at 500ms: delay 60ms", "at 700ms: down"),
            (("--uplink", "delay 5ms"), "", "at 700ms: down"),
            (("--delay", "5ms", "--up-timeline", "at 1s: up"), "at 1s: up", ""),
            (("--downlink", "delay 5ms"), "at 500ms: delay 60ms", ""),
            (("--delay", "5ms"), "", ""),
        ],
        3,
    ),
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
        kept = (whole.device["time_s"] < 1.0) | (whole.device["time_s"] > 2.0)
        reported = [Event(7_500_000_000, "pause", "paused"), Event(7_500_100_000, "pause", "goes on")]
        return dataclasses.replace(whole, device={k: v[kept] for k, v in whole.device.items()}, events=reported)

    original = read_original([rewritten(path, lossy, "lossy.mcap")])
    assert original.params.duration_s == pytest.approx(3.0, abs=1e-9)
    assert hand_times(original.recording)[-1] == pytest.approx(3.0, abs=1e-9)


def test_a_real_hand_moves_on_in_a_pause(tmp_path: Path) -> None:
    path = session(tmp_path, "device", pauses=((0.5, 1.5),), hardware="mine:Device")
    assert read_original([path]).params.duration_s == pytest.approx(2.0, abs=1e-9)
