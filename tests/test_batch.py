"""Batches give what `simulate` gives one at a time: the same bits with one axis, 1e-9 with more."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet import HapnetError, InvalidParameter, Params, cli, simulate, simulate_batch
from hapnet.simulation.batch import run as batch_run
from hapnet.simulation.batch.engine import Engine
from hapnet.simulation.batch.lines import longest_ns, shortest_ns
from hapnet.simulation.batch.run import SMALLEST
from hapnet.simulation.batch.scenario import BatchRun, Scenario
from netem import Link, LinkProfile
from tests.paper import PAPER
from tests.theorem_cases import random_case

SEEDS = range(6)
LIVELY = {"operator": "sine", "operator_hand.frequency_hz": 1.5, "device.damping": 2.0}
"""A hand that shakes: both sides harvest more than they keep."""


@pytest.fixture(autouse=True)
def small_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Vectorise also what is too small for it to pay."""
    monkeypatch.setattr(batch_run, "SMALLEST", 3)


def differences(expected: Any, found: Any, tolerance: float, path: str = "") -> list[str]:
    """Where two nested dictionaries differ; whole numbers and words exactly, whatever the tolerance."""
    if isinstance(expected, dict):
        assert expected.keys() == found.keys(), path
        return [d for key in expected for d in differences(expected[key], found[key], tolerance, f"{path}.{key}")]
    if isinstance(expected, float) and found is not None:
        near = expected == found or (math.isfinite(expected) and abs(expected - found) <= tolerance)
    else:
        near = expected == found
    return [] if near else [f"{path}: {expected} one at a time, {found} in a batch"]


def one_at_a_time(params: Params, seed: int) -> dict[str, Any]:
    result = simulate(params, seed)
    states: dict[str, Any] = {}
    mass = result.world.mass
    for name, side, (x, v) in (
        ("device", result.device, result.device.device.read()),
        ("world", result.world, (mass.position, mass.velocity)),
    ):
        modulator, ledger = side.coupling.modulator, side.coupling.ledger
        vectors = {"position_m": x, "velocity_mps": v, "set_position_m": modulator.set_position}
        states[name] = {f"{key}[{i}]": component for key, value in vectors.items() for i, component in enumerate(value)}
        states[name] |= {"reservoir_J": modulator.energy, "deficit_J": modulator.deficit, "work_J": ledger.work}
        states[name] |= {"credited_J": ledger.credited, "sent_J": ledger.sent}
    return {**result.summary, "motion": None, "path": None, "final": states}


def in_a_batch(run: BatchRun) -> dict[str, Any]:
    states: dict[str, Any] = {}
    for name, side in (("device", run.device), ("world", run.world)):
        states[name] = {}
        for key, value in side._asdict().items():
            parts = {f"{key}[{i}]": part for i, part in enumerate(value)} if isinstance(value, tuple) else {key: value}
            states[name] |= parts
    return {**run.summary, "motion": None, "path": None, "final": states}


def check(runs: list[BatchRun], tolerance: float = 0.0, *, vectorised: bool = True) -> None:
    for run in runs:
        assert run.vectorised == vectorised
        found = differences(one_at_a_time(run.params, run.seed), in_a_batch(run), tolerance)
        assert not found, (run.seed, found)


SLOW = {
    "no delay", "states, correlated delays", "heavy jitter", "everything shuffled", "other rates", "no limits",
    "geo and lan", "4g", "box", "zoh", "resends on one way", "paper, coupled axes", "uneven, decoupled",
    "damper limited", "resends, in order and not", "uneven, damper limited", "saturated", "a slow line, reordering",
    "uneven, saturated, short of energy",
}  # fmt: skip
"""What the default run leaves to the long one."""


def cases(table: dict[str, dict[str, object]]) -> list[Any]:
    """Of a table by names."""
    return [pytest.param(each, id=name, marks=[pytest.mark.slow] * (name in SLOW)) for name, each in table.items()]


