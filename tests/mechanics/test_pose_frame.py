"""The frame of a device that turns: the same turn about the same axis, the same work, the same plane."""

from __future__ import annotations

import numpy as np
import pytest

from hapnet.checks import Array
from hapnet.mechanics.pose import AXES, coordinates, pose, rotation
from hapnet.mechanics.pose_frame import PoseFrame
from hapnet.plant.poses.contacts import rigid_plane


def axis_angle(axis: tuple[float, float, float], angle: float) -> Array:
    """The rotation matrix by Rodrigues' formula."""
    n = np.array(axis) / np.linalg.norm(axis)
    S = np.array([[0.0, -n[2], n[1]], [n[2], 0.0, -n[0]], [-n[1], n[0], 0.0]])
    turn: Array = np.eye(3) + np.sin(angle) * S + (1.0 - np.cos(angle)) * S @ S
    return turn


def at(rng: np.random.Generator) -> tuple[float, ...]:
    return coordinates(rng.normal(0.0, 0.05, 3).tolist(), rng.normal(size=4).tolist())


def met(seed: int, force: float = 2.5) -> tuple[PoseFrame, tuple[float, ...], tuple[float, ...]]:
    """A frame in which the device is at the one pose where the coupling has it at the other."""
    rng = np.random.default_rng(seed)
    frame, own, x = PoseFrame(force), at(rng), at(rng)
    frame.meet(own, x)
    return frame, own, x


@pytest.mark.parametrize("seed", range(4))
def test_where_they_met_is_the_same_place(seed: int) -> None:
    frame, own, x = met(seed)
    np.testing.assert_allclose(frame.coupled(own), x, atol=1e-16)
    np.testing.assert_allclose(frame.own(x), own, atol=1e-16)
    assert not frame.is_one


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (1.0, -2.0, 0.5)])
def test_a_turn_about_an_axis_of_the_world_is_the_same_turn_of_the_device(axis: tuple[float, float, float]) -> None:
    frame, own, x = met(5)
    turn = axis_angle(axis, 0.7)
    R = turn @ rotation(x)
    arms = (0.04 * (R - np.eye(3))).T.ravel()
    turned = frame.own((*x[:3], *arms))
    np.testing.assert_allclose(rotation(turned) @ rotation(own).T, turn, atol=1e-14)
    assert pose(turned).position == pytest.approx(own[:3])


def test_work_is_scaled_as_the_force_alone() -> None:
    frame, own, _ = met(7)
    rng = np.random.default_rng(8)
    force, step = tuple(rng.normal(size=AXES)), rng.normal(size=AXES) * 1e-3
    moved = np.subtract(frame.coupled(np.add(own, step).tolist()), frame.coupled(own))
    np.testing.assert_allclose(frame.velocity(step.tolist()), moved, atol=1e-15)
    assert np.dot(frame.coupled_force(force), moved) == pytest.approx(2.5 * np.dot(force, step), rel=1e-10)
    np.testing.assert_allclose(frame.own_force(frame.coupled_force(force)), force, atol=1e-15)


def test_a_plane_is_as_deep_and_holds_as_much_as_the_devices_own() -> None:
    frame, own, _ = met(9)
    plane = rigid_plane(own, 0.04, (0.01, 0.0, -0.02), (0.0, 0.6, -0.8), -2e-3, 3000.0, 5.0)
    seen = frame.plane(plane)
    step = np.random.default_rng(3).normal(size=AXES) * 1e-3
    there = np.add(own, step).tolist()
    assert seen.depth(frame.coupled(there)) == pytest.approx(plane.depth(there), abs=1e-15)
    assert np.linalg.norm(seen.normal) == pytest.approx(1.0)
    assert seen.stiffness == pytest.approx(2.5 * plane.stiffness)


def test_two_that_are_turned_alike_keep_their_bits() -> None:
    frame, x = PoseFrame(1.0), at(np.random.default_rng(1))
    assert frame.is_one
    assert frame.own(x) == x == frame.coupled(x)
    frame.meet(x, x)
    assert frame.is_one
