"""What recordings say of time: UTC, the age of the message in use, velocity; and files of before they said it."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from hapnet import simulate
from hapnet.params import Params
from hapnet.realtime.recorder import measured_utc_less_clock_ns
from hapnet.recording.mcap import RecordingWriter, read_recording, save
from hapnet.recording.samples import Event, Recording, join
from tests.recording.test_samples import META, ORIGIN, device_sample, halves

DATA = Path(__file__).parents[1] / "data"
DELAY_NS = 20_000_000
LATER_NS = 1_795_394_565_084_310_252 - ORIGIN
UTC = META | {"utc_origin_ns": ORIGIN + LATER_NS, "utc_clock": "system"}


@pytest.fixture(scope="module")
def run() -> Recording:
    """A second over links that delay by 20 ms, and only that."""
    link = f"delay {DELAY_NS // 1_000_000}ms"
    settings = {"link.up": link, "link.down": link, "operator": "sine", "operator_model.start_periods": 0.0}
    changes = {**settings, "duration_s": 1.0, "record_hz": 1000.0, "device.servo": "sampled"}
    return simulate(Params().set(changes), seed=1, kernel=False).recording


def test_the_age_is_the_time_since_the_other_side_sent_what_is_used(run: Recording) -> None:
    """The world sends at each of its steps; the device uses a message in the first tick that finds it."""
    ticks, steps = run.device["time_ns"], run.world["time_ns"]
    later = ticks > steps[2] + 3 * DELAY_NS  # from where the round trip is known
    newest = steps[np.searchsorted(steps + DELAY_NS, ticks[later], side="right") - 1]
    np.testing.assert_allclose(run.device["age_s"][later], (ticks[later] - newest) * 1e-9, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(run.device["transit_s"][later], DELAY_NS * 1e-9, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(run.world["transit_s"][1:], DELAY_NS * 1e-9, rtol=0.0, atol=1e-15)
    old = run.world["age_s"][5:]  # the device sends every 5 ms
    assert np.all((old >= 0.020) & (old < 0.025 + 1e-9))


def test_before_the_first_message_there_is_no_age(run: Recording) -> None:
    early = run.device["time_ns"] < run.meta["origin_ns"] + DELAY_NS
    assert np.isnan(run.device["age_s"][early]).all()
    assert np.isnan(run.device["transit_s"][early]).all()


@pytest.mark.parametrize("rendering", ["hapnet", "paper"])
@pytest.mark.parametrize("servo", ["sampled", "continuous"])
def test_the_velocity_is_the_paths(servo: str, rendering: str) -> None:
    """By the midpoint rule each substep moves the device by its mean velocity; over a tick that is a trapezium."""
    changes = {
        "device.servo": servo,
        "rendering": rendering,
        "record_hz": 1000.0,
        "duration_s": 0.5,
        "operator": "sine",
    }
    settings = {**changes, "operator_model.start_periods": 0.0}
    recording = simulate(Params().set(settings), seed=1, kernel=False).recording
    x, v, t = (recording.device[name] for name in ("position_m", "velocity_mps", "time_s"))
    moved = np.diff(x, axis=0)
    np.testing.assert_allclose(moved, (v[1:] + v[:-1]) / 2.0 * np.diff(t)[:, None], rtol=0.0, atol=2e-7)
    assert np.abs(moved).max() > 5e-5


@pytest.mark.parametrize("rendering", ["hapnet", "paper"])
def test_with_encoders_the_velocity_is_what_the_servo_reads(rendering: str) -> None:
    """Whole counts a tick."""
    count, changes = (
        1e-5,
        {"device.resolution_m": 1e-5, "device.servo": "sampled", "record_hz": 1000.0, "rendering": rendering},
    )
    hand = {"operator": "sine", "operator_model.start_periods": 0.0}
    recording = simulate(Params().set({**changes, **hand, "duration_s": 0.3}), 1, kernel=False).recording
    x, v = recording.device["position_m"][:, 0], recording.device["velocity_mps"][:, 0]
    np.testing.assert_allclose(v[1:], np.diff(x) / 1e-3, rtol=0.0, atol=1e-9)
    assert set(np.round(v * 1e-3 / count, 6)) > {0.0, 1.0, 2.0}


def test_log_times_are_utc_and_samples_keep_their_clock(tmp_path: Path) -> None:
    samples = [device_sample(0), Event(ORIGIN + 5, "paired", "a"), *(device_sample(i) for i in range(1, 20))]
    writer = RecordingWriter(tmp_path / "a.mcap", UTC)
    for sample in samples:
        writer.write(sample)
    writer.close()
    with (tmp_path / "a.mcap").open("rb") as file:
        times = [m.log_time for _, c, m in make_reader(file).iter_messages() if c.topic == "/device/state"]
    assert times == [ORIGIN + LATER_NS + i * 1_000_000 for i in range(20)]
    recording = read_recording(tmp_path / "a.mcap")
    assert recording.meta["utc_clock"] == "system"
    assert recording.samples() == samples
    save(recording, tmp_path / "b.mcap")
    assert read_recording(tmp_path / "b.mcap").samples() == samples


def test_a_simulation_counts_from_1970_and_says_so(run: Recording, tmp_path: Path) -> None:
    assert (run.meta["clock"], run.meta["utc_clock"]) == ("virtual", "virtual")
    save(run, tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as file:
        [first] = [m for _, _, m in itertools.islice(make_reader(file).iter_messages("/device/state"), 1)]
    assert first.log_time == run.device["time_ns"][0] < 10**8


def test_utc_is_taken_between_two_readings_of_the_clock_that_are_near() -> None:
    """The third try is the one that nothing interrupted."""
    clock = iter([0, 90, 100, 150, 200, 204, 300, 390, 400, 480])
    utc = iter([10_080, 10_110, 10_203, 10_310, 10_410])
    assert measured_utc_less_clock_ns(lambda: next(clock), lambda: next(utc)) == 10_203 - 202


def test_joined_recordings_keep_the_devices_utc() -> None:
    later = ORIGIN + 2_000_000
    device, world = halves({**UTC, "role": "world", "origin_ns": later}, later)
    device.meta.update(UTC)
    assert join(device, world).meta["utc_origin_ns"] == later + LATER_NS


def test_a_recording_of_before_all_this_is_read_as_it_was() -> None:
    """Written by version 0.1.0: 0.1 s of two axes over wifi."""
    recording = read_recording(DATA / "recording-0.1.0.mcap")
    assert not recording.torn
    assert recording.device["position_m"].shape == (10, 2)
    assert recording.device["time_ns"].tolist() == list(range(20_000_000, 120_000_000, 10_000_000))
    assert recording.device["time_s"][0] == pytest.approx(0.009)
    assert recording.world["penetration_m"].shape == recording.world["age_s"].shape
    for name in ("velocity_mps", "age_s", "transit_s", "bound_J", "work_J", "operator_work_J"):
        assert np.isnan(recording.device[name]).all()
    assert np.isnan(recording.world["work_J"]).all()
    assert "utc_origin_ns" not in recording.meta
    assert recording.summary["seed"] == 1
