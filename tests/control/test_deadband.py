"""What a deadband lets through: Weber's law by hand, waves' sums, and what it saves and costs in whole runs."""

import math
import random
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from hapnet.assembly.build import prepare
from hapnet.control.coupling import CouplingSample, MotionSample, PortSample, WaveSample
from hapnet.control.deadband import MAX_S, MIN_M, MIN_MPS, MIN_N, MIN_WAVE, Deadband
from hapnet.errors import InvalidParameter
from hapnet.params import Params
from hapnet.simulation.simulation import Result, Simulation
from tests.conftest import mostly_slow

HERE = (0.0,)


def sent(
    band: Deadband, data: list[CouplingSample], opposite: tuple[float, ...] = HERE, period_s: float = 1e-3
) -> list[int]:
    """Which of these, a period apart, are sent."""
    return [i for i, sample in enumerate(data) if band.offer(i * period_s, sample, opposite) is not None]


def test_a_position_is_sent_when_its_spring_would_change_by_more_than_the_fraction() -> None:
    """The spring ends at 0. Sent 10 mm; 10.9 and 9.1 mm are within a tenth of it, 11.1 is not; then a tenth of that."""
    mm = [10.0, 10.9, 9.1, 11.1, 12.1, 12.3, 0.0, 0.01]
    assert sent(Deadband(0.1), [(1e-3 * x,) for x in mm]) == [0, 3, 5, 6]


def test_a_spring_of_several_axes_has_a_ball() -> None:
    """5 mm from where it ends: any direction of more than half a millimetre counts, less does not."""
    start, angle = (3e-3, 4e-3, 0.0), 0.7
    for radius, passes in ((0.49e-3, False), (0.51e-3, True)):
        there = (start[0] + radius * math.cos(angle), start[1], radius * math.sin(angle))
        assert (sent(Deadband(0.1), [start, there], (0.0, 0.0, 0.0)) == [0, 1]) is passes


def test_near_zero_force_what_is_too_small_to_feel_is_not_sent() -> None:
    at_rest: list[CouplingSample] = [(0.0,), (0.9 * MIN_M,), (-0.9 * MIN_M,), (1.1 * MIN_M,)]
    assert sent(Deadband(0.1), at_rest) == [0, 3]


def test_the_minima_are_of_a_force_that_nobody_feels() -> None:
    """5 mN: of a spring of 100 N/m, but more than a count of 55 um; of 5 Ns/m; of a wave f/sqrt(2b) with 3 Ns/m."""
    assert MIN_N == 0.005
    assert 55e-6 < MIN_M == pytest.approx(MIN_N / 100.0, rel=0.21)
    assert pytest.approx(MIN_N / 5.0) == MIN_MPS
    assert pytest.approx(MIN_N / math.sqrt(2.0 * 3.0), rel=0.03) == MIN_WAVE
    assert Params().device.silence_after_s / 5.0 == MAX_S


def test_just_the_fraction_or_the_minimum_is_not_felt_yet() -> None:
    """In quarters, so that nothing is rounded."""
    for first, second in ((1.0, 1.25), (0.0, MIN_M)):
        assert sent(Deadband(0.25), [(first,), (second,)]) == [0]
    for first, second in ((1.0, 1.25), (0.0, MIN_WAVE)):
        assert sent(Deadband(0.25), [WaveSample((first,), 1e-3), WaveSample((second,), 1e-3)]) == [0]


def test_a_motion_is_sent_for_its_position_or_its_velocity() -> None:
    def motion(mm: float, mm_s: float) -> MotionSample:
        return MotionSample((1e-3 * mm,), (1e-3 * mm_s,))

    moving: list[CouplingSample] = [motion(10, 100), motion(10.9, 109), motion(10, 111), motion(11.1, 111)]
    assert sent(Deadband(0.1), moving) == [0, 2, 3]
    still: list[CouplingSample] = [motion(10, 0), motion(10, 0.9e3 * MIN_MPS), motion(10, 1.1e3 * MIN_MPS)]
    assert sent(Deadband(0.1), still) == [0, 2]


def test_a_port_is_sent_for_what_it_shows_its_energy_waits() -> None:
    forces: list[CouplingSample] = [
        PortSample((1.0,), 0.0),
        PortSample((1.09,), 5.0),
        PortSample((1.11,), 6.0),
        PortSample((0.0,), 7.0),
    ]
    assert sent(Deadband(0.1, port="force"), forces) == [0, 2, 3]
    assert sent(Deadband(0.1, port="force"), [PortSample((0.0,), 0.0), PortSample((0.9 * MIN_N,), 9.0)]) == [0]
    positions: list[CouplingSample] = [PortSample((0.01,), 0.0), PortSample((0.0109,), 5.0), PortSample((0.0111,), 6.0)]
    assert sent(Deadband(0.1), positions) == [0, 2]


