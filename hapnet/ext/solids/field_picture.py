"""The picture of a world that is a function: arrows of a force, or pieces of the surface that its planes touch.

The function is evaluated once, at places around the origin, when the picture is made: at rest, and at the time 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import product
from math import sqrt

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.mechanics.plane import Plane
from hapnet.plant.worlds.picture import GREY, Color, Part, StillDefaults, Touch, part

REACH_M = 0.045
"""A field is drawn up to this distance from the origin [m]."""

_ARROW: Color = (202, 138, 4, 190)
_COUNT = {1: 19, 2: 11, 3: 7}  # places along each axis
_ROWS_M = (-0.03, -0.015, 0.015, 0.03)  # with one axis: the rows of its arrows
_FAINT = 0.01
"""Forces below this share of the strongest force are not drawn."""

_SAMPLES = {1: 31, 2: 31, 3: 13}
_SIDES = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def field(force: Callable[[Vector], Sequence[float] | float], dof: int) -> tuple[Part, ...]:
    """Arrows of `force` (n,) [N] at positions (n,) [m]; their length grows with its square root.

    No arrows with more than three axes, or if the function fails, returns no vector of `dof` numbers, or is zero
    everywhere: a picture raises no errors.
    """
    if dof not in _COUNT:
        return ()
    places = list(_grid(dof, _COUNT[dof]))
    try:
        forces = np.array([np.atleast_1d(force(place)) for place in places], dtype=float)
    except Exception:  # any error of a user's function: the run will report it
        return ()
    if forces.shape != (len(places), dof) or not np.isfinite(forces).all():
        return ()
    sizes = np.linalg.norm(forces, axis=1)
    top, cell = float(sizes.max()), 2.0 * REACH_M / (_COUNT[dof] - 1)
    if top <= 0.0:
        return ()
    vertices: list[Array] = []
    triangles: list[tuple[int, ...]] = []
    for place, one, size in zip(places, forces, sizes, strict=True):
        if size <= _FAINT * top:
            continue
        along = _three(one) / size * cell * sqrt(size / top)
        for row in _ROWS_M if dof == 1 else (0.0,):
            tail = _three(np.array(place)) + np.array((0.0, row, 0.0))
            triangles += [tuple(corner + len(vertices) for corner in corners) for corners in _TRIANGLES]
            vertices += _arrow(tail, along, 0.08 * cell)
    return (part(vertices, triangles, _ARROW),)


def surface(planes: Callable[[Vector, float], Iterable[Plane] | None], dof: int) -> tuple[Part, ...]:
    """Pieces of the surface from `planes` near a position (n,) [m], within a reach [m].

    A piece lies at the foot of a plane's normal, if the plane returned for the foot passes through the foot. No pieces
    with more than three axes, or if the function fails.
    """
    if dof not in _SAMPLES:
        return ()
    step = 2.0 * REACH_M / (_SAMPLES[dof] - 1)
    pieces: dict[tuple[int, ...], tuple[Array, Array]] = {}
    with suppress(Exception):  # as above
        for place in _grid(dof, _SAMPLES[dof]):
            for plane in planes(place, step) or ():
                normal = np.array(plane.normal)
                foot = np.array(place) - plane.depth(place) * normal
                key = tuple(np.round(foot / step).astype(int).tolist())
                if np.abs(foot - place).max() > step or np.abs(foot).max() > REACH_M or key in pieces:
                    continue
                again = planes(tuple(foot.tolist()), step) or ()
                if any(abs(one.depth(tuple(foot.tolist()))) < 0.1 * step for one in again):
                    pieces[key] = _three(foot), _three(normal)
    if not pieces:
        return ()
    vertices: list[Array] = []
    triangles: list[tuple[int, ...]] = []
    for foot, normal in pieces.values():
        across, along = _beside(normal)
        size = 0.6 * step, 0.6 * step if dof > 2 else 0.015  # flat worlds get a visible depth
        first = len(vertices)
        vertices += [foot + a * size[0] * across + b * size[1] * along for a, b in _SIDES]
        triangles += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
    return (part(vertices, triangles, GREY),)


class StillPicture(StillDefaults):
    """Parts that rest."""

    def __init__(self, parts: tuple[Part, ...]) -> None:
        self.parts = parts

    def touches(self, position: Vector, force: Vector) -> list[Touch]:
        """No contacts: a function has none to show."""
        return []


def _grid(dof: int, count: int) -> Iterator[Vector]:
    axis = np.linspace(-REACH_M, REACH_M, count).tolist()
    yield from product(axis, repeat=dof)


def _three(vector: Array) -> Array:
    out = np.zeros(3)
    out[: len(vector)] = vector
    return out


def _beside(direction: Array) -> tuple[Array, Array]:
    """Two unit vectors across `direction` (3,) and each other; the second along z for one in the plane of x and y."""
    z = np.array([0.0, 0.0, 1.0]) if abs(direction[2]) < 0.9 * np.linalg.norm(direction) else np.array([0.0, 1.0, 0.0])
    first = np.cross(z, direction)
    first /= np.linalg.norm(first)
    second = np.cross(direction, first)
    return first, second / np.linalg.norm(second)


_SHAFT, _HEAD = ((0, 1, 2), (1, 3, 2), (3, 0, 2)), ((4, 5, 8), (5, 6, 8), (6, 7, 8), (7, 4, 8), (4, 6, 5), (4, 7, 6))
_TRIANGLES = (*_SHAFT, *_HEAD)


def _arrow(tail: Array, arrow: Array, width: float) -> list[Array]:
    """A shaft that is a thin pyramid, and a head that is a wide one."""
    one, other = _beside(arrow)
    neck, tip = tail + 0.6 * arrow, tail + arrow
    shaft = [tail + 0.4 * width * one, tail - 0.4 * width * one, neck, tail + 0.4 * width * other]
    head = [neck + 1.4 * width * (a * one + b * other) for a, b in _SIDES]
    return [*shaft, *head, tip]
