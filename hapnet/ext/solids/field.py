"""Solids given by a number at each place: a function of the position, or a grid of voxels.

The number is below 0 inside. If it is a distance, it is used directly. For any other function f, such as a gyroid's,
the distance is taken to be ``f/|grad f|``, which is right to first order near the surface (Taubin 1991). The gradient
is computed by central differences. The curvature is the change of the unit gradient along two directions in the
tangent plane; a level set at the distance d has the curvature ``k/(1 + k d)`` where the surface has k.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from itertools import product
from math import hypot, isfinite, sqrt

import numpy as np

from hapnet import checks
from hapnet.checks import Array, Vector
from hapnet.errors import HapnetError, InvalidParameter
from hapnet.ext.solids.secant import along
from hapnet.ext.solids.shapes import Near
from hapnet.loading import failure
from hapnet.mechanics.curvature import Curvature, Curvatures, across
from hapnet.records.vectors import inner

REACH_M = 0.12
"""Half side of the cube about its origin in which a function is sampled."""

_SAMPLES = 13
"""Places along each side of that cube."""

_CUBES = 41
"""Places along each side where a function is evaluated for its picture."""

_STEP_M = 2e-5
"""Step of a function's differences."""

_FLATTEST = 0.3
"""A gradient below this share of the usual one belongs to an edge or a middle, where f/|grad f| is no distance."""

_DISTANCE = 0.01
"""If a function's gradient differs from 1 by less than this nearly everywhere, the function is a distance."""

_FLAT_PER_M, _SHARP_PER_M = 1e-3, 1e3
"""A curvature below the first counts as 0, and so does one above the second: it belongs to an edge."""


class FieldShape:
    """The common part of the two kinds of fields: a `hapnet.ext.solids.shapes.Shape` with curvatures."""

    slope: float = 1.0
    _bend_m: float = 2e-4

    @abstractmethod
    def near(self, position: Vector) -> Near:
        """Distance and unit gradient at `position` (3,) [m]."""

    @abstractmethod
    def sampled(self) -> tuple[list[Array], Array]:
        """Coordinates along each axis [m], and the values, below 0 inside, at all places (nx, ny, nz), for pictures."""

    def curvatures(self, position: Vector) -> Curvatures:
        """Principal curvatures of the surface where it is nearest to `position` (3,) [m]."""
        distance, normal = self.near(position)
        one, other = across(normal)
        h = self._bend_m
        changes = []
        for direction in (one, other):
            ahead = self.near(along(position, direction, h)).gradient
            behind = self.near(along(position, direction, -h)).gradient
            changes.append([(a - b) / (2.0 * h) for a, b in zip(ahead, behind, strict=True)])
        shape = [[inner(change, direction) for direction in (one, other)] for change in changes]
        values, basis = np.linalg.eigh(0.5 * (np.array(shape) + np.transpose(shape)))
        found = []
        for k, (a, b) in zip(values.tolist(), basis.T.tolist(), strict=True):
            bend = k / (1.0 - k * distance) if k * distance < 0.5 else 2.0 * k
            if _FLAT_PER_M < abs(bend) < _SHARP_PER_M:
                direction = tuple([a * p + b * q for p, q in zip(one, other, strict=True)])
                found.append(Curvature(direction, bend))
        return tuple(found)