def test_a_wave_is_sent_with_those_that_waited() -> None:
    """Sent 1; 1.05 waits; 1.2 does not: the mean of 1.05 over 2 ms and 1.2 over 4 ms is 1.15 over 6."""
    band = Deadband(0.1)
    assert band.offer(0.0, WaveSample((1.0,), 2e-3), HERE) == WaveSample((1.0,), 2e-3)
    assert band.offer(0.002, WaveSample((1.05,), 2e-3), HERE) is None
    merged = band.offer(0.006, WaveSample((1.2,), 4e-3), HERE)
    assert isinstance(merged, WaveSample)
    assert merged.value == pytest.approx((1.15,))
    assert merged.span == pytest.approx(6e-3)
    assert band.held_back == 1
    assert sent(Deadband(0.1), [WaveSample((0.0,), 1.0), WaveSample((0.9 * MIN_WAVE,), 1.0)]) == [0]


vectors = st.tuples(st.floats(-10.0, 10.0), st.floats(-10.0, 10.0))


@settings(deadline=None)
@given(st.floats(0.01, 1.0), st.lists(st.tuples(vectors, st.floats(1e-3, 0.05)), min_size=1, max_size=60))
def test_of_waves_nothing_is_lost_and_no_energy_made(fraction: float, waves: list[tuple[Any, float]]) -> None:
    """At every instant: what went out has no more energy than what came in; and when all is out, the same integral."""
    band, now = Deadband(fraction), 0.0
    into, out = np.zeros(2), np.zeros(2)
    energy_in = energy_out = 0.0
    for value, span in waves:
        now += span
        into += span * np.array(value)
        energy_in += span * float(np.dot(value, value))
        done = band.offer(now, WaveSample(value, span), (0.0, 0.0))
        if isinstance(done, WaveSample):
            out += done.span * np.array(done.value)
            energy_out += done.span * float(np.dot(done.value, done.value))
            np.testing.assert_allclose(out, into, rtol=1e-12, atol=1e-12)
        assert energy_out <= energy_in * (1.0 + 1e-12)


def test_whatever_rests_is_sent_every_tenth_of_a_second_all_the_same() -> None:
    data: list[CouplingSample] = [(0.01,)] * 1000
    assert sent(Deadband(1.0), data) == list(range(0, 1000, round(MAX_S / 1e-3)))


def test_another_peer_is_told_at_once_and_not_what_the_first_one_missed() -> None:
    band = Deadband(0.5)
    assert sent(band, [WaveSample((1.0,), 1e-3), WaveSample((1.1,), 1e-3)]) == [0]
    band.on_peer_changed()
    assert band.offer(3e-3, WaveSample((1.2,), 1e-3), HERE) == WaveSample((1.2,), 1e-3)


def test_any_stream_by_another_way_of_counting() -> None:
    """Against the rule written out over whole arrays, for a random walk in three dimensions."""
    rng = np.random.default_rng(1)
    x = np.cumsum(rng.normal(0.0, 2e-4, (3000, 3)), axis=0)
    opposite = x + rng.normal(0.0, 3e-3, (3000, 3))
    expected, last, when = [], x[0], -1.0
    for i in range(3000):
        change = float(np.linalg.norm(x[i] - last))
        felt = float(np.linalg.norm(opposite[i] - last))
        if i == 0 or change > max(0.2 * felt, MIN_M) or i - when >= 100:
            expected.append(i)
            last, when = x[i], i
    band = Deadband(0.2)
    done = [i for i in range(3000) if band.offer(i * 1e-3, tuple(x[i]), tuple(opposite[i])) is not None]
    assert done == expected
    assert 0.1 * 3000 < len(done) < 0.9 * 3000


@pytest.mark.parametrize("fraction", [0.0, -0.1, 1.1, math.nan, math.inf])
def test_a_fraction_out_of_range_is_named(fraction: float) -> None:
    with pytest.raises(InvalidParameter, match="deadband"):
        Deadband(fraction)


def test_a_time_out_of_range_is_named() -> None:
    with pytest.raises(InvalidParameter, match="longest_s"):
        Deadband(0.1, longest_s=0.0)


# -- whole runs in virtual time --------------------------------------------------------------------------------------


def run(seed: int = 1, **changes: Any) -> tuple[Simulation, Result]:
    words = {name.replace("__", "."): value for name, value in changes.items()}
    simulation = Simulation(Params().set({"duration_s": 2.5, **words}), seed)
    return simulation, simulation.run()


def messages(simulation: Simulation) -> int:
    """Of both streams."""
    sides = (simulation.device_endpoint, simulation.world_endpoint)
    return sum(side.session.positions.next_sequence for side in sides)


