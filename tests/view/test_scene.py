"""Geometry of the 3-D part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("viser", reason="the live page's library is not installed")

import viser
import viser.transforms

from hapnet.mechanics.plane import Plane
from hapnet.view.history import Snapshot
from hapnet.view.scene import _PROXY_RADIUS, _THIN, UNIT, Scene, _coil, _turned_to


def test_the_spring_is_turned_to_where_it_leads() -> None:
    rng = np.random.default_rng(2)
    directions = [*np.eye(3), *-np.eye(3), *rng.normal(size=(100, 3))]
    for direction in directions:
        unit = direction / np.linalg.norm(direction)
        turned = viser.transforms.SO3(_turned_to(unit)) @ np.array([1.0, 0.0, 0.0])
        np.testing.assert_allclose(turned, unit, atol=1e-9)


@pytest.mark.parametrize("normal", [(1.0,), (0.6, -0.8), (0.0, 0.0, 1.0)])
def test_a_plane_that_the_device_knows_lies_where_a_wall_of_its_place_does(normal: tuple[float, ...]) -> None:
    """Its near face is the proxy's radius behind the plane, and across its normal; what is no longer told is hidden."""
    server = viser.ViserServer(port=0, verbose=False)
    scene = Scene(server, len(normal), [], None)
    still = Snapshot(None, None, None, None, False, None, None, (), 0)
    scene.update(replace(still, planes=(Plane(normal, 0.02, 3000.0, 10.0),)))
    first, *others = scene._planes
    assert [first.visible, *(other.visible for other in others)] == [True, False, False, False]
    along = np.zeros(3)
    along[: len(normal)] = normal
    turned = viser.transforms.SO3(np.array(first.wxyz)) @ np.array([1.0, 0.0, 0.0])
    np.testing.assert_allclose(turned, along, atol=1e-9)
    assert np.dot(first.position, along) - _THIN / 2.0 == pytest.approx(0.02 * UNIT + _PROXY_RADIUS)
    for planes in ((), None):
        scene.update(replace(still, planes=planes))
        assert not any(node.visible for node in scene._planes)
    server.stop()


def test_the_coil_is_one_line_from_end_to_end() -> None:
    coil = _coil()
    assert coil[0, 0].tolist() == [0.0, 0.0, 0.0]
    assert coil[-1, 1].tolist() == [1.0, 0.0, 0.0]
    np.testing.assert_array_equal(coil[1:, 0], coil[:-1, 1])
