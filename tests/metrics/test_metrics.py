"""Metrics of motion, force and drift, against values computed by hand."""

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import signal

from hapnet.checks import Array
from hapnet.ext.metrics import METRICS
from hapnet.ext.metrics.force import buzz, force_error
from hapnet.ext.metrics.measured import Measured
from hapnet.ext.metrics.motion import drift
from hapnet.params import Params
from hapnet.plant.worlds.walls import Wall
from hapnet.recording.samples import MemoryRecorder, Recording
from hapnet.simulation.simulation import Simulation
from hapnet.summary.from_samples import motion
from netem import Link
from tests.support.metric_recordings import RATE_HZ, device, recording, sampled, world


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
    # each counts until the next: 1 s, 0.5 s and 2 s outside, 0.5 s and 0.5 s in contact
    assert result["free_rms_m"] == pytest.approx(math.sqrt((1.0 * 0.09 + 0.5 * 0.16) / 3.5), rel=1e-12)
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
        **dict.fromkeys(("free_rms_rad", "contact_rms_rad", "peak_torque_Nm")),
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


# -- force -----------------------------------------------------------------------------------------------------------


def test_the_force_error_is_taken_at_the_same_time_of_the_hand() -> None:
    """3 N against 0 along one axis and a sine of 4 N against none along the other: sqrt(9 + 8) N."""
    t = np.arange(4000) / RATE_HZ
    wave = 4.0 * np.sin(2.0 * np.pi * t)
    x = np.zeros((4000, 2))
    ours = sampled(x, np.column_stack([3.0 + t, wave]), origin_ns=7_000_000_000)
    ideal = sampled(x[:3500], np.column_stack([t, 0.0 * t])[:3500])
    found = force_error(ours, ideal)
    assert found is not None
    seconds = t[:3500]
    expected = math.sqrt(9.0 + float(np.mean((4.0 * np.sin(2.0 * np.pi * seconds)) ** 2)))
    assert found == pytest.approx((expected, 100.0 * expected / 3.499), rel=1e-9)
    assert force_error(ideal, ideal) == (0.0, 0.0)
    against_nothing = force_error(ours, sampled(x, 0.0 * x))
    assert against_nothing[1] is None
    assert force_error(ours, recording(world(0, (0.0,), 0.0))) is None


def test_the_share_of_a_small_peak() -> None:
    """0.1 N against a peak of 0.4 N are 25 %."""
    still, t = np.zeros((1000, 1)), np.arange(1000)
    reference = np.where(t == 500, 0.4, 0.0)[:, None]
    found = force_error(sampled(still, reference + 0.1), sampled(still, reference))
    assert found == pytest.approx((0.1, 25.0))


def test_the_buzz_of_sines() -> None:
    t = np.arange(10_000) / RATE_HZ
    still = np.zeros((len(t), 1))

    def power(force: Array) -> float | None:
        return buzz(sampled(np.zeros((len(t), 2)), force).device or {})

    fast, slow = 0.3 * np.sin(2.0 * np.pi * 137.3 * t), 2.0 * np.sin(2.0 * np.pi * 3.7 * t)
    assert power(np.column_stack([fast + slow + 5.0, 0.0 * t])) == pytest.approx(0.3**2 / 2.0, rel=1e-4)
    assert power(np.column_stack([fast, 0.5 * fast])) == pytest.approx(1.25 * 0.3**2 / 2.0, rel=1e-4)
    assert power(np.column_stack([slow + 5.0, slow])) == pytest.approx(0.0, abs=1e-7)
    noise = np.random.default_rng(1).normal(size=(len(t), 1))
    columns = sampled(still, noise).device
    assert columns is not None
    f, spectrum = signal.welch(noise[:, 0], RATE_HZ, "hann", nperseg=1000, noverlap=750)  # an independent one
    assert buzz(columns) == pytest.approx(float(spectrum[f > 20.0].sum() * (f[1] - f[0])), rel=1e-12)


def test_no_buzz_of_what_cannot_hold_it() -> None:
    t = np.arange(3000)
    columns = sampled(np.zeros((3000, 1)), np.ones((3000, 1))).device
    assert buzz({name: values[::30] for name, values in columns.items()}) is None  # 33 Hz
    assert buzz({name: values[:900] for name, values in columns.items()}) is None  # less than a second
    assert buzz({name: values[(t < 1500) | (t > 1700)] for name, values in columns.items()}) is None  # a gap


# -- drift -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lag_s", [0.0, 0.05, 0.25])
@pytest.mark.parametrize("mm_per_min", [0.0, 12.0, -60.0])
@pytest.mark.long
def test_the_drift_beneath_a_lag(mm_per_min: float, lag_s: float) -> None:
    """A proxy that lags by so much and slides away: only the sliding counts, over any part of a period."""
    t = np.arange(0.0, 9.3, 1.0 / RATE_HZ)
    slide = mm_per_min / 60e3 * t

    def hand(t: Array) -> Array:
        return 0.03 * np.sin(2.0 * np.pi * 0.47 * np.maximum(t, 0.0))

    run = sampled(hand(t)[:, None], np.zeros((len(t), 1)), proxy=(hand(t - lag_s) - slide)[:, None])
    found = drift(run, [])
    assert 60e3 * found == pytest.approx(mm_per_min, abs=0.5)