ONE_AXIS: dict[str, dict[str, object]] = {
    "default": {},
    "no delay": {"link.up": "", "link.down": ""},
    "bursts and reordering": {
        "link.up": "delay 20ms reorder 20% 30% gap 3 loss 5% 40%",
        "link.down": "delay 15ms 15ms distribution pareto loss gemodel 5% 20%",
    },
    "states, correlated delays": {
        "link.up": "delay 30ms 20ms 60% distribution normal loss state 3% 30% 10% 50% 1%",
        "link.down": "delay 50ms 5ms 30% reorder 10%",
    },
    "heavy jitter": {
        **LIVELY,
        "duration_s": 3.0,
        "link.up": "delay 200ms 150ms distribution normal loss 20%",
        "link.down": "delay 150ms 100ms loss gemodel 5% 10%",
    },
    "small reservoirs": {
        **LIVELY, "device.ceiling_J": 5e-4, "world.ceiling_J": 2e-4, "link.up": "delay 60ms 20ms loss 10%",
    },
    "everything shuffled": {**LIVELY, "device.shuffle": "all", "world.shuffle": "all", "link.down": "delay 3ms 2ms"},
    "admission": {**LIVELY, "wire.admission_W": 0.02, "wire.admission_burst_J": 0.001},
    "saturated": {
        **LIVELY, "device.force_limit_N": 4.0, "device.spring_share": 0.2, "world.step_limit_N": 5.0,
        "link.down": "delay 100ms",
    },
    "damper limited": {
        **LIVELY, "device.damping": 20.0, "device.stiffness": 400.0, "device.force_limit_N": 0.8,
        "duration_s": 0.8, "link.up": "delay 20ms",
    },
    "no limits": {"device.force_limit_N": 0.0, "device.step_limit_N": 0.0, "world.step_limit_N": 0.0, "scene": "free"},
    "zoh": {"coupling": "zoh", "link.up": "delay 80ms 20ms", "link.down": "delay 80ms 20ms"},
    "other rates": {**LIVELY, "device.servo_hz": 700.0, "device.substeps": 3, "world.step_min_s": 0.001},
    "many under way when it is loaded, not in their order": {
        **LIVELY, "duration_s": 0.4, "link.up": "delay 200ms 150ms loss 20%", "link.down": "delay 200us loss 10%",
        "device.pspm_period_s": 0.001,
    },
    "energy that is never answered": {
        **LIVELY, "duration_s": 0.7, "wire.hello_period_s": 0.003,
        "link.up": "delay 1ms loss 80%", "link.down": "delay 1ms loss 80%",
    },
    "steps within a tick": {
        "duration_s": 0.595, "device.servo_hz": 100.0, "world.step_min_s": 2e-4, "world.step_max_s": 2e-3,
    },
    "4g": {"link.up": "4g", "link.down": "4g"},
    "lossy-wifi": {**LIVELY, "link.up": "lossy-wifi", "link.down": "wifi"},
    "geo and lan": {**LIVELY, "link.up": "geo", "link.down": "lan"},
    "a slow line, reordering": {
        **LIVELY,
        "link.up": "delay 8ms 8ms reorder 5% rate 2mbit 20 48 5",
        "link.down": "delay 30ms loss 3% rate 1mbit",
    },
    "resends, in order and not": {
        **LIVELY,
        "link.up": "delay 20ms 3ms loss gemodel 10% 30% resend 3 8ms rate 2mbit",
        "link.down": "delay 15ms 5ms loss 20% 10% resend 2 7ms unordered",
    },
    "resends on one way": {"link.up": "5g", "link.down": "delay 20ms reorder 10% loss 5%"},
    "box": {**LIVELY, "scene": "box", "dof": 1, "world.wall.half_width_m": 0.01, "operator_hand.amplitude_m": 0.05},
}  # fmt: skip


@pytest.mark.parametrize("changes", cases(ONE_AXIS))
def test_one_axis_is_the_same_bit_for_bit(changes: dict[str, object]) -> None:
    check(simulate_batch(PAPER.set({"duration_s": 1.6, **changes}), SEEDS))


