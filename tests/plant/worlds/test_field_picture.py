"""What a world that is a function looks like: arrows along a known force, pieces of a known surface."""

from math import hypot

import numpy as np
import pytest

from hapnet import ForceWorld, Obstacle
from hapnet.ext.solids.field_picture import REACH_M, StillPicture, field, surface
from hapnet.mechanics.plane import Plane
from hapnet.plant.worlds.registry import make_scene

Vector = tuple[float, ...]

ARROW = 9
"""Vertices of an arrow: four of its shaft, the third of which is the neck, four of its head, and the tip."""


def swirl(position: Vector) -> list[float]:
    """Around the origin, larger farther away."""
    x, y = position
    return [-2.0 * y, 2.0 * x]


def test_arrows_point_where_the_force_does_and_grow_with_its_root() -> None:
    (part,) = field(swirl, 2)
    arrows = np.asarray(part.vertices, dtype=float).reshape(-1, ARROW, 3)
    tails = 0.5 * (arrows[:, 0] + arrows[:, 1])
    along = arrows[:, -1] - tails
    assert len(arrows) == 11 * 11 - 1  # the middle has no force
    expected = np.stack([-tails[:, 1], tails[:, 0], np.zeros(len(tails))], axis=1)
    away = np.linalg.norm(expected, axis=1)
    lengths = np.linalg.norm(along, axis=1)
    np.testing.assert_allclose(along / lengths[:, None], expected / away[:, None], atol=1e-4)
    np.testing.assert_allclose(lengths / lengths.max(), np.sqrt(away / away.max()), rtol=1e-4)
    assert np.abs(tails).max() == pytest.approx(REACH_M)
    assert lengths.max() == pytest.approx(2.0 * REACH_M / 10)  # never into the next arrow


@pytest.mark.parametrize(("dof", "count"), [(1, 4), (3, 7 * 7)])
def test_a_wall_that_is_a_function_has_arrows_where_it_pushes_only(dof: int, count: int) -> None:
    """Half of the places, the middle one left out, are behind it."""
    behind = {1: 9, 3: 3}[dof]
    (part,) = field(lambda x: [-300.0 * x[0] if x[0] > 1e-9 else 0.0, *[0.0] * (dof - 1)], dof)
    arrows = np.asarray(part.vertices).reshape(-1, ARROW, 3)
    assert len(arrows) == behind * count
    assert arrows[:, :, 0].min() > -1e-9
    assert (arrows[:, -1, 0] < arrows[:, 0, 0]).all()


@pytest.mark.parametrize("force", [
    lambda x: [0.0], lambda x: [1.0, 2.0], lambda x: 1 / 0, lambda x: [float("nan")], lambda x: "north",
])  # fmt: skip
def test_what_cannot_be_drawn_is_not(force: object) -> None:
    assert field(force, 1) == ()  # type: ignore[arg-type]


@pytest.mark.parametrize("dof", [2, 3])
def test_a_ball_of_planes_is_drawn_as_a_ball(dof: int) -> None:
    """Each piece touches the ball: its middle is on it, and its corners are as far from it as those of a tangent."""
    centre, radius = (0.01, *[0.0] * (dof - 1)), 0.02
    (part,) = surface(lambda place, reach: (Plane.of_ball(place, centre, radius, 1000.0),), dof)
    pieces = np.asarray(part.vertices, dtype=float).reshape(-1, 4, 3)
    middles = pieces.mean(axis=1)
    distances = np.linalg.norm(middles - np.array([0.01, 0.0, 0.0]), axis=1)
    np.testing.assert_allclose(distances, radius, atol=1e-6)
    sides = {tuple(np.sign(middle[:dof] - np.array(centre)).astype(int).tolist()) for middle in middles}
    assert len({side for side in sides if 0 not in side}) == 2**dof  # all around


def test_a_flat_plane_is_drawn_where_it_is_and_nowhere_else() -> None:
    plane = Plane((0.0, 1.0), 0.015, 1000.0, 1.0)
    (part,) = surface(lambda place, reach: (plane,), 2)
    np.testing.assert_allclose(np.asarray(part.vertices)[:, 1], 0.015, atol=1e-7)
    assert np.ptp(np.asarray(part.vertices)[:, 0]) > 1.9 * REACH_M
    assert surface(lambda place, reach: (), 2) == ()
    assert surface(lambda place, reach: 1 / 0, 2) == ()  # type: ignore[arg-type, return-value]


def test_a_world_of_the_users_own_shows_its_force_or_its_planes() -> None:
    def push(position: Vector, velocity: Vector, time: float) -> list[float]:
        assert not any(velocity)
        assert time == 0.0
        return [-100.0 * x for x in position]

    assert len(ForceWorld(push, dof=2).picture().parts) == 1
    told = Obstacle(push, planes=Plane((1.0, 0.0), 0.02, 100.0, 1.0))
    (part,) = ForceWorld([told], dof=2).picture().parts
    np.testing.assert_allclose(np.asarray(part.vertices)[:, 0], 0.02, atol=1e-7)


class Bowl:
    """A hollow ball around the hand."""

    dof = 2

    def step(self, dt: float, position: Vector, velocity: Vector) -> list[float]:
        raise AssertionError("asked for a force")

    def planes(self, position: Vector, reach_m: float) -> list[Plane]:
        away = hypot(*position)
        return [Plane((position[0] / away, position[1] / away), 0.03, 500.0, 1.0)] if away else []


def test_an_object_that_steps_is_drawn_by_its_planes_and_never_asked_for_a_force() -> None:
    picture = make_scene(f"{__name__}:Bowl").picture()
    assert isinstance(picture, StillPicture)
    middles = np.asarray(picture.parts[0].vertices, dtype=float).reshape(-1, 4, 3).mean(axis=1)
    np.testing.assert_allclose(np.linalg.norm(middles, axis=1), 0.03, atol=1e-6)
    assert picture.poses().shape == (0, 7)
    assert picture.soft().shape == (0, 3)
    assert picture.touches((0.0, 0.0), (1.0, 0.0)) == []
