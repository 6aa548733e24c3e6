"""The force is limited in the same way for every coupling: its step, and the speed to which it may accelerate."""

import math

import numpy as np
import pytest

from hapnet.control.law import HeldForce
from hapnet.control.reserve import ForceGuard
from hapnet.couplings import set_position
from hapnet.couplings.registry import COUPLINGS
from hapnet.simulation.simulation import simulate
from tests.conftest import mostly_slow
from tests.support import own_motion

STEP_N, STIFFNESS = 0.02, 300.0
STAGED = tuple(name for name, law in COUPLINGS.items() if law.takes_positions)
LYING = {"scene": "examples.pictures.lying:liar", "rendering": "hapnet", "operator": "hand-63", "duration_s": 2.0}


def largest_step(coupling: str, **changes: object) -> float:
    """The largest step of the force beyond the own motion, of a hand over 4g, with a spring of `STIFFNESS` [N]."""
    recorded = simulate(
        {
            "coupling": coupling, "link.up": "4g", "link.down": "4g", "operator": "hand-61", "scene": "wall",
            "device.servo": "sampled", "device.stiffness": STIFFNESS, "device.step_limit_N": STEP_N,
            "record_hz": 1000.0, "duration_s": 4.0, **changes,
        },
        seed=8,
    ).recording  # fmt: skip
    force, place = recorded.device["force_N"], recorded.device["position_m"]
    assert np.abs(force).max() > 10.0 * STEP_N
    return own_motion.largest_step(force, place, STIFFNESS)


@pytest.mark.parametrize("coupling", mostly_slow([(one,) for one in COUPLINGS], 4))
def test_no_law_steps_the_force_further(coupling: str) -> None:
    """A hand at a wall over 4g. The force and the position of each tick are recorded."""
    assert largest_step(coupling) <= STEP_N * (1.0 + 1e-6)


@pytest.mark.parametrize("coupling", mostly_slow([(one,) for one in STAGED], 3))
def test_nor_with_the_stages_in_a_world_that_lies(coupling: str) -> None:
    """A false plane in every message, up to 20 mm away: without the limit the spring's force jumps by newtons."""
    assert largest_step(coupling, **LYING) <= STEP_N * (1.0 + 1e-6)


def largest_force(coupling: str, limit_N: float) -> float:
    """The largest force on a hand that presses into a wall, whatever the law asks for [N]."""
    recorded = simulate(
        {
            "coupling": coupling, "link.up": "lan", "link.down": "lan", "operator": "press", "scene": "wall",
            "device.servo": "sampled", "device.stiffness": STIFFNESS, "device.force_limit_N": limit_N,
            "record_hz": 1000.0, "duration_s": 2.5,
        },
        seed=8,
    ).recording  # fmt: skip
    return float(np.abs(recorded.device["force_N"]).max())


@pytest.mark.parametrize("coupling", mostly_slow([(one,) for one in COUPLINGS], 4))
def test_no_law_exceeds_the_force_limit(coupling: str) -> None:
    assert largest_force(coupling, 0.0) > 0.3  # 0: no limit
    assert 0.1 < largest_force(coupling, 0.2) <= 0.2 * (1.0 + 1e-9)


@pytest.mark.parametrize("coupling", ["zoh", "popc"])
def test_a_law_without_the_limit_is_found(coupling: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same law's end with `step` infinite, as if it alone had no limit; `zoh` has one before its spring too."""
    for kind in (ForceGuard, HeldForce):
        monkeypatch.setattr(kind, "step", property(lambda self: math.inf, lambda self, step: None), raising=False)
    monkeypatch.setattr(set_position, "_max_step", lambda side, spring: math.inf)
    assert largest_step(coupling, **LYING) > 5.0 * STEP_N


SPEED, MASS, PERIOD_S = 0.3, 0.045, 1e-3


def fastest(coupling: str) -> float:
    """The highest speed to which a held force accelerates the handle beyond both `SPEED` and its own speed [m/s]."""
    device = simulate(
        {
            "coupling": coupling, "link.up": "4g", "link.down": "4g", "operator": "hand-61", "scene": "wall",
            "device.servo": "sampled", "device.stiffness": STIFFNESS, "device.step_limit_N": 0.0,
            "device.greatest_speed": SPEED, "device.mass": MASS, "record_hz": 1000.0, "duration_s": 4.0,
        },
        seed=8,
    ).recording.device  # fmt: skip
    before = device["velocity_mps"]
    after = np.linalg.norm(before + device["force_N"] * PERIOD_S / MASS, axis=1)
    return float((after - np.maximum(np.linalg.norm(before, axis=1), SPEED)).max())


@pytest.mark.parametrize("coupling", mostly_slow([(one,) for one in COUPLINGS], 4))
def test_no_law_accelerates_a_device_beyond_its_speed(coupling: str) -> None:
    """Over 4g an oscillating spring reaches 0.7 m/s with a law that has no such limit."""
    assert fastest(coupling) < 1e-9


@pytest.mark.parametrize("coupling", ["popc", "eba", "two-layer"])
def test_a_law_that_may_accelerate_it_is_found(coupling: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(HeldForce, "inertia", property(lambda self: math.inf, lambda self, m: None), raising=False)
    assert fastest(coupling) > 0.01
