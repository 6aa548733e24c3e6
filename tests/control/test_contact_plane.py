"""When two planes are the same surface, and where one is that moves."""

import math

import pytest

from hapnet.control.contact_plane import ContactPlane
from hapnet.mechanics.plane import Plane

HERE = (0.0, 0.0)


def seen(normal: tuple[float, ...] = (1.0, 0.0), offset: float = 0.0, stiffness: float = 1200.0,
         velocity: float = 0.0) -> ContactPlane:  # fmt: skip
    return ContactPlane(Plane(normal, offset, stiffness, 10.0, velocity_mps=velocity), [[2e-3, 0.0], [0.0, 2e-3]], HERE)


@pytest.mark.parametrize(
    ("other", "same"),
    [
        (seen(), True),
        (seen(offset=0.9e-3), True), (seen(offset=-0.9e-3), True),
        (seen(offset=1e-3), False), (seen(offset=-1e-3), False),
        (seen(stiffness=1001.0), True), (seen(stiffness=1439.0), True),
        (seen(stiffness=1000.0), False), (seen(stiffness=1440.0), False),
        (seen((0.96, 0.28)), True), (seen((0.95, math.sqrt(1.0 - 0.95**2))), False), (seen((-1.0, 0.0)), False),
    ],
)  # fmt: skip
def test_the_same_surface_is_within_a_millimetre_a_fifth_of_the_stiffness_and_18_degrees(
    other: ContactPlane, same: bool
) -> None:
    """Where the world has not looked a plane stays known until one takes its place."""
    assert other.withdrawn([seen()], HERE, -1.0) is same
    assert other.withdrawn([seen(offset=0.5), seen()], HERE, -1.0) is same
    assert not other.withdrawn([seen(offset=0.5)], HERE, -1.0)


def test_a_plane_is_gone_that_is_as_near_as_the_world_looked_or_moves() -> None:
    assert seen().withdrawn([], (-0.05, 0.3), 0.05)
    assert not seen().withdrawn([], (-0.051, 0.3), 0.05)
    assert seen(velocity=1e-9).withdrawn([], (-0.051, 0.3), 0.05)


@pytest.mark.parametrize(("age", "offset"), [(-1.0, 0.01), (0.1, 0.02), (0.2, 0.03), (0.3, 0.03)])
def test_a_plane_that_moves_goes_on_for_a_fifth_of_a_second(age: float, offset: float) -> None:
    assert seen(offset=0.01, velocity=0.1).now(age) == pytest.approx(offset)
