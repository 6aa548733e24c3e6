"""Runs in real time, replayed."""

from pathlib import Path

import numpy as np
import pytest

from hapnet.recording.hand import hand_times
from hapnet.recording.mcap import read_recording
from hapnet.simulation.replay import compare, read_original
from hapnet.simulation.simulation import simulate
from hapnet.transport.config import free_address
from netem import Timeline
from tests.support.pairs import Running, parameters, running
from tests.support.processes import started
from tests.support.replays import here as here, replayed


@pytest.mark.slow
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
    recorded_s = float(np.ptp(original.recording.device["time_s"]))
    reported = [event.time_ns for event in read_recording(tmp_path / "device.mcap").events if event.kind == "pause"]
    paused_s = (reported[1] - reported[0]) / 1e9
    assert paused_s > 0.3
    assert hand_times(original.recording)[-1] == pytest.approx(recorded_s - paused_s, abs=0.1)
    assert any("the replay leaves out pauses: 1" in note for note in original.notes)
    assert any("s after its session:" in note for note in original.notes)
    result = simulate(original.params, original.seed)
    assert result.summary["links"]["up"]["profile"] == "delay 60ms"
    assert compare(original, result.recording, result.summary)["rms_position_difference_m"] < 0.02


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
