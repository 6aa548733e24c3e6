"""The frame of a device that turns: the same turn about the same axis, one factor of work, the same plane."""

import numpy as np
import pytest

from hapnet.checks import Array, Vector
from hapnet.ext.tools.contacts import rigid_plane
from hapnet.mechanics.pose import ARM_M, AXES, coordinates, pose, rotation, torques
from hapnet.mechanics.pose_frame import Arms, PoseFrame

SCALES = [(1.0, 2.5), (0.1, 1.0), (0.3, 4.0), (5.0, 0.5)]


def axis_angle(axis: tuple[float, float, float], angle: float) -> Array:
    """The rotation matrix by Rodrigues' formula."""
    n = np.array(axis) / np.linalg.norm(axis)
    S = np.array([[0.0, -n[2], n[1]], [n[2], 0.0, -n[0]], [-n[1], n[0], 0.0]])
    return np.eye(3) + np.sin(angle) * S + (1.0 - np.cos(angle)) * S @ S


def at(rng: np.random.Generator) -> Vector:
    return coordinates(rng.normal(0.0, 0.05, 3).tolist(), rng.normal(size=4).tolist())


class Robot:
    """A robot that stands at `own` where the link has it at x, both with arms of 40 mm; in all that the link sees."""

    def __init__(self, a: float, b: float, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.frame, self.arms = PoseFrame(a, b), Arms(a)
        self.met, self.x = at(rng), at(rng)
        self.frame.meet(self.met, self.arms.back.place(self.x))

    def own(self, x: Vector) -> Vector:
        return self.frame.own(self.arms.back.place(x))

    def on_link(self, own: Vector) -> Vector:
        return self.arms.place(self.frame.coupled(own))

    def own_force(self, force: Vector) -> Vector:
        return self.frame.own_force(self.arms.back.force(force))

    def force_on_link(self, own: Vector) -> Vector:
        return self.arms.force(self.frame.coupled_force(own))


@pytest.mark.parametrize("scales", SCALES)
@pytest.mark.parametrize("seed", range(2))
def test_where_they_met_is_the_same_place(scales: tuple[float, float], seed: int) -> None:
    robot = Robot(*scales, seed)
    np.testing.assert_allclose(robot.on_link(robot.met), robot.x, atol=1e-15)
    np.testing.assert_allclose(robot.own(robot.x), robot.met, atol=1e-15)
    assert not robot.frame.is_one


@pytest.mark.parametrize("scales", SCALES)
@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (1.0, -2.0, 0.5)])
def test_a_motion_is_scaled_and_a_turn_about_an_axis_of_the_world_is_not(
    scales: tuple[float, float], axis: tuple[float, float, float]
) -> None:
    robot = Robot(*scales, 5)
    turn, step = axis_angle(axis, 0.7), np.array([0.01, -0.03, 0.02])
    R = turn @ rotation(robot.x)
    own = robot.own((*(np.add(robot.x[:3], step)).tolist(), *(ARM_M * (R - np.eye(3))).T.ravel().tolist()))
    np.testing.assert_allclose(rotation(own) @ rotation(robot.met).T, turn, atol=1e-14)
    assert pose(own).position == pytest.approx(np.add(robot.met[:3], scales[0] * step))
    arms = np.reshape(own[3:], (3, 3)).T / ARM_M + np.eye(3)  # it is a pose, so its arms are a rotation
    np.testing.assert_allclose(arms.T @ arms, np.eye(3), atol=1e-13)


@pytest.mark.parametrize(("a", "b"), SCALES)
def test_the_leaders_energy_is_b_over_a_times_the_robots(a: float, b: float) -> None:
    robot, rng = Robot(a, b, 7), np.random.default_rng(8)
    for _ in range(20):
        force, step = rng.normal(size=AXES), rng.normal(size=AXES) * 1e-3
        on_link = robot.force_on_link(tuple(force))
        moved = np.subtract(robot.on_link(tuple(np.add(robot.met, step))), robot.on_link(robot.met))
        assert np.dot(on_link, moved) == pytest.approx(b / a * np.dot(force, step), abs=1e-12 * b / a)
        along = robot.arms.place(robot.frame.velocity(step.tolist()))
        assert np.dot(on_link, along) == pytest.approx(b / a * np.dot(force, step), abs=1e-14 * b / a)
        np.testing.assert_allclose(robot.own_force(on_link), force, atol=1e-14)
        assert on_link[:3] == pytest.approx(b * force[:3])
        torque = b / a * torques(robot.met, force)
        assert torques(robot.x, on_link) == pytest.approx(torque, rel=1e-12, abs=1e-12 * b / a)


@pytest.mark.parametrize(("a", "b"), SCALES)
def test_a_plane_is_as_deep_and_holds_as_much_as_the_devices_own(a: float, b: float) -> None:
    """Where it is met, and its force, are those of the robot's plane: f = -K p n, mapped as any force."""
    robot, rng = Robot(a, b, 9), np.random.default_rng(3)
    own = rigid_plane(robot.met, ARM_M, (0.01, 0.0, -0.02), (0.0, 0.6, -0.8), -2e-3, 3000.0, 5.0, speed=0.3)
    seen = robot.arms.plane(robot.frame.plane(own))
    assert np.linalg.norm(seen.normal) == pytest.approx(1.0)
    for _ in range(5):
        step = rng.normal(size=AXES) * 1e-3
        there = tuple(np.add(robot.met, step).tolist())
        x = robot.on_link(there)
        force = -own.stiffness * own.depth(there) * np.array(own.normal)
        np.testing.assert_allclose(
            -seen.stiffness * seen.depth(x) * np.array(seen.normal), robot.force_on_link(tuple(force)), rtol=1e-10
        )
        drag = -own.damping * (np.dot(own.normal, step) - own.velocity_mps) * np.array(own.normal)
        rate = np.dot(seen.normal, robot.arms.place(robot.frame.velocity(step.tolist()))) - seen.velocity_mps
        np.testing.assert_allclose(
            -seen.damping * rate * np.array(seen.normal), robot.force_on_link(tuple(drag)), rtol=1e-10
        )


@pytest.mark.parametrize(("a", "b"), SCALES)
def test_a_spring_is_ab_times_as_stiff_at_the_point_and_b_over_a_in_turning(a: float, b: float) -> None:
    """Without a turn between them: K_r = 1 N/m along all of the robot's coordinates, as the link has it."""
    frame, arms = PoseFrame(a, b), Arms(a)
    for i in range(AXES):
        e = tuple(np.eye(AXES)[i].tolist())
        moved = np.subtract(frame.own(arms.back.place(e)), frame.own((0.0,) * AXES))
        force = arms.force(frame.coupled_force(tuple((-1.0 * moved).tolist())))
        assert force[i] == pytest.approx(-a * b if i < 3 else -b / a)


def test_two_that_are_turned_alike_keep_their_bits() -> None:
    frame, x = PoseFrame(1.0, 1.0), at(np.random.default_rng(1))
    assert frame.is_one
    assert frame.own(x) == x == frame.coupled(x)
    frame.meet(x, x)
    assert frame.is_one
