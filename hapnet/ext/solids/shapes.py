"""Shapes of solids as signed distances: positive outside, with their gradient, which points out of the solid."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, hypot, inf, isfinite, pi, sin, sqrt
from typing import Annotated, NamedTuple, Protocol, runtime_checkable

from hapnet import checks
from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.mechanics.curvature import Bends, Curvature, Curvatures, across_in_space
from hapnet.records.record import AXES, Reals, Record, equation, zero
from hapnet.records.vectors import length as length_of

Triple = tuple[float, float, float]


class Near(NamedTuple):
    """A point's distance from a solid."""

    distance_m: float  #: below 0 inside
    gradient: Vector  #: (3,); of unit length, but for a textured shape


class Shape(Protocol):
    """A solid in three dimensions. With fewer axes it is cut where the missing coordinates are 0."""

    @property
    def slope(self) -> float:
        """The most that the distance changes per metre of path; 1, except for a textured shape."""

    def near(self, position: Vector) -> Near:
        """The distance and its gradient at `position` (3,) [m]."""


@runtime_checkable
class Bent(Protocol):
    """A shape with known curvatures of its surface."""

    def curvatures(self, position: Vector) -> Curvatures:
        """Principal curvatures where the surface is nearest to `position` (3,) [m]. None: it is flat, or an edge."""


UNKNOWN, HALF_SPACE, SPHERE, CUBOID, CYLINDER = range(5)
"""The kinds of forms."""


class Form(Record):
    """A shape with a formula, for equations: its kind, its numbers, and its relief; a height of 0: no relief.

    axis : of a cylinder. centre, size, radius, length : [m]. out : the unit vector out of a half space, `offset` [m]
    along which its surface is. height : a third of the relief's [m]. wave : its 2 pi / wavelength [1/m].
    """

    what: int
    axis: int
    centre: Annotated[Vector, (AXES,)]
    size: Annotated[Vector, (AXES,)]
    out: Annotated[Vector, (AXES,)]
    radius: float
    length: float
    offset: float
    height: float
    wave: float
    slope: float

    def __init__(self) -> None:
        super().__init__()
        self.slope = 1.0


class HalfSpace(Form):
    """Solid where ``normal . x > offset`` [m]; `normal` (3,) has any length."""

    def __init__(self, normal: Sequence[float], offset: float) -> None:
        super().__init__()
        into = checks.vector("normal", normal, 3)
        length = hypot(*into)
        if not 0.0 < length < inf:
            raise InvalidParameter("normal", normal, "a vector of non-zero length")
        x, y, z = [-part / length for part in into]
        self.normal: tuple[float, float, float] = (-x, -y, -z)
        self.what, self.offset, self.out = HALF_SPACE, _finite("offset", offset), (x, y, z)

    @equation
    def near(self: Form, position: Vector) -> Near:
        x, y, z = triple(self.out)
        return Near(self.offset + x * position[0] + y * position[1] + z * position[2], (x, y, z))


class Sphere(Form):
    """A ball of `radius` [m] around `centre` (3,) [m]."""

    def __init__(self, centre: Sequence[float], radius: float) -> None:
        super().__init__()
        self.what, self.centre = SPHERE, checks.vector("centre", centre, 3)
        self.radius = checks.positive("radius", radius)

    @equation
    def near(self: Form, position: Vector) -> Near:
        x, y, z = away(self, position)
        length = sqrt(x * x + y * y + z * z)
        if length == 0.0:  # all directions are alike
            return Near(-self.radius, (1.0, 0.0, 0.0))
        return Near(length - self.radius, (x / length, y / length, z / length))

    def curvatures(self, position: Vector) -> Curvatures:
        return _curvatures(self, position)


