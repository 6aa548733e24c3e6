"""A world that lies about the effects of its surfaces: with PSPM they create no energy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hapnet.checks import Vector
from hapnet.mechanics.effects import Effects, Grain
from hapnet.mechanics.plane import Plane
from hapnet.simulation.simulation import Simulation
from tests.control.test_local_friction import slack_of
from tests.support.rubbing import run


def lied_to(seed: int, coupling: str) -> Any:
    """Up to four planes anywhere near, with any effects, sent anew at each step."""
    rng = np.random.default_rng(seed)

    def planes(position: Vector, reach_m: float) -> tuple[Plane, ...]:
        found, n = [], len(position)
        for _ in range(rng.integers(0, 5)):
            normal = rng.standard_normal(n)
            normal /= np.linalg.norm(normal)
            wave = 10 ** rng.uniform(0.0, 5.0) * rng.uniform(-1.0, 1.0, n)
            shape = rng.bytes(int(rng.integers(2, 257)))
            found.append(Plane(
                tuple(normal.tolist()), float(normal @ np.array(position)) + rng.uniform(-0.02, 0.02),
                10 ** rng.uniform(2.0, 4.5), 10.0, rng.uniform(-0.3, 0.3), friction=10 ** rng.uniform(-2.0, 1.0),
                effects=Effects(
                    10 ** rng.uniform(-1.0, 3.0), 10 ** rng.uniform(-1.0, 1.0), 10 ** rng.uniform(-1.0, 2.0),
                    10 ** rng.uniform(-4.0, -1.0), Grain(tuple(wave.tolist()), 10 ** rng.uniform(-5.0, -1.0), shape),
                ),
            ))  # fmt: skip
        return tuple(found)

    def watch(simulation: Simulation) -> None:
        contacts: Any = simulation.world.scene.contacts
        contacts.planes = planes

    hand = {"operator_hand.mass": 0.1, "operator_hand.damping": 0.5, "operator_hand.stiffness": 40.0}
    more: dict[str, object] = {"coupling": coupling, "operator": "press", **hand}
    link = ("40±10 ms, 2 %", "delay 100ms 80ms loss 20%")[seed % 2]
    return run("sphere", link, seconds=2.0, dof=2 + seed // 2 % 2, seed=seed, watch=watch, **more).summary


@pytest.mark.parametrize("seed", [*range(2), *[pytest.param(k, marks=pytest.mark.slow) for k in range(2, 20)]])
def test_no_effect_creates_energy(seed: int) -> None:
    summary = lied_to(seed, "pspm")
    assert slack_of(summary) >= -1e-12
    assert summary["theorem"]["margin_J"] >= 0.0
    assert summary["device"]["reservoir_min_J"] >= 0.0


def test_without_pspm_the_same_effects_do() -> None:
    assert slack_of(lied_to(1, "zoh")) < -0.01
