"""Pairs that vibrate, each with one cause put in: it is named, and what is advised stops it."""

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapnet import cli, simulate
from hapnet.errors import RecordingError
from hapnet.ext.doctor.pair import FELT_N, examine_pair, measured
from hapnet.ext.doctor.pair_bounds import LinearRobot, Loop, held_loop, largest_stiffness, smallest_rate
from hapnet.ext.laws.bilateral.pf import force_reflection_limit
from hapnet.params import RELAXED_HAND
from hapnet.recording.mcap import save
from hapnet.simulation.result import Result
from tests.conftest import mostly_slow

PAIR: dict[str, object] = {
    "follower.robot": "simulated", "device.servo": "sampled", "duration_s": 4.5, "link.up": "ideal",
    "link.down": "ideal", "operator": "press", "operator_model.hold_s": 9.0, **RELAXED_HAND, "device.mass": 0.5,
    "device.stiffness": 500.0, "device.damping": 2.0, "follower.mass": 0.5, "follower.own_damping": 1.0,
    "world.stiffness": 1000.0, "world.damping": 20.0, "follower.force_limit_N": 40.0,
}  # fmt: skip
LIGHT: dict[str, object] = {"device.mass": 0.1, "device.damping": 0.5}


def over(ms: int) -> dict[str, object]:
    return {"link.up": f"delay {ms}ms", "link.down": f"delay {ms}ms"}


GOOD: dict[str, dict[str, object]] = {
    "pp": {}, "pf": {}, "four-channel": {"follower.friction_N": 0.1}, "pspm": {"rendering": "paper"},
}  # fmt: skip
BAD: dict[str, tuple[str, str, dict[str, object]]] = {
    "delay": ("pp", "device.stiffness", {"device.stiffness": 900.0, **over(100), **LIGHT}),
    "stiffness": ("pp", "device.stiffness", {"device.stiffness": 8000.0, "device.damping": 0.1, "device.mass": 0.1,
                  "device.force_limit_N": 0.0, "device.step_limit_N": 0.0}),
    "rate": ("pp", "follower.servo_hz", {"follower.servo_hz": 100.0, "world.stiffness": 8000.0, "world.damping": 30.0,
             "follower.step_limit_N": 0.0, "follower.force_limit_N": 0.0, "scene": "free"}),
    "friction": ("four-channel", "bilateral.friction_known", {"follower.friction_N": 0.5,
                 "bilateral.friction_known": 2.5}),
}  # fmt: skip
MORE: dict[str, tuple[str, str, dict[str, object]]] = {
    "a contact over a delay": ("pf", "device.damping", {**over(30), **LIGHT}),
    "accelerations over a delay": ("four-channel", "bilateral.position_gain", {
        "bilateral.position_gain": 2500.0, "device.mass": 0.1, "device.stiffness": 900.0, "duration_s": 6.0,
        **over(100)}),
}  # fmt: skip


def run(law: str, changes: Mapping[str, object], seed: int = 1) -> Result:
    return simulate({**PAIR, "coupling": law, **changes}, seed)


@pytest.mark.parametrize("law", mostly_slow([(law,) for law in GOOD], 1))
def test_of_a_good_pair_it_says_that_nothing_vibrates(law: str) -> None:
    (check,) = examine_pair(run(law, GOOD[law]))
    assert check.state == "ok"
    assert check.value.startswith("no vibration")


@pytest.mark.parametrize("name", BAD)
def test_each_cause_is_named_and_its_advice_stops_the_vibration(name: str) -> None:
    _stops(name.partition(" ")[0], *BAD[name])


@pytest.mark.slow
@pytest.mark.parametrize("name", MORE)
def test_so_it_is_with_other_laws(name: str) -> None:
    _stops("delay", *MORE[name])


def _stops(name: str, law: str, parameter: str, changes: Mapping[str, object]) -> None:
    found = run(law, changes)
    pair, (check,) = measured(found), examine_pair(found)
    cause = pair.cause()
    assert cause is not None
    assert cause.name == name
    assert list(cause.settings) == [parameter]
    assert check.state == "warning"
    assert f"; {name}: " in check.value
    assert f"--set {parameter}=" in check.advice
    assert pair.vibration.amplitude_N > 2.0 * FELT_N
    after = measured(run(law, {**changes, **cause.settings}, seed=2)).vibration
    assert after.amplitude_N < min(FELT_N, 0.2 * pair.vibration.amplitude_N)


@pytest.mark.slow
def test_behind_pspm_the_vibration_dies_as_its_energy_is_used_up() -> None:
    _, _, changes = BAD["delay"]
    long = {**changes, "duration_s": 8.0}
    bare, behind = (measured(run("pp", {**long, "bilateral.port": port})) for port in ("bare", "pspm"))
    assert bare.vibration.amplitude_N > 2.0
    assert behind.vibration.amplitude_N < FELT_N


@pytest.mark.parametrize("friction", [0.3])
def test_it_measures_friction_and_contact_of_the_follower(friction: float) -> None:
    pair = measured(run("pp", {"follower.friction_N": friction, "scene": "wall"}))
    assert pair.friction_N == pytest.approx(friction, abs=0.01)
    assert pair.contact_N_m == pytest.approx(3000.0, rel=0.05)
    assert pair.round_trip_s < 0.01


