"""The surfaces of a rigid scene's solids as triangles, for pictures of it."""

from __future__ import annotations

import numpy as np

from hapnet.checks import Array
from hapnet.errors import HapnetError
from hapnet.plant.worlds import rigid
from hapnet.plant.worlds.mesh import Mesh, Triangles
from hapnet.plant.worlds.rigid_contacts import Solid
from hapnet.plant.worlds.shapes import Cuboid, Cylinder, HalfSpace, Shape, Sphere, Textured

Outline = tuple[Array, Triangles]
"""Vertices (N, 3) [m], and triangles (M, 3) as indices of them."""

_SIDES = 48


def solids_of(scene: object) -> tuple[Solid, ...]:
    """The solids of the scene with these words; none if it is another one, or its files are not here."""
    build = rigid.builder(scene) if isinstance(scene, str) else None
    try:
        return () if build is None else build().contacts.solids
    except HapnetError:
        return ()


def smooth(shape: Shape) -> Shape:
    """The shape without its relief, which is too fine to be seen."""
    while isinstance(shape, Textured):
        shape = shape.shape
    return shape


def outline(shape: Shape, around: Array, reach_m: float) -> Outline | None:
    """The surface of a shape; None: of this kind nothing is known. A plane is cut `reach_m` from `around` (3,) [m]."""
    shape = smooth(shape)
    if isinstance(shape, Mesh):
        return shape.vertices, shape.triangles
    if isinstance(shape, Cylinder):
        return cylinder(shape)
    if isinstance(shape, Sphere):
        return _sphere(shape)
    if isinstance(shape, Cuboid):
        return _cuboid(shape)
    return _plane(shape, around, reach_m) if isinstance(shape, HalfSpace) else None


def cylinder(shape: Cylinder) -> Outline:
    """A cylinder's surface."""
    turn = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    ring = np.stack([shape.radius * np.cos(turn), shape.radius * np.sin(turn), np.full(_SIDES, 0.5 * shape.length)], 1)
    ends = np.concatenate([ring, ring * (1.0, 1.0, -1.0)])
    first = np.arange(_SIDES)
    second = np.roll(first, -1)
    side = np.concatenate(
        [np.stack([first, first + _SIDES, second], 1), np.stack([second, first + _SIDES, second + _SIDES], 1)]
    )
    fan = np.stack([np.zeros(_SIDES - 2, dtype=int), first[1:-1], first[2:]], 1)
    triangles = np.concatenate([side, fan, fan[:, ::-1] + _SIDES])
    return np.roll(ends, shape.axis + 1, axis=1) + shape.centre, triangles


def _sphere(shape: Sphere) -> Outline:
    turns, heights = np.meshgrid(
        2.0 * np.pi * np.arange(_SIDES) / _SIDES, np.pi * np.arange(_SIDES // 2 + 1) / (_SIDES // 2)
    )
    points = np.stack([np.sin(heights) * np.cos(turns), np.sin(heights) * np.sin(turns), np.cos(heights)], -1)
    at = np.arange(points.shape[0] * _SIDES).reshape(-1, _SIDES)
    here, beside = at[:-1], np.roll(at, -1, axis=1)[:-1]
    below, both = at[1:], np.roll(at, -1, axis=1)[1:]
    triangles = np.concatenate([np.stack([here, below, beside], -1), np.stack([beside, below, both], -1)])
    return points.reshape(-1, 3) * shape.radius + shape.centre, triangles.reshape(-1, 3)


def _cuboid(shape: Cuboid) -> Outline:
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [part for a, b, c, d in faces for part in ((a, b, c), (a, c, d))]
    return corners * np.array(shape.size) + shape.centre, np.array(triangles)


def _plane(shape: HalfSpace, around: Array, reach_m: float) -> Outline:
    normal = np.array(shape.normal)
    foot = around - (normal @ around - shape.offset) * normal
    one = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    one /= np.linalg.norm(one)
    other = np.cross(normal, one)
    corners = [foot + reach_m * (a * one + b * other) for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    return np.array(corners), np.array([(0, 1, 2), (0, 2, 3)])