class Cuboid(Form):
    """A box with faces across the axes, `size` (3,) [m] from face to face, around `centre` (3,) [m]."""

    def __init__(self, centre: Sequence[float], size: Sequence[float]) -> None:
        super().__init__()
        self.what, self.centre = CUBOID, checks.vector("centre", centre, 3)
        self.size = tuple([checks.positive("size", side) for side in checks.vector("size", size, 3)])

    @equation
    def near(self: Form, position: Vector) -> Near:
        x, y, z = away(self, position)
        size = self.size
        a, b, c = abs(x) - 0.5 * size[0], abs(y) - 0.5 * size[1], abs(z) - 0.5 * size[2]
        deepest = max(a, b, c)
        if deepest <= 0.0:
            if a == deepest:
                return Near(deepest, (sign(x), 0.0, 0.0))
            return Near(deepest, (0.0, sign(y), 0.0) if b == deepest else (0.0, 0.0, sign(z)))
        a, b, c = max(0.0, a), max(0.0, b), max(0.0, c)
        length = length_of(3, (a, b, c))
        return Near(length, (sign(x) * a / length, sign(y) * b / length, sign(z) * c / length))


class Cylinder(Form):
    """A cylinder of `radius` and `length` [m] along the axis with index `axis`, around `centre` (3,) [m]."""

    def __init__(self, centre: Sequence[float], radius: float, length: float, axis: int = 2) -> None:
        super().__init__()
        self.what, self.centre = CYLINDER, checks.vector("centre", centre, 3)
        self.radius = checks.positive("radius", radius)
        self.length = checks.positive("length", length)
        if axis not in (0, 1, 2):
            raise InvalidParameter("axis", axis, "0, 1 or 2")
        self.axis = axis

    @equation
    def near(self: Form, position: Vector) -> Near:
        axis, off = self.axis, away(self, position)
        along = off[axis]
        x, y, z = changed(off, axis, 0.0)
        off_axis = length_of(3, (x, y, z))
        side, end = off_axis - self.radius, abs(along) - 0.5 * self.length
        aside, lengthwise = (1.0, 0.0) if side > end else (0.0, 1.0)
        distance = max(side, end)
        if side > 0.0 and end > 0.0:
            distance = length_of(2, (side, end, 0.0))
            aside, lengthwise = side / distance, end / distance
        if off_axis == 0.0:  # on the axis all directions are alike
            off_axis = 1.0
            x, y, z = changed((x, y, z), (axis + 1) % 3, 1.0)
        across = (aside * x / off_axis, aside * y / off_axis, aside * z / off_axis)
        return Near(distance, changed(across, axis, lengthwise * sign(along)))

    def curvatures(self, position: Vector) -> Curvatures:
        """Curvature of the side, around the axis."""
        return _curvatures(self, position)


class Textured(Form):
    """A shape with a relief: its surface is raised by ``height/3 (sin kx + sin ky + sin kz)``.

    height, wavelength : [m]; k = 2 pi / wavelength.
    """

    def __init__(self, shape: Shape, height: float, wavelength: float) -> None:
        super().__init__()
        self.shape = shape
        if type(shape) in _FORMULAS:
            vars(self).update(vars(shape))
        self.wave = 2.0 * pi / checks.positive("wavelength", wavelength)
        self.height = checks.non_negative("height", height) / 3.0
        steepness = self.height * self.wave * sqrt(3.0)
        if not steepness <= _STEEPEST:
            raise InvalidParameter("height", height, f"a relief that rises by {_STEEPEST:g} per metre at most")
        self.slope = shape.slope + steepness

    def near(self, position: Vector) -> Near:
        return raised(self, self.shape.near(position), position)


class Offset:
    """The part of a shape that lies `depth` [m] or more below its surface: a layer."""

    def __init__(self, shape: Shape, depth: float) -> None:
        self.shape = shape
        self.depth: float = checks.positive("depth", depth)
        self.slope: float = shape.slope

    def near(self, position: Vector) -> Near:
        distance, gradient = self.shape.near(position)
        return Near(distance + self.depth, gradient)

    def curvatures(self, position: Vector) -> Curvatures:
        """The curvatures of the layer, k/(1 - k depth) for a surface of curvature k; none where the layer is sharp."""
        bends = self.shape.curvatures(position) if isinstance(self.shape, Bent) else ()
        return tuple([Curvature(e, k / (1.0 - k * self.depth)) for e, k in bends if k * self.depth < 0.9])


