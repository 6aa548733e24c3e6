"""A rigid body's step: energy, momentum, and its motion beside integrators and rotations written elsewhere."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from hapnet.checks import Array
from hapnet.ext.tools.body import RigidBody, Touched, settle, weigh
from hapnet.ext.tools.body_step import step
from hapnet.mechanics import pose as poses
from hapnet.mechanics.pose import ARM_M, AXES
from hapnet.records.record import zero
from tests.conftest import mostly_slow

NO_PLANES = zero(Touched)
STILL = [0.0] * AXES
INERTIA = (2e-5, 5e-5, 9e-5)


def random_pose(rng: np.random.Generator, spread: float = 0.02) -> tuple[float, ...]:
    """Anywhere, in any orientation."""
    return poses.coordinates(rng.normal(0.0, spread, 3), rng.normal(size=4))


def body_at(x: tuple[float, ...], velocity: Array, spin: Array) -> RigidBody:
    body = RigidBody(0.05, INERTIA, x)
    body.velocity[:], body.spin[:] = velocity.tolist(), spin.tolist()
    settle(body)
    return body


def test_coordinates_are_those_of_the_rotation() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        q = rng.normal(size=4)
        x = poses.coordinates((0.1, 0.2, 0.3), q)
        expected = Rotation.from_quat([*q[1:], q[0]])
        arms = np.reshape(x[3:], (3, 3)).T / ARM_M + np.eye(3)
        assert np.abs(arms - expected.as_matrix()).max() < 1e-15
        w = poses.pose(x).quaternion
        assert (Rotation.from_quat([*w[1:], w[0]]) * expected.inv()).magnitude() < 1e-14
        assert w[0] >= 0.0
        other = random_pose(rng)
        turn = Rotation.from_matrix(poses.rotation(other)) * expected.inv()
        assert poses.angle_between(x, other) == pytest.approx(turn.magnitude(), abs=1e-12)


def test_the_nearest_rotation_of_arms_that_are_none() -> None:
    """Against scipy's, which orthogonalises by singular values as well, and the mirror image that it must not give."""
    rng = np.random.default_rng(2)
    for _ in range(100):
        x = np.array(random_pose(rng)) + rng.normal(0.0, 0.01, AXES)
        matrix = np.reshape(x[3:], (3, 3)).T / ARM_M + np.eye(3)
        found = poses.rotation(x)
        assert np.linalg.det(found) == pytest.approx(1.0)
        if np.linalg.det(matrix) > 0.0:
            assert np.abs(found - Rotation.from_matrix(matrix).as_matrix()).max() < 1e-6


def test_a_spring_of_the_coordinates_turns_with_twice_the_arms_square() -> None:
    """``K/2 |x - y|^2`` has 2 K l^2 (1 - cos angle), and its force is the torque 2 K l^2 sin angle about the axis."""
    rng = np.random.default_rng(3)
    for angle in (1e-3, 0.3, 1.5, 3.0, np.pi):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        x = np.array(poses.coordinates((0, 0, 0), (np.cos(angle / 2), *(np.sin(angle / 2) * axis))))
        assert 0.5 * 300.0 * float(x @ x) == pytest.approx(2.0 * 300.0 * ARM_M**2 * (1.0 - np.cos(angle)), abs=1e-15)
        force, torque = poses.wrench(x, -300.0 * x)
        assert np.abs(force).max() == 0.0
        assert np.array(torque) == pytest.approx(-2.0 * 300.0 * ARM_M**2 * np.sin(angle) * axis, abs=1e-13)


def test_a_wrench_along_the_coordinates_does_the_work_of_the_wrench() -> None:
    """Force and torque come back, and none other has a smaller norm (numpy's least squares)."""
    rng = np.random.default_rng(4)
    for _ in range(50):
        x, force, torque = random_pose(rng), rng.normal(size=3), rng.normal(size=3)
        f = poses.along_coordinates(x, force, torque, ARM_M)
        again = poses.wrench(x, f)
        assert np.concatenate(again) == pytest.approx(np.concatenate([force, torque]), abs=1e-12)
        rows = np.array([np.concatenate(poses.wrench(x, one)) for one in np.eye(AXES)]).T
        least = np.linalg.lstsq(rows, np.concatenate([force, torque]), rcond=None)[0]
        assert np.array(f) == pytest.approx(least, abs=1e-9)