class DistanceFunction(FieldShape):
    """The solid where a function of the position (3,) [m] is below 0.

    function : returns a finite number. name : of it, for messages. at : (3,) place of the function's origin [m].

    Raises InvalidParameter: it raises an error or returns no finite number, or there is no solid within `REACH_M` of
    the function's origin.
    """

    def __init__(self, function: Callable[[Vector], float], name: str, at: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        self._function, self.name = function, name
        self.at: Vector = checks.vector("at", at, 3)
        self._least = 0.0
        ticks = np.linspace(-REACH_M, REACH_M, _SAMPLES).tolist()
        places = [along(self.at, offset, 1.0) for offset in product(ticks, ticks, ticks)]
        try:
            values = np.array([self._value(place) for place in places])
            if not (values < 0.0).any():
                allowed = f"a function that is below 0 somewhere within {REACH_M:g} m of its origin: there is its solid"
                raise InvalidParameter("sdf", name, allowed)
            steep = np.array([hypot(*self._gradient(place)) for place in places])
        except HapnetError as error:
            if isinstance(error, InvalidParameter):
                raise
            raise InvalidParameter("sdf", name, f"a function that gives a number for each place ({error})") from error
        usual = float(np.median(steep[np.argsort(np.abs(values) / np.maximum(steep, 1e-300))[: len(places) // 20]]))
        self._least = _FLATTEST * usual
        inside, margin = np.array(places)[values < 0.0], ticks[1] - ticks[0]
        self._extent = inside.min(axis=0) - margin, inside.max(axis=0) + margin  # of the part within reach
        self._measures = bool(np.quantile(np.abs(steep - 1.0), 0.9) < _DISTANCE)
        self.slope = 1.0 if self._measures else 2.0

    def near(self, position: Vector) -> Near:
        value, gradient = self._value(position), self._gradient(position)
        steep = hypot(*gradient)
        distance = value if self._measures else value / max(steep, self._least)
        if not steep:  # all directions are alike
            return Near(distance, (1.0, 0.0, 0.0))
        return Near(distance, tuple([part / steep for part in gradient]))

    def sampled(self) -> tuple[list[Array], Array]:
        axes = [np.linspace(low, high, _CUBES) for low, high in zip(*self._extent, strict=True)]
        return axes, np.array([[[self._value((x, y, z)) for z in axes[2]] for y in axes[1]] for x in axes[0]])

    def _gradient(self, position: Vector) -> Vector:
        return tuple(
            [
                (self._value(along(position, unit, _STEP_M)) - self._value(along(position, unit, -_STEP_M)))
                / (2.0 * _STEP_M)
                for unit in _UNITS
            ]
        )

    def _value(self, position: Vector) -> float:
        a, b, c = self.at
        try:
            value = float(self._function((position[0] - a, position[1] - b, position[2] - c)))
        except BaseException as error:  # see `failure`
            raise HapnetError(f"the scene sdf:{self.name} failed: {failure(error)}") from error
        if not isfinite(value):
            raise HapnetError(f"the scene sdf:{self.name} failed: it gave {value} at {position}")
        return value


class VoxelGrid(FieldShape):
    """The solid where a grid of distances is below 0; between its points they are interpolated (trilinear).

    distances : (nx, ny, nz) [m], two or more along each axis. spacing : (3,) [m]. low : (3,) of the first point [m].
    """

    def __init__(self, distances: Array, spacing: Sequence[float], low: Sequence[float]) -> None:
        self.distances: Array = distances
        self.spacing: Vector = checks.vector("spacing", spacing, 3)
        self.low: Vector = checks.vector("low", low, 3)
        self._last = tuple([length - 1.0 for length in distances.shape])
        steps = np.gradient(distances, *self.spacing)
        self._field = np.ascontiguousarray(np.stack([distances, *steps], axis=-1))
        self._bend_m = max(self.spacing)

    def near(self, position: Vector) -> Near:
        inside, away = [], []
        for x, low, step, last in zip(position, self.low, self.spacing, self._last, strict=True):
            u = (x - low) / step
            within = min(max(u, 0.0), last)
            inside.append(within)
            away.append((u - within) * step)
        i, j, k = (min(int(u), int(last) - 1) for u, last in zip(inside, self._last, strict=True))
        u, v, w = inside[0] - i, inside[1] - j, inside[2] - k
        cell = self._field[i : i + 2, j : j + 2, k : k + 2]
        flat = cell[0] * (1.0 - u) + cell[1] * u
        row = flat[0] * (1.0 - v) + flat[1] * v
        distance, a, b, c = (row[0] * (1.0 - w) + row[1] * w).tolist()
        size = sqrt(a * a + b * b + c * c) or 1.0
        gradient = (a / size, b / size, c / size)
        if any(away):  # nothing in the box is nearer than this
            above = max(0.0, distance)
            distance = hypot(*away, above)
            gradient = tuple([(part + above * g) / distance for part, g in zip(away, gradient, strict=True)])
            size = hypot(*gradient)
            gradient = tuple([part / size for part in gradient]) if size else (1.0, 0.0, 0.0)
        return Near(distance, gradient)

    def sampled(self) -> tuple[list[Array], Array]:
        counts = self.distances.shape
        axes = [low + step * np.arange(n) for low, step, n in zip(self.low, self.spacing, counts, strict=True)]
        return axes, self.distances


_UNITS: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