def test_it_is_a_command_on_a_finished_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, _, changes = BAD["friction"]
    save(run("four-channel", changes).recording, tmp_path / "run.mcap")
    assert cli.main(["doctor", "--pair", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert len(shown.splitlines()) == 1
    assert "friction: 1.25 N are taken for known, 0.5 N were measured" in " ".join(shown.split())
    assert cli.main(["doctor", "--pair", str(tmp_path), "--json", "-"]) == 0
    (check,) = json.loads(capsys.readouterr().out)
    assert check["name"] == "pair"


def test_amplitude_and_frequency_are_those_of_the_forces_vibration() -> None:
    recording = run("pp", {}).recording
    assert recording.device is not None
    time_s = recording.device["time_s"]
    force = 2.0 + 0.3 * time_s + 0.7 * np.sin(2.0 * np.pi * 6.5 * time_s)
    shaken = replace(recording, device={**recording.device, "force_N": force[:, None]})
    amplitude, hz = measured(shaken).vibration
    assert amplitude == pytest.approx(0.7, rel=0.02)
    assert hz == pytest.approx(6.5, abs=0.25)


def test_behind_pspm_the_advice_is_not_pspm_again() -> None:
    _, _, changes = BAD["delay"]
    (check,) = examine_pair(run("pp", {**changes, "bilateral.port": "pspm"}))
    assert check.advice.startswith("--set device.stiffness=")
    assert "port" not in check.advice


def test_a_run_without_a_robot_is_refused() -> None:
    with pytest.raises(RecordingError, match=r"no run of a pair"):
        measured(simulate({"duration_s": 0.2}, seed=1))


# Bounds


def grows(robot: LinearRobot, ticks: int = 4000) -> bool:
    """Whether the held loop grows, in steps of a thousandth of a tick."""
    x, v, T = 1.0, 0.0, 1.0 / robot.servo_hz
    parts, sizes = 200, []
    for _ in range(ticks // 40):
        force = -robot.stiffness * x - robot.servo_damping * v
        for _ in range(parts):
            v += T / parts * (force - robot.damping * v) / robot.mass
            x += T / parts * v
        sizes.append(abs(x) + T * abs(v))
    return max(sizes[-20:]) > max(sizes[:20])


def test_the_held_loop_is_what_stepping_it_shows() -> None:
    rng = np.random.default_rng(3)
    seen = set()
    for _ in range(12):
        m, T = 10.0 ** rng.uniform(-1, 0.5), 10.0 ** rng.uniform(-3, -1.5)
        robot = LinearRobot(
            m, 0.2 * m, float(rng.uniform(0.1, 4.0)) * m / T**2, float(rng.uniform(0.3, 1.5)) * m / T, 1.0 / T
        )
        growth, _ = held_loop(robot)
        if abs(growth - 1.0) > 0.05:
            assert grows(robot) is (growth > 1.0)
            seen.add(growth > 1.0)
    assert seen == {True, False}


def test_an_undamped_handles_bound_is_twice_its_damper_over_the_tick() -> None:
    """With b = 0 the characteristic polynomial gives K T < 2 B (B T < 2 m); the rate that bears K follows."""
    robot = LinearRobot(2.0, 0.0, 1e5, 10.0, 1000.0)
    assert largest_stiffness(robot) == pytest.approx(2.0 * 10.0 * 1000.0, rel=1e-6)
    assert smallest_rate(robot) == pytest.approx(1.5 * 1e5 / (2.0 * 10.0), rel=1e-6)


@pytest.mark.parametrize("round_trip_s", [0.02, 0.1, 0.5])
def test_the_loops_limit_is_that_of_force_reflection(round_trip_s: float) -> None:
    """A stiff, fast follower: the contact at which it begins to grow is the published limit."""
    leader = LinearRobot(0.5, 0.3, 0.0, 2.0, 1000.0, 0.1, 0.5, 40.0)
    limit = force_reflection_limit(0.6, 2.8, 40.0, round_trip_s)
    for share, unstable in ((0.97, False), (1.03, True)):
        follower = LinearRobot(1e-3, 0.0, 1e6, 20.0, math.inf)
        assert Loop(leader, follower, round_trip_s, True, share * limit).unstable() is unstable


def test_small_gains_are_stable_for_any_delay() -> None:
    loop: dict[str, Any] = {"follower": LinearRobot(0.5, 1.0, 500.0, 20.0, 1000.0), "follows_velocity": False}
    for trip in (0.0, 0.05, 0.3, 1.0):
        assert not Loop(LinearRobot(0.1, 0.3, 1.0, 3.0, 1000.0, 0.1, 0.5, 40.0), round_trip_s=trip, **loop).unstable()
    stiff = Loop(LinearRobot(0.1, 0.3, 900.0, 0.5, 1000.0, 0.1, 0.5, 40.0), round_trip_s=0.2, **loop)
    assert stiff.unstable()
    K = stiff.largest_stiffness()
    assert not Loop(LinearRobot(0.1, 0.3, K, 0.5, 1000.0, 0.1, 0.5, 40.0), round_trip_s=0.2, **loop).unstable(1.49)