def cases(count: int) -> list[dict[str, object]]:
    rng = random.Random(7)
    links = ("delay 0", "delay 40ms 10ms loss 2%", "delay 100ms 60ms loss 20% reorder 10%", "delay 20ms loss 60%")
    return [
        {
            "seed": seed,
            "wire__deadband": rng.choice((0.01, 0.1, 0.3, 1.0)),
            "link__up": rng.choice(links),
            "link__down": rng.choice(links),
            "operator": rng.choice(("press", "sine")),
            "device__shuffle": rng.choice(("harvested", "all")),
            "world__shuffle": "harvested",
        }
        for seed in range(count)
    ]


def assert_passive(case: dict[str, Any]) -> None:
    _, result = run(**case)
    assert result.summary["theorem"]["margin_J"] >= 0.0
    for side in ("device", "world"):
        assert result.summary[side]["ledger"]["slack_J"] >= -1e-9
        assert result.summary[side]["reservoir_min_J"] >= 0.0
    flows = result.summary["energy"]
    if "60%" not in case["link__up"] + case["link__down"]:  # else the last repetition, or its answer, may be lost
        assert all(flows[way]["in_flight_nJ"] == 0 for way in ("up", "down")), "surplus stayed behind"


@pytest.mark.parametrize("case", mostly_slow([(one,) for one in cases(8)], 1), ids=str)
def test_set_position_modulation_is_passive_with_any_deadband(case: dict[str, Any]) -> None:
    assert_passive(case)


@pytest.mark.parametrize("case", mostly_slow(cases(120), 0, 6), ids=str)
def test_set_position_modulation_is_passive_with_any_deadband_at_length(case: dict[str, Any]) -> None:
    assert_passive({**case, "duration_s": 10.0})


def test_with_no_deadband_nothing_decides() -> None:
    simulation, _ = run(duration_s=0.1)
    assert simulation.device_endpoint.deadband is simulation.world_endpoint.deadband is None


def test_a_tenth_saves_most_messages_and_costs_less_than_a_tenth_of_the_force() -> None:
    """Over one constant delay, so that the same is lost in both runs: nothing."""
    link: dict[str, Any] = {"link__up": "delay 40ms", "link__down": "delay 40ms"}
    (all_of_it, whole), (some, part) = run(**link), run(**link, wire__deadband=0.1)
    assert messages(some) < 0.35 * messages(all_of_it)
    force = np.asarray(whole.recording.device["force_N"])
    error = np.asarray(part.recording.device["force_N"]) - force
    assert 0.0 < np.sqrt(np.mean(error**2)) < 0.05 * np.sqrt(np.mean(force**2))


@pytest.mark.parametrize("servo", ["continuous", "sampled"])
def test_the_energy_that_is_shuffled_is_not_held_back(servo: str) -> None:
    """With the widest band, most ticks that shuffle send no position; the energy goes all the same, and as soon."""
    simulation, result = run(rendering="paper", operator="sine", wire__deadband=1.0, device__servo=servo)
    up = result.summary["energy"]["up"]
    assert up["sent_nJ"] == up["credited_nJ"] > 1_000_000
    whole, _ = run(rendering="paper", operator="sine", device__servo=servo)
    assert messages(simulation) < 0.3 * messages(whole)
    energy = [s.up.stats.offered - s.device_endpoint.session.positions.next_sequence for s in (simulation, whole)]
    assert energy[0] > 0.8 * energy[1]


@pytest.mark.parametrize("silence_s", [0.5, 0.1])
def test_nobody_who_rests_is_taken_for_silent(silence_s: float) -> None:
    """Steps of 15 ms at most leave three chances or more in the time that counts; in this seed one is heard."""
    silence: dict[str, Any] = {f"{side}__silence_after_s": silence_s for side in ("device", "world")}
    steps: dict[str, Any] = {"world__step_min_s": 0.005, "world__step_max_s": 0.015}
    link = "delay 20ms loss 10%"
    simulation, result = run(
        operator="rest", scene="free", wire__deadband=1.0, link__up=link, link__down=link, **silence, **steps
    )
    assert result.summary["device"]["outages"]["count"] == result.summary["world"]["outages"]["count"] == 0
    assert simulation.device_endpoint.session.positions.next_sequence == pytest.approx(2.5 / (silence_s / 5), rel=0.2)


def test_the_fraction_is_a_parameter_with_a_range() -> None:
    with pytest.raises(InvalidParameter, match=r"wire\.deadband"):
        Params().set({"wire.deadband": 1.5})
    assert prepare(Params().set({"wire.deadband": 1.0})).params.wire.deadband == 1.0
