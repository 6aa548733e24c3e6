"""Solids for tests: meshes made by formulas, and an account of each step that is written from the equations."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hapnet.checks import Array
from hapnet.ext.solids.shapes import Cuboid, Cylinder, HalfSpace, Shape, Sphere, Textured
from hapnet.mechanics.contacts import Inverse, Surroundings

CENTRE = (0.05, 0.0, 0.0)


def torus(around: int = 100, across: int = 50, centre: Sequence[float] = (0.062, 0.0, 0.0)) -> tuple[Array, Any]:
    """Vertices [m] and triangles of a torus about z, 30 mm and 12 mm; 10,000 triangles by default."""
    u, v = np.meshgrid(
        2.0 * np.pi * np.arange(around) / around, 2.0 * np.pi * np.arange(across) / across, indexing="ij"
    )
    ring = 0.03 + 0.012 * np.cos(v)
    vertices = np.stack([ring * np.cos(u), ring * np.sin(u), 0.012 * np.sin(v)], axis=-1).reshape(-1, 3) + centre
    i, j = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    a, b = i * across + j, (i + 1) % around * across + j
    c, d = (i + 1) % around * across + (j + 1) % across, i * across + (j + 1) % across
    return vertices, np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)


def stair(centre: Sequence[float] = (0.0, 0.0, 0.0)) -> tuple[Array, Any]:
    """An L, extruded by 20 mm: it has a concave edge, and corners of all kinds. 20 triangles."""
    outline = 0.01 * np.array([(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)], dtype=float)
    low = np.column_stack([outline, np.zeros(6)])
    vertices = np.concatenate([low, low + np.array([0.0, 0.0, 0.02])]) + centre
    top = np.array([(6, 7, 8), (6, 8, 9), (6, 9, 10), (6, 10, 11)])
    bottom = top[:, ::-1] - 6
    sides = [t for i in range(6) for j in [(i + 1) % 6] for t in ((i, j, j + 6), (i, j + 6, i + 6))]
    return vertices, np.concatenate([bottom, top, np.array(sides)])


def write_stl(file: Path, vertices: Array, triangles: Any, scale: float = 1e3) -> Path:
    """An ASCII STL; its unit is the millimetre by default."""
    lines = ["solid made by a test"]
    for corners in (scale * vertices)[triangles].tolist():
        lines += ["facet normal 0 0 0", "outer loop", *("vertex {} {} {}".format(*corner) for corner in corners)]
        lines += ["endloop", "endfacet"]
    file.write_text("\n".join([*lines, "endsolid", ""]))
    return file


SHAPES: dict[str, Shape] = {
    "sphere": Sphere(CENTRE, 0.03),
    "cuboid": Cuboid(CENTRE, (0.06, 0.06, 0.06)),
    "bar": Cuboid(CENTRE, (0.06, 0.012, 0.012)),
    "cylinder": Cylinder(CENTRE, 0.03, 0.06),
    "lying cylinder": Cylinder(CENTRE, 0.03, 0.06, axis=1),
    "plane": HalfSpace((1.0, 0.3, -0.1), 0.02),
    "ripple": Textured(HalfSpace((1.0, 0.0, 0.0), 0.02), 0.0009, 0.004),
    "rough sphere": Textured(Sphere(CENTRE, 0.03), 0.0006, 0.003),
}


@dataclass
class Account:
    """Watches the steps of a mass among surroundings, as their `solve` sees them.

    M, B, K : of the world's side, (n, n).
    """

    contacts: Surroundings
    M: Array
    B: Array
    K: Array
    work_J: float = 0.0  #: W_env = -sum f . vhat T
    least_slack_J: float = 0.0  #: of W_env - (stored - stored at the start)
    least_work_J: float = 0.0
    worst_J: float = 0.0  #: the greatest |(13)|
    forces: list[Array] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._solve = self.contacts.solve
        self._stored = self.contacts.stored_J((0.0,) * len(self.M))
        self.contacts.solve = self.solve  # type: ignore[method-assign]

    def solve(
        self, dt: float, position: Sequence[float], velocity: list[float], inverse: Inverse
    ) -> tuple[Sequence[float], list[float]]:
        force, vhat = self._solve(dt, position, velocity, inverse)
        A = 2.0 / dt * self.M + self.B + 0.5 * dt * self.K
        f, v, w = np.array(force), np.array(vhat), np.array(velocity)
        self.worst_J = max(self.worst_J, abs(dt * float(v @ (A @ (v - w) - f))))
        self.work_J -= dt * float(f @ v)
        end = tuple((np.array(position) + dt * v).tolist())
        stored = self.contacts.stored_J(end) - self._stored
        self.least_slack_J = min(self.least_slack_J, self.work_J - stored)
        self.least_work_J = min(self.least_work_J, self.work_J)
        self.forces.append(f)
        return force, vhat

    def close(self) -> None:
        """Assert what every scene must keep."""
        assert self.worst_J <= 1e-14
        assert self.least_slack_J >= -1e-14
        assert self.least_work_J >= -1e-14
        assert np.any(self.forces)
