"""Worlds and devices of a user's own, whose defaults and declarations are not hapnet's."""

from __future__ import annotations

from hapnet import Scene
from hapnet.plant.scenes.box import box_walls


def corridor(
    *, dof: int = 1, stiffness: float = 500.0, damping: float = 3.0, size: float = 0.02, step_max_s: float = 0.02
) -> Scene:
    """Softer and narrower than hapnet's box."""
    return Scene("corridor", dof, box_walls(dof, size, stiffness, damping), max_s=step_max_s)


def hinge(*, dof: int = 1, stiffness: float = 7.0, damping: float = 0.2) -> Scene:
    """In radians, with stops of its own."""
    return Scene("hinge", dof, box_walls(dof, 0.3, stiffness, damping), units="rad")


def spring(position: tuple[float, ...], velocity: tuple[float, ...], time_s: float) -> tuple[float, ...]:
    return tuple(-20.0 * x for x in position)


class Block:
    """It steps by itself."""

    dof = 1

    def step(self, dt: float, position: tuple[float, ...], velocity: tuple[float, ...]) -> float:
        return -50.0 * max(0.0, position[0])


class Knob:
    """A device that says what it is."""

    dof, force_limit, resolution = 1, 2.0, 1e-5
    rate_hz, stiffness_range, greatest_speed, workspace = 500.0, (5.0, 900.0), 0.4, 0.3

    def __init__(self, dof: int) -> None: ...
    def read(self) -> tuple[tuple[float], tuple[float]]:
        return (0.0,), (0.0,)

    def apply(self, force: tuple[float, ...]) -> None: ...
