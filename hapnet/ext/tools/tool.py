"""A rigid tool: points of its surface that touch solids, its inertia, and its shape in pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import cos, pi, sin

from hapnet import checks
from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.solids.shapes import Cuboid, Cylinder, Shape

MOST_POINTS = 128
"""The greatest number of points of a tool."""


@dataclass(frozen=True)
class Tool:
    """A rigid tool. The pose's point is its centre of mass, and its principal axes are the pose's arms.

    points : of its surface, (N, 3) [m] from the centre: only these touch. size : of the box that is drawn [m].
    round : whether it is a cylinder along z instead. closed : whether solids' edges touch its faces, too.
    inertia : about its axes (3,) [kg m^2]; None: that of a uniform box or cylinder of this size.

    Raises InvalidParameter.
    """

    name: str
    points: tuple[Vector, ...]
    size: Vector = (0.01, 0.01, 0.01)
    inertia: Vector | None = None
    round: bool = False
    closed: bool = False

    def __post_init__(self) -> None:
        if not 1 <= len(self.points) <= MOST_POINTS:
            raise InvalidParameter("points", len(self.points), f"1 to {MOST_POINTS}")
        for point in self.points:
            checks.vector("points", point, 3)
        for length in checks.vector("size", self.size, 3):
            checks.positive("size", length)

    def inertia_of(self, mass: float) -> Vector:
        """Its inertia about its axes (3,) [kg m^2] with this mass [kg]."""
        if self.inertia is not None:
            return self.inertia
        a, b, c = (length * length for length in self.size)
        if self.round:  # m (3 r^2 + c^2)/12 across and m r^2/2 along, r = a/2
            across = mass * (0.75 * a + c) / 12.0
            return (across, across, 0.125 * mass * a)
        return (mass * (b + c) / 12.0, mass * (a + c) / 12.0, mass * (a + b) / 12.0)

    @property
    def form(self) -> Shape | None:
        """The tool's surface, in its axes; None: only its points touch."""
        if not self.closed:
            return None
        width, _, length = self.size
        return Cylinder((0.0, 0.0, 0.0), 0.5 * width, length) if self.round else Cuboid((0.0, 0.0, 0.0), self.size)


def box(size: Vector) -> Tool:
    """A box of this size [m], which touches with its corners and its faces."""
    halves = [0.5 * length for length in size]
    corners = product(*[(-half, half) for half in halves])
    return Tool("box", tuple(corners), size, closed=True)


def peg(radius: float, length: float) -> Tool:
    """A round peg along its z axis [m]. It touches with three rings of eight points, the middle of its end, and its
    faces."""
    rings = [
        (radius * cos(2.0 * pi * k / 8), radius * sin(2.0 * pi * k / 8), z)
        for z in (-0.5 * length, 0.0, 0.5 * length)
        for k in range(8)
    ]
    return Tool(
        "peg", ((0.0, 0.0, -0.5 * length), *rings), (2.0 * radius, 2.0 * radius, length), round=True, closed=True
    )


def stick(length: float) -> Tool:
    """A thin stick along its z axis, which touches with its lower end and with its middle [m]."""
    return Tool("stick", ((0.0, 0.0, -0.5 * length), (0.0, 0.0, 0.0)), (0.004, 0.004, length), round=True)


def place(x: Sequence[float], point: Sequence[float], arm_m: float, *, home: bool = True) -> Vector:
    """``c + sum a_j P_j/l`` of a place `point` in the body's axes [m]; if `home` is false, x are velocities."""
    a, b, c = (part / arm_m for part in point)
    p, q, r = point if home else (0.0, 0.0, 0.0)
    return (
        x[0] + p + a * x[3] + b * x[6] + c * x[9],
        x[1] + q + a * x[4] + b * x[7] + c * x[10],
        x[2] + r + a * x[5] + b * x[8] + c * x[11],
    )