_FORMULAS = (HalfSpace, Sphere, Cuboid, Cylinder)
_STEEPEST = 0.9

_of_half_space, _of_sphere, _of_cuboid, _of_cylinder = HalfSpace.near, Sphere.near, Cuboid.near, Cylinder.near


def form_of(shape: Shape) -> Form | None:
    """The form of a shape; None: there is no equation for it."""
    known = type(shape) in (*_FORMULAS, Textured)
    return shape if known and isinstance(shape, Form) and shape.what != UNKNOWN else None


@equation
def near_form(form: Form, position: Vector) -> Near:
    """The distance and its gradient at a position, for any form: `Shape.near`."""
    if form.what == SPHERE:
        found = _of_sphere(form, position)
    elif form.what == CUBOID:
        found = _of_cuboid(form, position)
    elif form.what == CYLINDER:
        found = _of_cylinder(form, position)
    else:
        found = _of_half_space(form, position)
    return raised(form, found, position) if form.height > 0.0 else found


@equation
def raised(form: Form, near: Near, position: Vector) -> Near:
    """Return a shape's distance and gradient with the relief added."""
    distance, (a, b, c) = near
    wave, height = form.wave, form.height
    x, y, z = wave * position[0], wave * position[1], wave * position[2]
    steep = height * wave
    return Near(
        distance - height * (sin(x) + sin(y) + sin(z)), (a - steep * cos(x), b - steep * cos(y), c - steep * cos(z))
    )


@equation
def round_form(form: Form, gradient: Vector, bends: Bends) -> None:
    """Put the known curvatures of a form into `bends`, at the place that has this gradient."""
    if form.wave != 0.0 or not (form.what == SPHERE or form.what == CYLINDER):
        return
    if form.what == SPHERE:
        one, other = across_in_space(gradient)
        put_bend(bends, one, 1.0 / form.radius)
        put_bend(bends, other, 1.0 / form.radius)
    elif gradient[form.axis] == 0.0:  # the side, around the axis
        axis = form.axis
        around = changed((0.0, 0.0, 0.0), (axis + 1) % 3, -gradient[(axis + 2) % 3])
        put_bend(bends, changed(around, (axis + 2) % 3, gradient[(axis + 1) % 3]), 1.0 / form.radius)


@equation
def put_bend(bends: Bends, direction: Vector, per_m: float) -> None:
    """Add a curvature."""
    k = bends.count
    for i in range(3):
        bends.directions[k][i] = direction[i]
    bends.per_m[k], bends.count = per_m, k + 1


def _curvatures(form: Sphere | Cylinder, position: Vector) -> Curvatures:
    bends = zero(Bends)
    round_form(form, form.near(position).gradient, bends)
    return bends.curvatures


@equation
def triple(vector: Reals) -> Triple:
    """A vector of three as a tuple."""
    return (vector[0], vector[1], vector[2])


@equation
def away(form: Form, position: Vector) -> Triple:
    """The vector from the centre to `position` [m]."""
    centre = form.centre
    return (position[0] - centre[0], position[1] - centre[1], position[2] - centre[2])


@equation
def changed(vector: Vector, axis: int, value: float) -> Triple:
    """The vector with another component along an axis."""
    return (value if axis == 0 else vector[0], value if axis == 1 else vector[1], value if axis == 2 else vector[2])


@equation
def sign(value: float) -> float:
    """-1 or 1."""
    return -1.0 if value < 0.0 else 1.0


def _finite(name: str, value: float) -> float:
    if not isfinite(value):
        raise InvalidParameter(name, value, "a finite number")
    return float(value)
