from __future__ import annotations

import math
from dataclasses import replace

import pytest

from hapnet.metrics import motion
from hapnet.record import DeviceSample, MemoryRecorder, Recording, WorldSample

SECOND = 1_000_000_000


def device(time_s: float, position: tuple[float, ...], force: tuple[float, ...]) -> DeviceSample:
    return DeviceSample(int(time_s * SECOND), position, position, position, force, None, *[0.0] * 7)


def world(time_s: float, position: tuple[float, ...], penetration_m: float) -> WorldSample:
    p = position
    return WorldSample(int(time_s * SECOND), 1.0, p, p, p, p, p, p, penetration_m, *[0.0] * 6)


def recording(*samples: DeviceSample | WorldSample) -> Recording:
    recorder = MemoryRecorder({"origin_ns": 0})
    for sample in samples:
        recorder.write(sample)
    return recorder.recording()


def test_hand_computed_case() -> None:
    # proxy: 0 -> 2 m over [0, 2] s, then still until 4 s; in the wall over [2, 3) s and from 4 s
    run = recording(
        world(0, (0.0,), -1.0),
        world(2, (2.0,), 0.25),
        world(3, (2.0,), -0.5),
        world(4, (2.0,), 0.125),
        device(-1, (9.0,), (0.0,)),  # before the proxy is known
        device(0.5, (0.8,), (1.0,)),  # proxy 0.5: error 0.3
        device(1.5, (1.1,), (0.0,)),  # proxy 1.5: error 0.4
        device(2, (2.6,), (-7.0,)),  # in contact, error 0.6
        device(2.5, (2.8,), (0.0,)),  # in contact, error 0.8
        device(3, (2.0,), (0.0,)),  # out again, error 0
        device(5, (9.0,), (0.0,)),  # after the proxy is known
    )
    result = motion(run)
    assert result.keys() == {"free_rms_m", "contact_rms_m", "peak_force_N", "peak_penetration_m", "contacts"}
    assert result["free_rms_m"] == pytest.approx(math.sqrt((0.09 + 0.16) / 3), rel=1e-12)
    assert result["contact_rms_m"] == pytest.approx(math.sqrt((0.36 + 0.64) / 2), rel=1e-12)
    assert result["peak_force_N"] == 7.0
    assert result["peak_penetration_m"] == 0.25
    assert result["contacts"] == 2


def test_norms_in_the_plane_and_a_contact_from_the_start() -> None:
    result = motion(
        recording(
            world(0, (0.0, 0.0), 0.1),
            world(1, (0.0, 0.0), 0.2),
            device(0, (3.0, 4.0), (0.0, -6.0)),
            device(1, (3.0, 4.0), (6.0, 8.0)),
        )
    )
    assert result == {
        "free_rms_m": None,
        "contact_rms_m": 5.0,
        "peak_force_N": 10.0,
        "peak_penetration_m": 0.2,
        "contacts": 1,
    }


def test_never_touched() -> None:
    result = motion(recording(world(0, (0.0,), -0.5), world(1, (0.0,), 0.0), device(0.5, (1.0,), (0.0,))))
    assert result["contacts"] == 0
    assert result["peak_penetration_m"] == 0.0
    assert result["contact_rms_m"] is None
    assert result["free_rms_m"] == 1.0


def test_what_one_side_alone_can_tell() -> None:
    half = motion(recording(device(0, (1.0,), (2.0,))))
    assert half["peak_force_N"] == 2.0
    assert [half[key] for key in ("free_rms_m", "contact_rms_m", "peak_penetration_m", "contacts")] == [None] * 4
    half = motion(recording(world(0, (1.0,), 0.5)))
    assert half["contacts"] == 1
    assert [half[key] for key in ("free_rms_m", "contact_rms_m", "peak_force_N")] == [None] * 3
    assert set(motion(recording()).values()) == {None}


def test_no_position_error_between_clocks_that_are_not_aligned() -> None:
    run = recording(world(0, (0.0,), -1.0), device(0, (1.0,), (2.0,)))
    assert motion(run)["free_rms_m"] == 1.0
    apart = motion(replace(run, meta={**run.meta, "aligned": False}))
    assert apart["free_rms_m"] is None
    assert apart["peak_force_N"] == 2.0
