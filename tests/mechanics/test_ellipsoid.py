"""The projection against bisection on the multiplier, the KKT conditions, and the laws of a projection."""

import math

import numpy as np
import pytest

from hapnet.checks import Array
from hapnet.mechanics.ellipsoid import Ellipsoid
from tests.conftest import random_spd


def project_by_bisection(K: Array, e: Array, radius: float) -> Array:
    """Independent: min |p - e| s.t. p'Kp <= radius^2, by bisection on mu in ``(I + mu K) p = e``."""
    if e @ K @ e <= radius**2:
        return e
    n = len(e)

    def at(mu: float) -> Array:
        return np.asarray(np.linalg.solve(np.eye(n) + mu * K, e))

    low, high = 0.0, 1.0
    while at(high) @ K @ at(high) > radius**2:
        low, high = high, 4.0 * high
    for _ in range(200):
        middle = (low + high) / 2.0
        p = at(middle)
        low, high = (middle, high) if p @ K @ p > radius**2 else (low, middle)
    return at(high)


def cases(count: int) -> list[tuple[Array, Array, float]]:
    rng = np.random.default_rng(20090318)
    drawn = []
    for _ in range(count):
        n = int(rng.integers(1, 7))
        K = random_spd(rng, n, 1.0, 10.0 ** rng.uniform(0.0, 5.0))
        e = rng.normal(size=n) * 10.0 ** rng.uniform(-4.0, 0.0)
        radius = math.sqrt(e @ K @ e) * 10.0 ** rng.uniform(-4.0, 0.3)
        drawn.append((K, e, radius))
    return drawn


@pytest.mark.long
def test_agrees_with_bisection_on_the_multiplier() -> None:
    active = 0
    for K, e, radius in cases(300):
        p = np.array(Ellipsoid(K).project(tuple(e), radius))
        expected = project_by_bisection(K, e, radius)
        active += bool(np.any(expected != e))
        assert np.linalg.norm(p - expected) <= 1e-8 * np.linalg.norm(expected)
    assert active > 240


def test_kkt_residual() -> None:
    """p - e + mu K p = 0 with mu >= 0, and p on the boundary, wherever the constraint is active."""
    for K, e, radius in cases(1000):
        p = np.array(Ellipsoid(K).project(tuple(e), radius))
        gradient = K @ p
        if np.array_equal(p, e):
            continue
        mu = float((e - p) @ gradient / (gradient @ gradient))
        assert mu >= 0.0
        assert np.linalg.norm(e - p - mu * gradient) <= 1e-8 * np.linalg.norm(e)
        assert math.sqrt(p @ gradient) == pytest.approx(radius, rel=1e-8)


def test_the_bound_holds_in_floating_point() -> None:
    for K, e, radius in cases(1000):
        ellipsoid = Ellipsoid(K)
        assert ellipsoid.square(ellipsoid.project(tuple(e), radius)) <= max(radius * radius, 0.0)


def test_is_non_expansive_and_idempotent() -> None:
    rng = np.random.default_rng(5)
    for K, e, radius in cases(300):
        ellipsoid = Ellipsoid(K)
        other = e + rng.normal(size=len(e)) * np.linalg.norm(e)
        p, q = ellipsoid.project(tuple(e), radius), ellipsoid.project(tuple(other), radius)
        assert math.dist(p, q) <= math.dist(e, other) * (1.0 + 1e-9)
        assert math.dist(ellipsoid.project(p, radius), p) == 0.0


def test_an_isotropic_stiffness_scales_radially() -> None:
    p = Ellipsoid(np.eye(2) * 4.0).project((3.0, 4.0), 5.0)  # |e|_K = 10: halved
    assert p == pytest.approx((1.5, 2.0), rel=1e-15)


def test_an_empty_ball_is_its_centre() -> None:
    assert Ellipsoid(np.diag([1.0, 2.0])).project((1.0, 1.0), 0.0) == (0.0, 0.0)


@pytest.mark.parametrize("radius", [1e-200, 1e-160, 1e-100])
def test_a_vanishing_ball_ends(radius: float) -> None:
    ellipsoid = Ellipsoid(random_spd(np.random.default_rng(1), 3, 1.0, 1e4))
    assert ellipsoid.square(ellipsoid.project((0.1, -0.2, 0.3), radius)) <= radius * radius


@pytest.mark.parametrize("exponent", range(-139, -3, 4))
def test_a_nearly_empty_ball_is_projected_on_and_not_divided_by(exponent: int) -> None:
    """Far offsets on tiny balls: the point is on the boundary, and as for any tiny ball in the direction of K^-1 e."""
    K = random_spd(np.random.default_rng(exponent + 200), 3, 1.0, 1e4)
    ellipsoid, radius, e = Ellipsoid(K), 10.0**exponent, (0.1, -0.2, 0.3)
    p = np.array(ellipsoid.project(e, radius)) / radius
    assert math.sqrt(p @ K @ p) == pytest.approx(1.0, rel=1e-7)
    if exponent < -11:
        far = np.linalg.solve(K, e)
        assert p == pytest.approx(far / math.sqrt(far @ K @ far), rel=1e-6)
