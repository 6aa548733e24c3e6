"""What the plots draw: values held in time, and depths in walls."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("viser", reason="the live page's library is not installed")

from hapnet.plant.worlds.registry import make_scene
from hapnet.view.plots import depth_of, held


def test_a_value_is_held_until_the_next() -> None:
    times, values = np.array([-3.0, -1.0]), np.array([5.0, 7.0])
    at = np.array([-4.0, -3.0, -1.1, -1.0, 0.0])
    assert held(times, values, at).tolist() == [5.0, 5.0, 5.0, 7.0, 7.0]


@pytest.mark.parametrize("name", ["wall", "box", "paper", "free"])
def test_depth_is_that_of_the_scenes_walls(name: str) -> None:
    scene = make_scene(name)
    places = np.random.default_rng(3).uniform(-0.06, 0.06, size=(200, scene.dof))
    surfaces = [surface._asdict() for surface in scene.surfaces]
    expected = [max([0.0, *(wall.penetration(tuple(p)) for wall in scene.walls)]) for p in places]
    np.testing.assert_allclose(depth_of(places, surfaces), expected, atol=1e-15)
