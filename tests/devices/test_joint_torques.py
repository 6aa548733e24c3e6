"""What drivers of arms share, against least squares and the motors' limits themselves."""

import numpy as np
import pytest

from hapnet.ext.robots.joint_torques import paid, share


def test_the_nearest_force_pays_what_it_may() -> None:
    rng = np.random.default_rng(4)
    for _ in range(200):
        n = int(rng.integers(1, 4))
        force, moved, owed, most = rng.normal(size=n), 1e-3 * rng.normal(size=n), 1e-3 * rng.normal(), rng.uniform(0, 3)
        nearest = force + np.linalg.lstsq(moved[None, :], np.array([owed]), rcond=None)[0]
        acted, left = paid(owed, tuple(force), tuple(moved), most)
        assert (np.array(acted) - force) @ moved + left == pytest.approx(owed, abs=1e-15)
        if np.linalg.norm(nearest - force) <= most:
            assert acted == pytest.approx(tuple(nearest))
            assert left == pytest.approx(0.0, abs=1e-15)
        else:
            assert np.linalg.norm(np.array(acted) - force) == pytest.approx(most)
    assert paid(0.5, (1.0,), (0.0,), 2.0) == ((1.0,), 0.5)


def test_a_little_more_than_the_share_is_too_much_for_a_motor() -> None:
    rng = np.random.default_rng(5)
    for _ in range(200):
        torques, loads = rng.normal(size=5), 0.5 * rng.normal(size=5)
        limits = np.abs(loads) + rng.uniform(size=5)
        found = share(torques, loads, limits)
        assert np.all(np.abs(found * torques + loads) <= limits + 1e-12)
        assert found == 1.0 or np.any(np.abs(1.001 * found * torques + loads) > limits)
    assert share((1.0, 0.0), (3.0, 9.0), (2.0, 2.0)) == 0.0  # it cannot even carry its load