@pytest.mark.parametrize("name", ["bursts and reordering", "a slow line, reordering", "lossy-wifi", "small reservoirs"])
def test_the_state_that_it_gives_back_is_whole(name: str) -> None:
    """A scenario that leaves the batch half-way, and runs on as an ordinary simulation, ends bit for bit the same."""
    params = PAPER.set({"duration_s": 1.0, **ONE_AXIS[name]})
    scenarios = [Scenario(params, seed) for seed in range(2)]
    for scenario in scenarios:
        assert scenario.load()
        assert scenario.is_vectorised
    ends_ns = [scenario.end_ns for scenario in scenarios]
    for scenario in scenarios:
        scenario.end_ns = (scenario.now_ns + scenario.end_ns) // 2
    Engine(scenarios).run()
    for scenario, end_ns in zip(scenarios, ends_ns, strict=True):
        assert scenario.now_ns < end_ns
        scenario.end_ns = end_ns
        check([scenario.run_on(vectorised=True)])


def test_energy_flows_in_these_cases() -> None:
    runs = simulate_batch(PAPER.set({"duration_s": 2.0, **LIVELY}), SEEDS)
    assert all(run.summary["energy"][way]["credited_nJ"] > 1_000_000 for run in runs for way in ("up", "down"))
    assert all(run.summary["world"]["dropped"]["stale"] > 0 for run in runs)


def test_links_may_differ_within_a_batch() -> None:
    base = PAPER.set({"duration_s": 1.5, **LIVELY})
    several = [base.set({"link.up": words, "link.down": words}) for words in ("delay 35ms", "delay 5ms 5ms", "loss 5%")]
    runs = simulate_batch(several, range(3))
    assert [(run.params.link.up, run.seed) for run in runs] == [(p.link.up, s) for p in several for s in range(3)]
    check(runs)


SEVERAL_AXES: dict[str, dict[str, object]] = {
    "box": {**LIVELY, "scene": "box"},
    "paper, coupled axes": {
        **LIVELY,
        "scene": "paper",
        "device.stiffness": [[100.0, 20.0, 0.0], [20.0, 80.0, 5.0], [0.0, 5.0, 120.0]],
    },
    "uneven, saturated, short of energy": {
        "scene": "free",
        "dof": 2,
        "operator": "sine",
        "device.stiffness": [[100.0, 30.0], [30.0, 60.0]],
        "world.stiffness": [[500.0, 100.0], [100.0, 300.0]],
        "world.mass": [[0.02, 0.005], [0.005, 0.03]],
        "device.ceiling_J": 5e-4,
        "world.ceiling_J": 5e-4,
        "device.force_limit_N": 0.8,
        "link.down": "delay 80ms 30ms loss 5%",
    },
    "uneven, damper limited": {
        **LIVELY,
        "scene": "free",
        "dof": 2,
        "duration_s": 0.6,
        "device.stiffness": [[400.0, 100.0], [100.0, 300.0]],
        "device.damping": [20.0, 3.0],
        "device.force_limit_N": 0.8,
        "link.up": "delay 20ms",
    },
    "uneven, decoupled": {"scene": "box", "dof": 2, **LIVELY, "device.stiffness": [100.0, 60.0]},
}


@pytest.mark.parametrize("changes", cases(SEVERAL_AXES))
def test_several_axes_are_the_same_to_rounding(changes: dict[str, object]) -> None:
    check(simulate_batch(PAPER.set({"duration_s": 1.2, **changes}), SEEDS), 1e-9)


