"""Wave variables over a delay line: its queue, and where the law is passive and where not."""

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet.control.coupling import WaveSample
from hapnet.couplings.link_delays import Delays
from hapnet.couplings.registry import COUPLINGS
from hapnet.ext.laws.digital_wave import Replay
from hapnet.ext.laws.parts import wave_port
from hapnet.ext.laws.wave import MOST, DelayLine
from hapnet.params import Params
from hapnet.simulation.simulation import Simulation
from tests.conftest import mostly_slow
from tests.support.processes import read_json, started
from tests.support.wave_ports import Counted, put_in, shake

TOLERANCE_J = 1e-9


# -- the queue -------------------------------------------------------------------------------------------------------


def test_each_wave_is_used_once_in_unequal_slots() -> None:
    """Also those that come out of order: displacement that came in comes out, no more, no less."""
    for seed in range(5):
        line = Counted(DelayLine(1, 100.0))
        shake(line, seed, seconds=1.5, jitter=0.1)  # too short a time to find the queue too long
        for _ in range(1000):
            line.take(0.01)
        assert line.moved_out == pytest.approx(line.moved_in, rel=1e-12)


@pytest.mark.parametrize(("loss", "jitter"), [(0.0, 0.0), (0.0, 0.3), (0.3, 0.0), (0.3, 1.0), (0.5, 1.0)])
@pytest.mark.parametrize(
    ("line", "passes"),
    [
        (partial(DelayLine, 1, 0.3), 0.2),
        (partial(DelayLine, 1, 0.1, recovery=0.05), 0.2),  # which plays later what it had to drop
        (partial(Replay, 1, 0.08), 0.04),
    ],
    ids=["queue", "queue that recovers", "digital"],
)
def test_no_more_energy_comes_out_than_came_in(line: Any, passes: float, loss: float, jitter: float) -> None:
    """At every instant, also while a queue that has grown too long is played faster, or drops."""
    for seed in range(2):
        counted = Counted(line())
        shake(counted, seed, seconds=10.0, loss=loss, jitter=jitter)
        assert counted.spare >= -TOLERANCE_J
        assert counted.went > passes * counted.came * (1.0 - loss)


def test_holding_the_last_wave_gives_energy_from_nothing() -> None:
    line = Counted(DelayLine(1, 0.3, hold=True))
    line.push(WaveSample((1.0,), 0.02))
    for _ in range(100):
        line.take(0.001)
    assert line.spare == pytest.approx(-0.5 * 0.08)  # played for 100 ms, paid for 20


def test_irregular_periods_become_one_exact_delay() -> None:
    """After the longest period T, the wave of every instant comes T later: nothing is missing, nothing changes."""
    spans = [10, 30, 50, *np.random.default_rng(2).integers(10, 51, size=30).tolist()]  # ms
    line = DelayLine(1, 1.0)
    ends = np.cumsum(spans)
    expected = np.repeat(np.arange(1.0, len(spans) + 1.0), spans)
    got = []
    for tick in range(ends[-1]):
        for index in np.flatnonzero(ends == tick):
            line.push(WaveSample((float(index + 1),), spans[index] * 1e-3))
        got.append(line.take(0.001)[0])
    settled = ends[2]
    assert got[settled : ends[-1]] == pytest.approx(expected[settled - 50 : ends[-1] - 50], abs=1e-9)


def test_a_wait_that_is_not_needed_any_more_is_shortened() -> None:
    line = DelayLine(1, 1.0)
    for _ in range(40):
        line.push(WaveSample((1.0,), 0.02))  # an outage is over
    waits = []
    for tick in range(20_000):
        if tick % 20 == 0:
            line.push(WaveSample((1.0,), 0.02))
        assert line.take(0.001)[0] <= np.sqrt(2.0) + 1e-12
        waits.append(line.waiting)
    assert waits[0] > 0.8
    assert max(waits[10_000:]) < 0.03


@pytest.mark.parametrize("pace", [1.01, 1.1])
def test_a_faster_clock_does_not_make_the_queue_grow(pace: float) -> None:
    line = Counted(queue := DelayLine(1, 0.3))
    for tick in range(60_000):
        if tick % 20 == 0:
            line.push(WaveSample((1.0,), 0.02 * pace))
        line.take(0.001)
        assert queue.waiting < 0.3
    assert line.spare >= -TOLERANCE_J
    assert line.moved_out > 59.0  # the world's motion is not lost but for what its clock is wrong


def test_what_waits_too_long_is_dropped_the_oldest_first() -> None:
    line = DelayLine(1, 0.1)
    for number in range(10):
        line.push(WaveSample((float(number),), 0.02))
    assert line.waiting == pytest.approx(0.1)
    assert line.take(0.02) == pytest.approx((5.0,))
    for _ in range(5000):
        line.push(WaveSample((1.0,), 1e-9))
    assert line.waiting < 0.1
    line.push(WaveSample((1.0,), 10.0))
    assert line.take(0.02) == (0.0,)


def test_a_queue_that_is_played_faster_loses_no_energy_of_equal_waves() -> None:
    """Cauchy and Schwarz are equal for what is constant: S seconds of it in dt < S come out sqrt(S/dt) as strong."""
    line = DelayLine(1, 20.0)
    for _ in range(600):
        line.push(WaveSample((2.0,), 0.02))
    faster = 0
    for _ in range(5_000):
        before = line.waiting
        (out,) = line.take(0.001)
        took = before - line.waiting
        assert out * out * 0.001 == pytest.approx(4.0 * took, rel=1e-9)
        faster += took > 0.0015
    assert faster > 500


