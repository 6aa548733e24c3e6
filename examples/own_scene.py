"""A world of your own: a corridor in the plane with one soft and one hard wall, slow to compute.

hapnet simulate --scene examples.own_scene:corridor --operator sine
"""

from __future__ import annotations

from hapnet.plant.contact import Wall
from hapnet.plant.scene import Scene


def corridor(*, dof: int = 2, stiffness: float = 2000.0) -> Scene:
    """Free between x = -20 mm (ten times softer) and x = 20 mm; a step takes 20 to 80 ms."""
    walls = (
        Wall((1.0,) + (0.0,) * (dof - 1), 0.02, stiffness, 5.0),
        Wall((-1.0,) + (0.0,) * (dof - 1), 0.02, stiffness / 10.0, 1.0),
    )
    return Scene("corridor", dof, walls, 0.02, 0.08)


if __name__ == "__main__":
    from hapnet.cli import main

    raise SystemExit(
        main(["simulate", "--scene", "examples.own_scene:corridor", "--operator", "sine", "--out", "runs/corridor"])
    )
