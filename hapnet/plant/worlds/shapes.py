"""Shapes of solids as signed distances: positive outside, with their gradient, which points out of the solid."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, hypot, inf, isfinite, pi, sin, sqrt
from operator import sub
from typing import NamedTuple, Protocol, runtime_checkable

from hapnet import checks
from hapnet.checks import Vector
from hapnet.errors import InvalidParameter
from hapnet.mechanics.curvature import Curvature, Curvatures, round_all_over


class Near(NamedTuple):
    """A point's distance from a solid."""

    distance_m: float  #: below 0 inside
    gradient: Vector  #: (3,); of unit length, but for a textured shape


class Shape(Protocol):
    """A solid in three dimensions. With fewer axes it is cut where the missing coordinates are 0."""

    @property
    def slope(self) -> float:
        """The most that the distance changes per metre of path; 1, except for a textured shape."""

    @property
    def flat_m(self) -> float:
        """Within this distance of a place its tangent plane may stand for the solid [m]; 0: ask again."""

    def near(self, position: Vector) -> Near:
        """The distance and its gradient at `position` (3,) [m]."""


@runtime_checkable
class Bent(Protocol):
    """A shape that knows how its surface bends."""

    def curvatures(self, position: Vector) -> Curvatures:
        """Principal curvatures where the surface is nearest to `position` (3,) [m]. None: it is flat, or an edge."""


class HalfSpace:
    """Solid where ``normal . x > offset`` [m]; `normal` (3,) has any length."""

    slope: float = 1.0
    flat_m: float = 0.0

    def __init__(self, normal: Sequence[float], offset: float) -> None:
        into = checks.vector("normal", normal, 3)
        length = hypot(*into)
        if not 0.0 < length < inf:
            raise InvalidParameter("normal", normal, "a vector of non-zero length")
        x, y, z = [-part / length for part in into]
        self.normal: tuple[float, float, float] = (-x, -y, -z)
        self.offset: float = _finite("offset", offset)
        self._out = (x, y, z)

    def near(self, position: Vector) -> Near:
        x, y, z = self._out
        return Near(self.offset + x * position[0] + y * position[1] + z * position[2], self._out)


class Sphere:
    """A ball of `radius` [m] around `centre` (3,) [m]."""

    slope: float = 1.0
    flat_m: float = 0.0

    def __init__(self, centre: Sequence[float], radius: float) -> None:
        self.centre: Vector = checks.vector("centre", centre, 3)
        self.radius: float = checks.positive("radius", radius)

    def near(self, position: Vector) -> Near:
        x, y, z = map(sub, position, self.centre)
        length = sqrt(x * x + y * y + z * z)
        if length == 0.0:  # all directions are alike
            return Near(-self.radius, (1.0, 0.0, 0.0))
        return Near(length - self.radius, (x / length, y / length, z / length))

    def curvatures(self, position: Vector) -> Curvatures:
        return round_all_over(self.near(position).gradient, self.radius)


class Cuboid:
    """A box with faces across the axes, `size` (3,) [m] from face to face, around `centre` (3,) [m]."""

    slope: float = 1.0
    flat_m: float = 0.0

    def __init__(self, centre: Sequence[float], size: Sequence[float]) -> None:
        self.centre: Vector = checks.vector("centre", centre, 3)
        self.size: tuple[float, ...] = tuple([checks.positive("size", side) for side in checks.vector("size", size, 3)])

    def near(self, position: Vector) -> Near:
        away = list(map(sub, position, self.centre))
        beyond = [abs(part) - 0.5 * side for part, side in zip(away, self.size, strict=True)]
        deepest = max(beyond)
        if deepest <= 0.0:
            axis = beyond.index(deepest)
            return Near(deepest, tuple([_sign(part) if i == axis else 0.0 for i, part in enumerate(away)]))
        length = hypot(*[max(0.0, part) for part in beyond])
        return Near(
            length, tuple([_sign(part) * max(0.0, out) / length for part, out in zip(away, beyond, strict=True)])
        )


class Cylinder:
    """A cylinder of `radius` and `length` [m] along the axis with index `axis`, around `centre` (3,) [m]."""

    slope: float = 1.0
    flat_m: float = 0.0

    def __init__(self, centre: Sequence[float], radius: float, length: float, axis: int = 2) -> None:
        self.centre: Vector = checks.vector("centre", centre, 3)
        self.radius: float = checks.positive("radius", radius)
        self.length: float = checks.positive("length", length)
        if axis not in (0, 1, 2):
            raise InvalidParameter("axis", axis, "0, 1 or 2")
        self.axis = axis

    def near(self, position: Vector) -> Near:
        away = list(map(sub, position, self.centre))
        along = away[self.axis]
        away[self.axis] = 0.0
        off_axis = hypot(*away)
        side, end = off_axis - self.radius, abs(along) - 0.5 * self.length
        aside, lengthwise = (1.0, 0.0) if side > end else (0.0, 1.0)
        distance = max(side, end)
        if side > 0.0 and end > 0.0:
            distance = hypot(side, end)
            aside, lengthwise = side / distance, end / distance
        if off_axis == 0.0:  # on the axis all directions are alike
            away[(self.axis + 1) % 3] = off_axis = 1.0
        gradient = [aside * part / off_axis for part in away]
        gradient[self.axis] = lengthwise * _sign(along)
        return Near(distance, tuple(gradient))

    def curvatures(self, position: Vector) -> Curvatures:
        """Of the side, around the axis."""
        out = self.near(position).gradient
        if out[self.axis]:
            return ()
        around = [0.0, 0.0, 0.0]
        one, other = (self.axis + 1) % 3, (self.axis + 2) % 3
        around[one], around[other] = -out[other], out[one]
        return (Curvature(tuple(around), 1.0 / self.radius),)


class Textured:
    """A shape with a relief: its surface is raised by ``height/3 (sin kx + sin ky + sin kz)``.

    height, wavelength : [m]; k = 2 pi / wavelength.
    """

    def __init__(self, shape: Shape, height: float, wavelength: float) -> None:
        self.shape = shape
        self._wave = 2.0 * pi / checks.positive("wavelength", wavelength)
        self._height = checks.non_negative("height", height) / 3.0
        steepness = self._height * self._wave * sqrt(3.0)
        if not steepness <= _STEEPEST:
            raise InvalidParameter("height", height, f"a relief that rises by {_STEEPEST:g} per metre at most")
        self.slope: float = shape.slope + steepness
        self.flat_m: float = 0.0

    def near(self, position: Vector) -> Near:
        distance, (a, b, c) = self.shape.near(position)
        wave, height = self._wave, self._height
        x, y, z = wave * position[0], wave * position[1], wave * position[2]
        steep = height * wave
        return Near(
            distance - height * (sin(x) + sin(y) + sin(z)), (a - steep * cos(x), b - steep * cos(y), c - steep * cos(z))
        )


_STEEPEST = 0.9


def _sign(value: float) -> float:
    return -1.0 if value < 0.0 else 1.0


def _finite(name: str, value: float) -> float:
    if not isfinite(value):
        raise InvalidParameter(name, value, "a finite number")
    return float(value)