def test_an_outage_is_no_drift_and_contact_does_not_count() -> None:
    t = np.arange(0.0, 10.0, 1.0 / RATE_HZ)
    x = 0.03 * np.sin(np.pi * t)
    proxy = x - 0.006 / 60.0 * t  # 6 mm/min
    out = (t > 8.0) & (t < 8.8)
    proxy[out] = proxy[np.flatnonzero(out)[0]]
    inside = x > 0.015
    proxy[inside] = 0.015
    run = sampled(x[:, None], np.zeros((len(t), 1)), proxy[:, None], np.where(inside, 1.0, -1.0))
    found = drift(run, [Wall((1.0,), 0.015, 3000.0)])
    assert 60e3 * found == pytest.approx(6.0, abs=1.0)


def test_no_drift_of_a_short_run() -> None:
    short = sampled(np.ones((4000, 1)), np.ones((4000, 1)))
    assert drift(short, []) is None
    assert drift(recording(device(0, (1.0,), (0.0,))), []) is None
    long = sampled(np.ones((9000, 1)), np.ones((9000, 1)))
    assert drift(long, []) == pytest.approx(0.0, abs=1e-12)
    assert drift(replace(long, meta={**long.meta, "aligned": False}), []) is None


def still(seconds: float, inside: Callable[[float], bool] = lambda t: False, x: float = 0.0) -> Recording:
    """A device and a proxy at `x` [m], sampled at 200 Hz for so long, the proxy in a wall when it is said so."""
    recorder = MemoryRecorder({"origin_ns": 0})
    for k in range(round(200 * seconds) + 1):
        at_ns = k * 5_000_000
        recorder.write(device(0.0, (x,), (0.0,))._replace(time_ns=at_ns))
        recorder.write(world(0.0, (x,), 1.0 if inside(at_ns * 1e-9) else 0.0)._replace(time_ns=at_ns))
    return recorder.recording()


def test_five_seconds_and_two_of_free_motion_are_enough_for_a_drift() -> None:
    """At 100 Hz, what ends at 5.005 s has its last at 5.00 s; of 0 to 1 s and 5 to 6 s, 200 or 199 count."""
    assert drift(still(5.005), []) == pytest.approx(0.0, abs=1e-12)
    assert drift(still(5.005, lambda t: t > 5.0025), []) == pytest.approx(0.0, abs=1e-12)  # what is last is not first
    assert drift(still(5.0), []) is None
    for end, known in ((4.9925, True), (5.0025, False)):

        def touches(t: float, end: float = end) -> bool:
            return 0.9925 < t < end

        assert (drift(still(6.0, touches), []) is not None) == known


def test_on_the_surface_of_a_wall_motion_is_free() -> None:
    wall = Wall((1.0,), 0.25, 3000.0)
    assert drift(still(6.0, x=0.25), [wall]) == pytest.approx(0.0, abs=1e-12)
    assert drift(still(6.0, x=0.2501), [wall]) is None


# -- the definitions -------------------------------------------------------------------------------------------------


def test_a_metrics_name_ends_in_its_unit() -> None:
    suffixes = {"J": "_J", "mm": "_mm", "%": "_percent", "N": "_N", "N²": "_N2", "ms": "_ms",
                "°": "_deg", "Nm": "_Nm", "mm/min": "_mm_per_min", "N/m": "_N_per_m",
                "1/s": "_per_s", "": ""}  # fmt: skip
    for name, metric in METRICS.items():
        assert name == metric.name
        assert name.endswith(suffixes[metric.unit])
        assert metric.heading == (f"{metric.label} [{metric.unit}]" if metric.unit else metric.label)
        assert not metric.meaning[0].isupper()


def test_packets_are_all_messages_that_were_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside an own count of what is given to each link; the device sends more than the world, so no sign can swap."""
    sent, send = Counter[int](), Link.send

    def counted(link: Link[Any], now_ns: int, item: Any, size: int | None = None) -> None:
        sent[id(link)] += 1
        send(link, now_ns, item, size)

    monkeypatch.setattr(Link, "send", counted)
    params = Params().set({"duration_s": 4.0, "link.up": "delay 10ms loss 5%", "link.down": "delay 10ms"})
    simulation = Simulation(params, 1, motion_only=True, kernel=False)
    run = Measured(simulation.setup.params, simulation.run(), simulation.setup.scene)
    up, down = sorted(sent.values(), reverse=True)
    found = [METRICS[f"packets_{way}per_s"].find(run) for way in ("", "up_", "down_")]
    assert found == pytest.approx([(up + down) / 4.0, up / 4.0, down / 4.0])