@pytest.mark.parametrize(
    "changes",
    [
        {"device.servo": "sampled"},
        {"device.smoothing_s": 0.005},
        {"world.on_silence": "release"},
        {"wire.accept_stale": True},
        {"wire.deadband": 0.1},
        {"link.down": "delay 20ms slot 5ms"},
        {"link.down": "delay 100ms limit 3"},
        {"link.down": "delay 5ms loss 20% resend 2 7ms unordered rate 5mbit"},
        {"link.up": "delay 5ms loss 20% resend 2 7ms reorder 10%"},
    ],
    ids=str,
)
def test_what_is_not_vectorised_is_simulated_alone(changes: dict[str, object]) -> None:
    check(simulate_batch(PAPER.set({"duration_s": 0.3, **changes}), SEEDS), vectorised=False)


def test_a_few_are_simulated_alone() -> None:
    check(simulate_batch(PAPER.set({"duration_s": 0.3}), [4, 2]), vectorised=False)


def test_runs_that_end_before_the_handshake_are_right_too() -> None:
    runs = simulate_batch(PAPER.set({"duration_s": 0.07}), range(20))
    assert {run.vectorised for run in runs} == {True, False}
    for run in runs:
        check([run], vectorised=run.vectorised)


def test_processes_share_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch_run, "SMALLEST", SMALLEST)  # as in the processes
    params = PAPER.set({"duration_s": 0.3})
    told: list[float] = []
    alone = simulate_batch(params, range(2 * SMALLEST), progress=told.append)
    assert simulate_batch(params, range(2 * SMALLEST), workers=2) == alone
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_nothing_is_refused_in_silence() -> None:
    with pytest.raises(InvalidParameter, match="workers"):
        simulate_batch(workers=0)
    with pytest.raises(HapnetError, match=r"seed 3: .*did not find each other"):
        simulate_batch(PAPER.set({"link.up": "loss 100%"}), [3])
    with pytest.raises(HapnetError, match="duration"):
        simulate_batch(PAPER.set({"duration_s": 0.0}))
    assert simulate_batch(PAPER, []) == []


@pytest.mark.parametrize("words", ["", "delay 40ms 10ms", "delay 5ms 9ms", "delay 9ms 3ms distribution paretonormal",
                                   "delay 40ms reorder 5%", "delay 4ms 1ms loss 30% resend 2 3ms",
                                   "delay 3ms 1ms 50% distribution normal"])  # fmt: skip
def test_the_bounds_of_a_delay_hold(words: str) -> None:
    profile = LinkProfile.parse(words)
    link: Link[int] = Link(profile, seed=1)
    for order in range(3000):
        link.send(0, order)
    delays = [due for due, _ in link.poll(10**12)]
    assert shortest_ns(profile) <= min(delays)
    assert max(delays) <= longest_ns(profile)


def test_the_command_prints_one_table_and_one_object_a_seed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "batch.json"
    assert cli.main(["simulate", "--feel", "paper", "--seeds", "3:13", "--duration", "0.3", "--json", str(file)]) == 0
    out = capsys.readouterr().out
    assert "came out of both ports, most" in out
    assert "credited down [mJ]" in out
    assert "of 10 scenarios 10 were passive, 0 were not" in out
    runs = json.loads(file.read_text("utf-8"))
    assert [run["seed"] for run in runs] == list(range(3, 13))
    assert all(np.isfinite(run["final"]["device"]["position_m"][0]) and run["vectorised"] for run in runs)


@pytest.mark.parametrize("words", ["5", "7:7", "9:2", "a:b", "-1:3"])
def test_seeds_are_a_range(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["simulate", f"--seeds={words}"]) == 2
    assert "--seeds" in capsys.readouterr().err


def test_many_seeds_write_no_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["simulate", "--seeds", "0:2", "--out", str(tmp_path / "runs")]) == 2
    assert "no --out with --seeds" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=pytest.mark.slow if case < 15 else pytest.mark.soak) for case in range(60)]
)
def test_random_cases(case: int) -> None:
    params = random_case(case, 2.0).set({"feel": "paper"})
    runs = simulate_batch(params, SEEDS)
    check(runs, 0.0 if len(runs[0].device.position_m) == 1 else 1e-9, vectorised=runs[0].vectorised)
