"""Hands that nothing was tuned on: PSPM must feel like the plain spring with the same stages, and be passive."""

import math
from typing import Any, NamedTuple

import numpy as np
import pytest

from hapnet.simulation.simulation import Result, simulate
from tests.conftest import mostly_slow
from tests.support.natural_hands import WALL_M

HANDS = "tests.support.natural_hands"
LINKS = ("wifi", "4g", "leo", "wan-intercontinental", "delay 120ms 10ms loss 1%")
FREE_M = 0.004
"""At this distance from the wall no contact can be felt [m]."""


class Felt(NamedTuple):
    """force_N : the 99th percentile of the force, free of contact. modulated : the share of the world's steps in which
    the energy did not suffice. free_mm : rms distance of hand and proxy, free of contact."""

    force_N: float
    modulated: float
    free_mm: float


def run(coupling: str, hand: str, link: str, duration_s: float, **more: Any) -> Result:
    changes = {
        "coupling": coupling, "operator": f"{HANDS}:{hand}", "scene": "wall", "dof": 3, "link.up": link,
        "link.down": link, "duration_s": duration_s, "device.servo": "sampled", "device.greatest_speed": 1.5,
        "record_hz": 1000.0,
    }  # fmt: skip
    return simulate({**changes, **more}, seed=4100)


def felt(result: Result, begin_s: float, end_s: float) -> Felt:
    """Measured from the samples of positions and forces alone."""
    device, world = result.recording.device, result.recording.world
    start = device["time_ns"][0]
    at, steps = (device["time_ns"] - start) / 1e9, (world["time_ns"] - start) / 1e9
    free = (at >= begin_s) & (at < end_s) & (device["position_m"][:, 0] < WALL_M - FREE_M)
    proxy = np.stack([np.interp(at, steps, world["position_m"][:, axis]) for axis in range(3)], axis=1)
    off = np.linalg.norm(device["position_m"] - proxy, axis=1)[free]
    short = np.linalg.norm(world["set_position_m"] - world["target_m"], axis=1)[(steps >= begin_s) & (steps < end_s)]
    force = np.linalg.norm(device["force_N"][free], axis=1)
    return Felt(float(np.percentile(force, 99)), float(np.mean(short > 1e-7)), 1e3 * float(np.sqrt(np.mean(off**2))))


@pytest.mark.parametrize("hand", mostly_slow(["Mixed", "InTheAir", "Writing"], 1))
def test_a_natural_hand_feels_no_more_drag_than_with_the_plain_spring(hand: str) -> None:
    pspm, plain = (run(coupling, hand, "4g", 12.0) for coupling in ("pspm", "zoh"))
    assert pspm.summary["verdict"]["passive"]
    one, other = felt(pspm, 2.0, 12.0), felt(plain, 2.0, 12.0)
    assert 0.02 < one.force_N <= 1.1 * other.force_N
    assert one.modulated <= 0.02


@pytest.mark.soak
@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("hand", ["InTheAir", "Tapping", "Writing", "Mixed"])
def test_so_it_stays_for_ten_minutes(hand: str, link: str) -> None:
    pspm, plain = (run(coupling, hand, link, 600.0) for coupling in ("pspm", "zoh"))
    assert pspm.summary["verdict"]["passive"]
    one, other = felt(pspm, 2.0, 600.0), felt(plain, 2.0, 600.0)
    assert one.force_N <= 1.1 * other.force_N
    assert one.modulated <= 0.02
    first, last = felt(pspm, 2.0, 62.0), felt(pspm, 540.0, 600.0)
    plain_first, plain_last = felt(plain, 2.0, 62.0), felt(plain, 540.0, 600.0)  # the hand itself is never the same
    assert last.force_N / plain_last.force_N <= 1.1 * first.force_N / plain_first.force_N
    assert last.free_mm / plain_last.free_mm <= 1.1 * first.free_mm / plain_first.free_mm


@pytest.mark.parametrize("servo_hz", [1000.0, 4000.0])
@pytest.mark.parametrize("stiffness", [200.0, 3000.0])
@pytest.mark.parametrize("speed", mostly_slow([0.5, 0.1, 1.5], 1))
def test_in_free_air_a_stiff_spring_is_not_felt_at_any_speed(stiffness: float, servo_hz: float, speed: float) -> None:
    """A limit on the set-position's step made a stiff spring drag a fast hand with up to 9 N.

    The plain spring has no limit here.
    """
    sine = {"operator_model.frequency_hz": 2.0, "operator_model.amplitude_m": speed / (2.0 * math.pi * 2.0)}
    forces = []
    for coupling, limit in (("pspm", 0.5), ("zoh", 0.0)):
        result = simulate(
            {"coupling": coupling, "device.step_limit_N": limit, "scene": "free", "operator": "sine", **sine,
             "operator_model.stiffness": 900.0,
             "device.stiffness": stiffness, "device.servo_hz": servo_hz, "device.servo": "sampled", "duration_s": 2.5,
             "link.up": "4g", "link.down": "4g", "record_hz": servo_hz, "device.greatest_speed": 2.0}, seed=5,
        )  # fmt: skip
        device = result.recording.device
        forces.append(float(np.linalg.norm(device["force_N"][device["time_s"] > 0.8], axis=1).max()))
        assert not result.summary["world"]["modulated_share"]  # None: the plain spring modulates nothing
    assert forces[0] <= 1.1 * forces[1]
