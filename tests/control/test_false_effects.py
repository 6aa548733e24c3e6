"""A world that sends false effects of its surfaces: with PSPM they create no energy."""

from typing import Any

import numpy as np
import pytest

from hapnet.checks import Vector
from hapnet.mechanics.effects import Effects, Grain
from hapnet.mechanics.plane import Plane
from tests.conftest import mostly_slow
from tests.measure.rubbing import check_no_energy, lied_to, slack_of


def effects_lied(seed: int, coupling: str) -> Any:
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

    link = ("40±10 ms, 2 %", "delay 100ms 80ms loss 20%")[seed % 2]
    return lied_to(planes, link, seed=seed, dof=2 + seed // 2 % 2, coupling=coupling)


@pytest.mark.parametrize("seed", mostly_slow(range(20), 2, 8))
def test_no_effect_creates_energy(seed: int) -> None:
    check_no_energy(effects_lied(seed, "pspm"))


def test_without_pspm_the_same_effects_do() -> None:
    assert slack_of(effects_lied(1, "zoh")) < -0.01
