"""Rotations, against Rodrigues' formula."""

import math

import pytest

from hapnet.mechanics.pose import quaternion


@pytest.mark.parametrize("angle", [0.0, 0.3, math.pi / 2, 3.0, math.pi])
@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 0.6, 0.8), (2 / 3, -1 / 3, 2 / 3)])
def test_a_quaternion_is_that_of_its_rotation(axis: tuple[float, float, float], angle: float) -> None:
    """Rodrigues' formula makes the matrix."""
    x, y, z = axis
    c, s = math.cos(angle), math.sin(angle)
    rows = [
        [c + x * x * (1 - c), x * y * (1 - c) - z * s, x * z * (1 - c) + y * s],
        [y * x * (1 - c) + z * s, c + y * y * (1 - c), y * z * (1 - c) - x * s],
        [z * x * (1 - c) - y * s, z * y * (1 - c) + x * s, c + z * z * (1 - c)],
    ]
    found = quaternion(rows)
    expected = (math.cos(angle / 2), *(math.sin(angle / 2) * part for part in axis))
    sign = 1.0 if sum(a * b for a, b in zip(found, expected, strict=True)) > 0.0 else -1.0
    assert [sign * part for part in found] == pytest.approx(expected, abs=1e-12)
