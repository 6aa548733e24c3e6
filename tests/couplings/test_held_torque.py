"""Runs whose held torque used to give out more than there was, or to step further than it may."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from hapnet.checks import Vector
from hapnet.control.reserve import spendable
from hapnet.params import RELAXED_HAND, Params
from hapnet.plant.device import SimulatedDevice
from hapnet.simulation.simulation import Result, Simulation, simulate
from tests.conftest import mostly_slow
from tests.support.own_motion import beyond
from tests.support.paper import PAPER

LIGHT = {
    "scene": "free", "operator": "sine", "operator_model.start_periods": 0.0, "link.up": "4g", "link.down": "4g",
    "device.servo": "sampled", "duration_s": 5.0, **RELAXED_HAND,
}  # fmt: skip


def held_forces(monkeypatch: pytest.MonkeyPatch, places: list[Vector] | None = None) -> list[Vector]:
    """Every force that the actuators are given from now on; `places` gets the positions at those ticks."""
    forces: list[Vector] = []
    apply = SimulatedDevice.apply

    def noted(device: SimulatedDevice, force: Vector) -> Vector:
        forces.append(apply(device, force))
        if places is not None:
            places.append(device.position)
        return forces[-1]

    monkeypatch.setattr(SimulatedDevice, "apply", noted)
    return forces


def kept(result: Result) -> None:
    summary = result.summary
    device = summary["device"]
    assert device["ledger"]["margin_J"] >= 0.0
    assert abs(device["true_slack_J"]) <= 1e-9
    assert device["deficit_max_J"] == 0.0
    assert summary["theorem"]["margin_J"] >= -1e-9
    assert summary["hand"]["margin_J"] >= -1e-9
    assert device["overrun_leak_J"] == 0.0
    assert all(math.isfinite(value) for value in device["ledger"].values() if value is not None)


@pytest.mark.parametrize(
    "words",
    [
        {"device.servo_hz": 100.0, "device.damping": 40.0, "device.own_damping": 0.0, "device.force_limit_N": 0.0},
        {"device.stiffness": 573.0, "device.damping": 2.5, "device.mass": 0.0012, "device.ceiling_J": 0.0},
        {"device.stiffness": 573.0, "device.damping": 2.5, "device.mass": 0.0012, "device.ceiling_J": 1e-4},
        {"device.stiffness": 5e4, "device.damping": 100.0, "device.mass": 0.002, "device.ceiling_J": 0.01,
         "device.own_damping": 0.0, "device.step_limit_N": 0.0, "device.force_limit_N": 0.0},
    ],
)  # fmt: skip
def test_an_empty_reservoir_leaves_no_held_torque_to_leak(words: dict[str, object]) -> None:
    """As found by an attack: a damper that was held on while the spring was off diverged to 1e34 J."""
    kept(simulate(PAPER.set({**LIGHT, **words}), seed=1))


@pytest.mark.parametrize("step", [0.5, 0.02])
def test_the_rendered_force_never_steps_by_more_than_its_limit(step: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """2000 N/m and a light hand over 4g used to step by 2.51 N where 0.5 N were allowed, the reservoir empty."""
    places: list[Vector] = []
    forces = held_forces(monkeypatch, places)
    words = {"device.stiffness": 2000.0, "world.stiffness": 1e4, "device.step_limit_N": step}
    result = simulate(PAPER.set({**LIGHT, **words}), seed=1, kernel=False)
    kept(result)
    held = np.array([(0.0,), *forces[:-1]])  # the last one is the end's, which takes the force away at once
    at = np.array([(0.0,), *places[:-1]])
    assert len(held) >= 5000
    by_hand = -2000.0 * np.diff(at, axis=0)
    steps = np.array([beyond(*one) for one in zip(held[1:], held[:-1], by_hand, strict=True)])
    assert steps.max() <= step * (1.0 + 1e-9)
    assert steps.max() > 0.99 * step  # it was asked for


@pytest.mark.parametrize("limit", mostly_slow([0.3, 2.0], 1))
def test_the_held_force_keeps_to_its_limit(limit: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever spring and damper ask for, in two axes."""
    forces = held_forces(monkeypatch)
    words = {"dof": 2, "device.stiffness": 500.0, "device.damping": 5.0, "device.force_limit_N": limit}
    result = simulate(PAPER.set({**LIGHT, **words}), seed=1, kernel=False)
    kept(result)
    lengths = np.linalg.norm(np.array(forces), axis=1)
    assert lengths.max() <= limit * (1.0 + 1e-12)
    assert lengths.max() > 0.99 * limit


@given(st.floats(0.0, 0.2), st.floats(0.0, 0.1), st.floats(0.001, 0.1), st.floats(0.0, 0.5), st.floats(10.0, 2000.0))
def test_what_the_spring_may_hold_is_covered(P: float, kept: float, far: float, drag: float, K: float) -> None:
    """With phi = F^2/2K in the spring, either the whole reserve is left, or all that there is covers F with the damper
    over the way that the device may go while it is held."""
    phi = spendable(P, kept, far, drag, K)
    assert phi <= P
    assert phi >= P - kept
    if phi > P - kept:
        assert far * (np.sqrt(2.0 * K * phi) + drag) <= P * (1.0 + 1e-12) + 1e-100  # [J]: squares of less underflow


@pytest.mark.slow
def test_a_reservoir_below_its_reserve_fills_again_by_what_the_hand_pays() -> None:
    """As after a long stall of the servo: both reservoirs are nearly empty. A hand that moves pays, and feels the wall
    again; with the whole reserve kept first, there was no force at all, and so nothing to harvest."""
    simulation = Simulation(
        Params().set({"operator": "hand-21", "link.up": "4g", "link.down": "4g", "duration_s": 20.0}), 21, kernel=False
    )
    simulation.pair()
    for side, energy in ((simulation.device, 0.02), (simulation.world, 0.0)):
        modulator: Any = side.coupling.modulator  # type: ignore[attr-defined]
        modulator.energy = energy
    result = simulation.run()
    device = result.recording.device
    assert device["reservoir_J"][-1] > 0.044