def test_as_many_waves_wait_as_may_and_no_more() -> None:
    """Of spans that are exact in binary: a wait that is just the longest stays, and so does the last that may wait."""
    line = DelayLine(1, 0.125)
    for number in range(4):
        line.push(WaveSample((float(number),), 0.03125))
    assert line.waiting == 0.125
    assert line.take(0.03125) == (0.0,)
    line = DelayLine(1, 10.0)
    for number in range(MOST):
        line.push(WaveSample((float(number),), 2.0**-10))
    assert line.waiting == MOST * 2.0**-10
    line.push(WaveSample((float(MOST),), 2.0**-10))
    assert line.waiting == MOST * 2.0**-10
    assert line.take(2.0**-10) == (1.0,)  # the oldest has gone


# -- the law's claim -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("delay", [0, 7, 40, 150])
def test_it_is_passive_for_any_constant_delay(delay: int) -> None:
    for seed in range(2):
        for time in (0.05, 0.3):
            assert put_in(DelayLine(1, 0.3), DelayLine(1, 0.3), seed, delay=delay, time=time, seconds=3.0).lowest >= (
                -TOLERANCE_J
            )


@pytest.mark.parametrize("loss", [0.1, 0.5])
def test_with_zero_for_what_is_missing_it_is_passive_on_any_link(loss: float) -> None:
    for seed in range(2):
        result = put_in(DelayLine(1, 0.3), DelayLine(1, 0.3), seed, jitter=35, loss=loss, seconds=3.0)
        assert result.lowest >= -TOLERANCE_J


class Newest:
    """The line of a slow world that takes the newest wave for the whole step, as one often sees it written."""

    def __init__(self) -> None:
        self.wave: tuple[float, ...] = (0.0,)

    def push(self, wave: WaveSample) -> None:
        self.wave = wave.value

    def take(self, dt: float) -> tuple[float, ...]:
        return self.wave

    def clear(self) -> None: ...


def test_a_slow_world_that_takes_the_newest_wave_over_many_slots_is_not_passive() -> None:
    line: wave_port.WaveReceiver = Newest()
    lowest = [put_in(DelayLine(1, 0.3), line, seed, time=0.3).lowest for seed in range(4)]
    assert min(lowest) < -5e-3


def params(**changes: object) -> Params:
    base = {"coupling": "wave", "duration_s": 4.0, "link.up": "lan", "link.down": "lan"}
    return Params().set({**base, **{name.replace("__", "."): value for name, value in changes.items()}})


def lowest(params: Params, seed: int = 0) -> float:
    simulation = Simulation(params, seed)
    simulation.run()
    return simulation.two_port.lowest


@pytest.mark.parametrize("link", ["ideal", "4g", "wan-intercontinental", "delay 40ms 10ms loss 30%"])
@pytest.mark.parametrize("operator", ["press", "sine"])
def test_whole_runs_are_passive(link: str, operator: str) -> None:
    assert lowest(params(link__up=link, link__down=link, operator=operator)) >= -TOLERANCE_J


@pytest.mark.parametrize(("missing", "passive"), mostly_slow([("zero", True), ("hold", False)], 1))
def test_holding_the_last_wave_is_not_passive_where_waves_are_lost(missing: str, passive: bool) -> None:
    """The downlink fails while the hand is pressed on the wall: a held wave keeps pushing while the hand gives way."""
    margin = lowest(params(wave__missing=missing, link__down_timeline="at 1.8s: down", duration_s=6.0))
    if passive:
        assert margin >= -TOLERANCE_J
    else:
        assert margin < -0.01


# -- its rule, and whole programs ------------------------------------------------------------------------------------


def test_the_rule() -> None:
    tune = COUPLINGS["wave"].tune
    delays = Delays(0.035, 0.118)
    by_rule = tune(params(device__stiffness=100.0), delays)
    assert by_rule.impedance_Ns_m == 5.0
    assert by_rule.damping_Ns_m == 5.0
    assert by_rule.stiffness_N_m == pytest.approx(1000.0)  # the line alone is softer than device.stiffness
    assert by_rule.longest_wait_s == pytest.approx(0.3)
    stiff = tune(params(device__stiffness=100.0, wave__impedance=50.0), delays)
    wait = 0.035 + 0.05 + 0.048
    assert 1.0 / stiff.stiffness_N_m + wait / 50.0 == pytest.approx(1.0 / 100.0)
    own = tune(params(device__stiffness=100.0, wave__stiffness=300.0, wave__damping=2.0), delays)
    assert (own.stiffness_N_m, own.damping_Ns_m) == (300.0, 2.0)


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("coupling", "more"),
    mostly_slow([("wave", ("--realtime",)), ("digital-wave", ())], 0, 1),
    ids=["wave-realtime", "digital-wave"],
)
def test_two_processes_over_zenoh(coupling: str, more: tuple[str, ...], tmp_path: Path) -> None:
    out = tmp_path / "run"
    with started(
        "run", "--coupling", coupling, "--duration", 3, "--seed", 1, "--json", "-", "--out", out, *more
    ) as run:
        code, stdout, stderr = run.end()
        assert not run.alive
    assert code == 0, stderr
    summary = json.loads(stdout)
    assert summary["coupling"] == coupling
    assert summary["theorem"]["margin_J"] >= 0.0
    assert summary["motion"]["contacts"] >= 1
    assert summary["motion"]["peak_force_N"] > 0.1
    assert summary["links"]["up"]["delivered"] > 500
    assert summary == read_json(out / "summary.json")
