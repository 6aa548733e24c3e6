"""The parts of solids that touch a tool's faces: points of their edges, and balls.

Tests of a tool's points against solids miss a solid's edge that lies between these points. So contacts are found both
ways, as with vertices and faces of two meshes: points at rest are tested against the tool's own box or cylinder, too.
Where such a point lies on the tool, the tool's surface there moves into it along its normal. So in a step it is a plane
at a point of the body like any other, and the energy of `hapnet.ext.tools.contacts` applies unchanged.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import ceil, cos, pi, sin

from hapnet.checks import Vector
from hapnet.ext.solids.hole import Hole
from hapnet.ext.solids.rigid_contacts import Solid
from hapnet.ext.solids.secant import Secant
from hapnet.ext.solids.shapes import Cuboid, Cylinder, Near, Shape, Sphere
from hapnet.ext.tools.tool import Tool, place
from hapnet.mechanics.curvature import across
from hapnet.mechanics.pose import arm, in_world

AROUND = 24
"""The number of points of a circle; they differ from it by at most 0.9 % of its radius."""

_SPACING_M, _MOST = 0.005, 8
"""The distance of the points of a straight edge [m], and the greatest number of its parts."""


class EdgePoint(Secant):
    """A point `at` (3,) [m] of a solid near the tool, which is `form` in its own axes, or a ball around it.

    ball_m : radius of the ball [m]. arm_m : the length of the pose's arms [m].
    """

    def __init__(self, at: Vector, solid: Solid, form: Shape, arm_m: float, ball_m: float = 0.0) -> None:
        super().__init__(form, solid.stiffness, solid.damping, solid.friction)
        self.shape = self
        self._at, self._tool, self._arm_m, self._ball_m = at, form, arm_m, ball_m
        self._pose: Sequence[float] = ()
        self._point = self._x = at
        self._begun = Near(0.0, at)

    def begin(self, pose: Sequence[float]) -> tuple[Vector, Vector]:
        """The tool's point that may touch, in the tool's axes and in the world.

        pose : of the tool (12,) [m], as a list whose later changes count until the next call.
        """
        self._pose = pose
        local = _in_body(pose, self._arm_m, self._at)
        distance, out = self._tool.near(local)
        share = distance if self._ball_m else 0.0
        self._point = (local[0] - share * out[0], local[1] - share * out[1], local[2] - share * out[2])
        self._x, self._begun = place(pose, self._point, self._arm_m), self._in_world(distance, out)
        return self._point, self._x

    def near(self, x: Vector) -> Near:
        """The distance with the tool's point at `x` [m], for the tool's orientation at the start or now."""
        if x == self._x:
            return self._begun
        here = place(self._pose, self._point, self._arm_m)
        a, b, c = self._at
        at = (a + here[0] - x[0], b + here[1] - x[1], c + here[2] - x[2])
        return self._in_world(*self._tool.near(_in_body(self._pose, self._arm_m, at)))

    def _in_world(self, distance: float, out: Vector) -> Near:
        u, v, w = in_world(self._pose, self._arm_m, out)
        return Near(distance - self._ball_m, (-u, -v, -w))

    def farther_than(self, reach: float, x: Vector) -> bool:
        """Whether it is known to be farther than `reach`: only in its place at the start, as the tool turns later."""
        return x == self._x and self._begun.distance_m > reach


def edge_points(tool: Tool, solids: Sequence[Solid], arm_m: float) -> list[EdgePoint]:
    """The edge points of the solids, for a tool with faces that touch."""
    form = tool.form
    if form is None:
        return []
    found = [EdgePoint(at, solid, form, arm_m) for solid in solids for at in points_of(solid.shape)]
    balls = [(solid, solid.shape) for solid in solids if isinstance(solid.shape, Sphere)]
    return found + [EdgePoint(tuple(ball.centre), solid, form, arm_m, ball.radius) for solid, ball in balls]


def points_of(shape: Shape) -> list[Vector]:
    """Points of the edges of a shape [m]: of a box, a cylinder, the mouth of a hole. Other shapes have none here."""
    if type(shape) is Cuboid:
        return _of_a_box(tuple(shape.centre), tuple(shape.size))
    if type(shape) is Cylinder:
        axes = [0.0, 0.0, 0.0]
        axes[shape.axis] = 1.0
        ends = [
            [c + side * 0.5 * shape.length * a for c, a in zip(shape.centre, axes, strict=True)] for side in (-1, 1)
        ]
        return [at for end in ends for at in _circle(end, axes, shape.radius)]
    if isinstance(shape, Hole):
        below = [a + shape.chamfer * n for a, n in zip(shape.at, shape.normal, strict=True)]
        lower = _circle(below, shape.normal, shape.radius)
        return lower + (_circle(shape.at, shape.normal, shape.radius + shape.chamfer) if shape.chamfer else [])
    return []


def _circle(middle: Sequence[float], normal: Sequence[float], radius: float) -> list[Vector]:
    one, other = across(tuple(normal))
    turns = [2.0 * pi * k / AROUND for k in range(AROUND)]
    return [
        tuple([m + radius * (cos(t) * a + sin(t) * b) for m, a, b in zip(middle, one, other, strict=True)])
        for t in turns
    ]


def _of_a_box(centre: Vector, size: Vector) -> list[Vector]:
    """The corners of a box, and points between them."""
    found: dict[Vector, None] = {}
    for axis, length in enumerate(size):
        parts = min(_MOST, ceil(length / _SPACING_M))
        along = [length * (k / parts - 0.5) for k in range(parts + 1)]
        sides = [along if i == axis else [-0.5 * size[i], 0.5 * size[i]] for i in range(3)]
        for offset in product(*sides):
            found[tuple([round(c + o, 12) for c, o in zip(centre, offset, strict=True)])] = None
    return list(found)


def _in_body(pose: Sequence[float], arm_m: float, at: Vector) -> Vector:
    """The place `at` (3,) [m] in the body's axes: ``R' (at - c)``."""
    a, b, c = at[0] - pose[0], at[1] - pose[1], at[2] - pose[2]
    rods = [arm(pose, arm_m, j) for j in range(3)]
    return tuple([(a * rod[0] + b * rod[1] + c * rod[2]) / arm_m for rod in rods])
