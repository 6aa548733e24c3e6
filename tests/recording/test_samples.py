import math

import numpy as np
import pytest

from hapnet.errors import RecordingError
from hapnet.recording.samples import DeviceSample, Event, MemoryRecorder, Recording, Sample, WorldSample, join

ORIGIN = 1_700_000_000_123_456_789
META = {"origin_ns": ORIGIN, "clock": "boot-1", "role": "device", "seed": 7, "params": {"scene": "wall"}}


def device_sample(i: int, n: int = 2, origin: int = ORIGIN) -> DeviceSample:
    v = tuple(0.1 * math.sin(0.7 * i + axis) for axis in range(n))
    w = tuple(x / 3.0 for x in v)
    return DeviceSample(
        origin + i * 1_000_000, v, w, v, w, None if i % 2 else v, 0.05, 0.0, 1 / 3, 1e-9, 0.0, 0.1, -0.0, w, v, w,
        None if i % 3 else w, v, velocity_mps=w, age_s=0.01 + 1e-3 * i, transit_s=0.02,
        bound_J=0.1, work_J=1e-3 * i, stored_J=0.02, account_J=0.08, operator_work_J=2e-3 * i,
    )  # fmt: skip


def world_sample(i: int, n: int = 2, origin: int = ORIGIN) -> WorldSample:
    v = tuple(0.1 * math.cos(0.3 * i + axis) for axis in range(n))
    return WorldSample(
        origin + i * 30_000_000, 0.03, v, v, v, v, v, v, -0.01, 0.05, 0.2, 0.0, 1e-9, 0.1, 0.2, 0.03, 0.01,
        0.05, -1e-3 * i, 0.03, 0.02,
    )  # fmt: skip


def run(n: int = 2) -> list[Sample]:
    samples: list[Sample] = [device_sample(i, n) for i in range(300)]
    samples += [world_sample(i, n) for i in range(10)]
    samples += [Event(ORIGIN, "paired", "session ‘a’"), Event(ORIGIN + 5, "note", "two")]
    return sorted(samples, key=lambda sample: sample.time_ns)


def same(a: Recording, b: Recording) -> bool:
    for x, y in ((a.device, b.device), (a.world, b.world)):
        if (x is None) != (y is None):
            return False
        if x is not None and y is not None:
            if x.keys() != y.keys():
                return False
            for name in x:
                np.testing.assert_array_equal(x[name], y[name], err_msg=name, strict=True)
    return (a.meta, a.events, a.summary) == (b.meta, b.events, b.summary)


def memory(samples: list[Sample], meta: dict[str, object] = META) -> Recording:
    recorder = MemoryRecorder(meta)
    for sample in samples:
        recorder.write(sample)
    return recorder.recording({"seed": 7})


def test_samples_become_columns_and_columns_samples() -> None:
    recording = memory(run(3))
    assert recording.device["position_m"].shape == (300, 3)
    assert np.isnan(recording.device["operator_force_N"][1]).all()
    assert recording.device["time_s"][7] == 0.007
    assert sorted(recording.samples(), key=repr) == sorted(run(3), key=repr)


def halves(world_meta: dict[str, object], world_origin: int) -> tuple[Recording, Recording]:
    device = memory([device_sample(i) for i in range(5)])
    world = memory(
        [*(world_sample(i, origin=world_origin) for i in range(5)), Event(world_origin, "start", "")], world_meta
    )
    return device, world


def test_join_on_one_clock() -> None:
    later = ORIGIN + 2_000_000
    device, world = halves({**META, "role": "world", "origin_ns": later}, later)
    for joined in (join(device, world), join(world, device)):
        assert joined.meta["origin_ns"] == later
        assert joined.meta["aligned"] is True
        np.testing.assert_allclose(joined.device["time_s"], [-0.002, -0.001, 0.0, 0.001, 0.002], rtol=0, atol=1e-15)
        assert joined.world["time_s"][0] == 0.0
        assert joined.events == [Event(later, "start", "")]


def test_join_without_a_common_clock() -> None:
    device, world = halves({"clock": "boot-2", "origin_ns": 5_000}, 6_000)
    joined = join(device, world)
    assert joined.summary is None
    assert joined.meta["aligned"] is False
    assert joined.meta["sides"]["world"]["clock"] == "boot-2"
    assert joined.world["time_s"][0] == 1e-6
    assert joined.events == [Event(ORIGIN + 1_000, "start", "")]


def test_two_recordings_of_one_side_cannot_be_joined() -> None:
    device, world = halves(dict(META), ORIGIN)
    for a, b in ((device, device), (world, world), (device, memory(run()))):
        with pytest.raises(RecordingError, match="one must hold a device's samples and the other a world's"):
            join(a, b)


@pytest.mark.parametrize("key", ["session", "name"])
def test_recordings_of_different_runs_cannot_be_joined(key: str) -> None:
    device, world = halves({**META, key: "monday"}, ORIGIN)
    assert join(device, world).world is not None  # one does not say
    device.meta[key] = "monday"
    assert join(device, world).meta[key] == "monday"
    device.meta[key] = "tuesday"
    for a, b in ((device, world), (world, device)):
        with pytest.raises(RecordingError, match=f"{key} is 'tuesday', the world's 'monday'"):
            join(a, b)