@pytest.mark.parametrize("ticks", mostly_slow([5_000, 20_000], 1))
@pytest.mark.long
def test_a_free_spin_keeps_momentum_and_energy(ticks: int) -> None:
    """Issue: within 0.1 % in 20 s at 1 ms. It tumbles about the middle axis."""
    body = body_at(STILL_POSE, np.array([0.1, 0.0, 0.0]), np.array([0.02, 8.0, -0.03]))
    momentum, energy = np.array(body.momentum), body.kinetic
    for _ in range(ticks):
        assert step(body, 1e-3, STILL, STILL, NO_PLANES)
    assert np.abs(np.array(body.momentum) - momentum).max() <= 1e-11 * np.linalg.norm(momentum)
    assert body.kinetic == pytest.approx(energy, rel=1e-11)
    assert body.x[0] == pytest.approx(1e-4 * ticks, rel=1e-11)
    arms = np.reshape(body.x[3:], (3, 3)) / ARM_M + np.eye(3)
    assert np.abs(arms @ arms.T - np.eye(3)).max() < 1e-12


STILL_POSE = (0.0,) * AXES


@pytest.mark.parametrize("damping", mostly_slow([0.0, 0.05], 1))
@pytest.mark.long
def test_beside_eulers_equations(damping: float) -> None:
    """scipy's DOP853 on the quaternion and Euler's equations, with a torque that the held force makes: second order,
    with a damper, too (of 2 to 8 1/s)."""
    spin, push = np.array([3.0, -5.0, 4.0]), np.zeros(AXES)
    push[3:] = np.random.default_rng(5).normal(0.0, 1e-3, 9)
    inertia = np.array(INERTIA)

    def rates(t: float, state: Array) -> Array:
        turn = Rotation.from_quat(state[:4] / np.linalg.norm(state[:4]))
        W, R = state[4:], turn.as_matrix()
        torque = sum(np.cross(ARM_M * R[:, j], push[3 + 3 * j : 6 + 3 * j]) for j in range(3))
        q = state[:4]
        v, w = q[:3], q[3]
        return np.concatenate(
            [
                0.5 * (w * W + np.cross(v, W)),
                [-0.5 * float(v @ W)],
                (R.T @ torque - 2.0 * damping * ARM_M**2 * W - np.cross(W, inertia * W)) / inertia,
            ]
        )

    end = solve_ivp(rates, (0.0, 0.5), [0, 0, 0, 1, *spin], method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    expected = Rotation.from_quat(end[:4] / np.linalg.norm(end[:4]))
    errors = []
    for n in (500, 2000):
        body = body_at(STILL_POSE, np.zeros(3), spin)
        body.hold(0.0, damping, 0.0, damping)
        weigh(body, 0.5 / n)
        for _ in range(n):
            assert step(body, 0.5 / n, push.tolist(), STILL, NO_PLANES)
        errors.append((Rotation.from_matrix(poses.rotation(body.x)) * expected.inv()).magnitude())
    assert errors[0] < 2e-4
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.05)


@pytest.mark.parametrize(("K_arms", "B_arms"), mostly_slow([(500.0, 14.0), (60.0, 2.0)], 1))
@pytest.mark.long
def test_a_step_makes_and_loses_no_energy(K_arms: float, B_arms: float) -> None:
    """With any push, spring and damper, in random poses, for steps of 1 to 100 ms, through 180 degrees."""
    rng, found = np.random.default_rng(6), 0
    K, B = (np.array([one] * 3 + [other] * 9) for one, other in ((500.0, K_arms), (14.0, B_arms)))
    for _ in range(400):
        body = body_at(random_pose(rng), rng.normal(0.0, 0.2, 3), rng.normal(0.0, 3.0, 3))
        body.hold(500.0, 14.0, K_arms, B_arms)
        dt = float(rng.choice([1e-3, 1e-2, 5e-2, 1e-1]))
        push, y, begun = rng.normal(0.0, 1.0, AXES), np.array(random_pose(rng)), np.array(body.x)
        before = body.kinetic + 0.5 * float(K @ (begun - y) ** 2)
        if not step(body, dt, push.tolist(), y.tolist(), NO_PLANES):
            assert body.x == begun.tolist()
            continue
        found += 1
        moved = np.array(body.x) - begun
        after = body.kinetic + 0.5 * float(K @ (body.x - y) ** 2)
        work, lost = float(push @ moved), float(B @ moved**2) / dt
        assert work - lost == pytest.approx(after - before, abs=1e-14 * (1.0 + abs(work) + lost + before))
    assert found > 200
