"""The bare references compute the same thing: else a ratio would compare nothing."""

from itertools import pairwise

import numpy as np
import pytest

from hapnet.control.pspm import SetPositionModulator
from hapnet.ext.bench.control import pspm_case
from hapnet.ext.bench.references import NumpyMidpoint, NumpyPspm, PenaltyWorld, PlainPD, plain_substeps
from hapnet.ext.bench.world import PressedWorld
from hapnet.plant.integrator import PassiveIntegrator


@pytest.mark.parametrize("n", [1, 2, 3, 6])
def test_both_modulators_agree_and_the_constraint_is_active(n: int) -> None:
    K, x, y = pspm_case(n)
    ours, theirs = SetPositionModulator(stiffness=K, position=x), NumpyPspm(K, x, 0.05)
    ours.energy = theirs.energy = 0.01
    found = ours.modulate(tuple(y), tuple(x), 0.0, 0.0)
    assert found.energy == pytest.approx(0.0, abs=1e-12)
    assert np.linalg.norm(y - np.array(found.set_position)) > 1e-3
    assert theirs.modulate(y, x, 0.0, 0.0) == pytest.approx(np.array(found.set_position), abs=1e-9)


@pytest.mark.parametrize("n", [1, 2, 3, 6])
def test_both_integrators_agree(n: int) -> None:
    rng = np.random.default_rng(n)
    root = rng.normal(size=(n, n))
    M, B, K = (scale * (root @ root.T + n * np.eye(n)) for scale in (0.02, 14.0, 500.0))
    ours, theirs = PassiveIntegrator(M, B, K, np.zeros(n)), NumpyMidpoint(M, B, K)
    for dt in rng.uniform(0.01, 0.05, 50).tolist():
        goal = rng.uniform(-0.01, 0.01, n)
        assert theirs.step(dt, goal) == pytest.approx(np.array(ours.step(dt, goal).position), abs=1e-12)


def test_plain_force_and_plain_substeps() -> None:
    assert PlainPD(100.0, 0.1).force((0.01, 0.0, 0.02), (0.0,) * 3, (0.0, 1.0, 0.0)) == (-1.0, -0.1, -2.0)
    # (4000 v - 235 x) 2e-4 each 1/4 ms: x'' = -w^2 x with tan(w h/2) = ... close to w^2 = 235, damped by the 0.8
    assert abs(plain_substeps(1, 1.0)) < 0.01
    assert plain_substeps(1, 0.5) == plain_substeps(3, 0.5)


def test_the_pressed_world_is_in_contact_and_at_rest() -> None:
    """Spring against wall: 500 (0.016 - x) = 3000 (x - 0.010) along the wall's normal."""
    world = PressedWorld({"dof": 3}, (0.010, 0.050))
    x = world.side.mass.position
    assert x[0] == pytest.approx((500 * 0.016 + 3000 * 0.010) / 3500, abs=1e-6)
    assert x[1:] == pytest.approx((0.004, -0.003), abs=1e-6)
    before = world.side.steps
    world.prepare()
    world.step()
    assert world.side.steps == before + 1
    bare = PenaltyWorld(0.02, 14.0, 500.0, (3000.0, 10.0, 0.010))
    path = []
    for _ in range(20_000):
        bare.step(1e-4, (0.016, 0.004, -0.003))
        path.append(tuple(bare.x))
    assert path[-1] == pytest.approx(x, abs=1e-6)
    assert all(a != b for a, b in pairwise(path[:100]))
