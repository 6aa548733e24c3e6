"""Geometry of the 3-D part."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("viser", reason="the live page's library is not installed")

import viser.transforms

from hapnet.view.scene import _coil, _turned_to


def test_the_spring_is_turned_to_where_it_leads() -> None:
    rng = np.random.default_rng(2)
    directions = [*np.eye(3), *-np.eye(3), *rng.normal(size=(100, 3))]
    for direction in directions:
        unit = direction / np.linalg.norm(direction)
        turned = viser.transforms.SO3(_turned_to(unit)) @ np.array([1.0, 0.0, 0.0])
        np.testing.assert_allclose(turned, unit, atol=1e-9)


def test_the_coil_is_one_line_from_end_to_end() -> None:
    coil = _coil()
    assert coil[0, 0].tolist() == [0.0, 0.0, 0.0]
    assert coil[-1, 1].tolist() == [1.0, 0.0, 0.0]
    np.testing.assert_array_equal(coil[1:, 0], coil[:-1, 1])
