"""The saturated spring: its force is the gradient of its potential, and never longer than the limit."""

import math

import numpy as np
import pytest

from hapnet.errors import InvalidParameter
from hapnet.mechanics.spring import Spring, shared_spring
from tests.conftest import random_spd


def random_spring(rng: np.random.Generator) -> Spring:
    n = int(rng.integers(1, 4))
    return Spring(random_spd(rng, n, 10.0, 2000.0), n, float(rng.uniform(0.5, 5.0)))


def test_force_is_minus_the_gradient_of_the_potential() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        spring = random_spring(rng)
        e = rng.normal(size=spring.dof) * 0.02
        h = 1e-6
        for axis, force in enumerate(spring.force((0.0,) * spring.dof, tuple(e))):
            step = np.eye(spring.dof)[axis] * h
            slope = (spring.potential(tuple(e + step)) - spring.potential(tuple(e - step))) / (2.0 * h)
            assert force == pytest.approx(-slope, rel=1e-4, abs=1e-6)


def test_force_never_exceeds_the_limit() -> None:
    rng = np.random.default_rng(2)
    for _ in range(500):
        spring = random_spring(rng)
        e = tuple(rng.normal(size=spring.dof) * 10.0 ** rng.uniform(-4, 1))
        assert math.hypot(*spring.force((0.0,) * len(e), e)) <= spring.force_limit * (1.0 + 1e-12)


@pytest.mark.long
def test_nearest_respects_the_energy_exactly_and_uses_it_up() -> None:
    rng = np.random.default_rng(3)
    for _ in range(2000):
        spring = random_spring(rng)
        e = tuple(rng.normal(size=spring.dof) * 0.1)
        energy = float(spring.potential(e) * 10.0 ** rng.uniform(-6.0, -0.01))
        p = spring.nearest(e, energy)
        assert spring.potential(p) <= energy
        assert spring.potential(p) == pytest.approx(energy, rel=1e-12)


def test_potential_by_hand() -> None:
    """K = 100 N/m, limit 2 N: knee at 20 mm with 20 mJ; 30 mm: 20 mJ + 2 N x 10 mm."""
    spring = Spring(100.0, 1, 2.0)
    assert spring.potential((0.02,)) == pytest.approx(0.02)
    assert spring.potential((-0.03,)) == pytest.approx(0.04)
    assert spring.force((0.0,), (-0.03,)) == pytest.approx((2.0,))


@pytest.mark.parametrize(
    ("K", "words"),
    [
        ([[1.0, 2.0], [2.0, 1.0]], "eigenvalue -1"),
        ([[1.0, 2.0], [0.0, 1.0]], "not symmetric"),
        ([1.0, 2.0, 3.0], "2 x 2"),
        (-1.0, "positive definite"),
        (float("nan"), "finite"),
    ],
)
def test_refuses_what_is_no_stiffness(K: object, words: str) -> None:
    for make in (Spring, shared_spring):
        with pytest.raises(InvalidParameter, match=words):
            make(K, 2)  # type: ignore[arg-type]
