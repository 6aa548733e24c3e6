"""The surfaces of solids as triangles, for pictures of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hapnet.checks import Array
from hapnet.ext.solids.field import FieldShape
from hapnet.ext.solids.hole import Hole
from hapnet.ext.solids.mesh import Mesh
from hapnet.ext.solids.mesh_surface import Triangles
from hapnet.ext.solids.shapes import Cuboid, Cylinder, HalfSpace, Offset, Shape, Sphere, Textured
from hapnet.plant.worlds.picture import GREY, RESTS, Color, Part, part

Outline = tuple[Array, Triangles]
"""Vertices (N, 3) [m], and triangles (M, 3) as indices of them."""

_SIDES = 48
_FINE = 1000
"""Meshes with this many triangles are drawn as curved."""


def smooth(shape: Shape) -> Shape:
    """The shape without its relief, which is too fine to be seen; for a layer the shape that contains it."""
    while isinstance(shape, Textured | Offset):
        shape = shape.shape
    return shape


def outline(shape: Shape, around: Array, reach_m: float) -> Outline | None:
    """The surface of a shape; None: a kind without an outline. A plane is cut `reach_m` from `around` (3,) [m]."""
    shape = smooth(shape)
    if isinstance(shape, Mesh):
        return shape.vertices, shape.triangles
    if isinstance(shape, Cylinder):
        return cylinder(shape)
    if isinstance(shape, FieldShape):
        return _field(shape)
    if isinstance(shape, Sphere):
        return _sphere(shape)
    if isinstance(shape, Cuboid):
        return _cuboid(shape)
    if isinstance(shape, Hole):
        return shape.outline
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


def ball(sides: int = _SIDES, straight: float = 0.0) -> Outline:
    """A ball of radius 1 about the origin; with `straight` a capsule along z, with a cylinder of that length."""
    half = np.linspace(0.0, 0.5 * np.pi, sides // 4 + 1)
    heights, lifts = (
        np.concatenate([half, np.pi - half[::-1]]),
        np.repeat((0.5 * straight, -0.5 * straight), len(half)),
    )
    turn, height = np.meshgrid(2.0 * np.pi * np.arange(sides) / sides, heights)
    lift = np.broadcast_to(lifts[:, None], height.shape)
    points = np.stack([np.sin(height) * np.cos(turn), np.sin(height) * np.sin(turn), np.cos(height) + lift], -1)
    at = np.arange(points.shape[0] * sides).reshape(-1, sides)
    here, beside = at[:-1], np.roll(at, -1, axis=1)[:-1]
    below, both = at[1:], np.roll(at, -1, axis=1)[1:]
    triangles = np.concatenate([np.stack([here, below, beside], -1), np.stack([beside, below, both], -1)])
    vertices = points.reshape(-1, 3)
    a, b, c = (vertices[triangles.reshape(-1, 3)[:, k]] for k in range(3))
    has_area = np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-12  # not at the poles
    return vertices, triangles.reshape(-1, 3)[has_area]


def _field(shape: FieldShape) -> Outline | None:
    """Compute the outline of a field by marching cubes; None without libigl."""
    try:
        import igl
    except ImportError:
        return None
    axes, values = shape.sampled()
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).transpose(2, 1, 0, 3).reshape(-1, 3)
    found = igl.marching_cubes(values.T.reshape(-1), np.ascontiguousarray(places), *values.shape, 0.0)
    return np.asarray(found[0]), np.asarray(found[1])


def _sphere(shape: Sphere) -> Outline:
    vertices, triangles = ball()
    return vertices * shape.radius + shape.centre, triangles


def cuboid(size: Sequence[float]) -> Outline:
    """A box of this size (3,) about the origin."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [half for a, b, c, d in faces for half in ((a, b, c), (a, c, d))]
    return corners * np.array(size), np.array(triangles)


def _cuboid(shape: Cuboid) -> Outline:
    corners, triangles = cuboid(shape.size)
    return corners + shape.centre, triangles


def _plane(shape: HalfSpace, around: Array, reach_m: float) -> Outline:
    normal = np.array(shape.normal)
    foot = around - (normal @ around - shape.offset) * normal
    one = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    one /= np.linalg.norm(one)
    other = np.cross(normal, one)
    corners = [foot + reach_m * (a * one + b * other) for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    return np.array(corners), np.array([(0, 1, 2), (0, 2, 3)])


def part_of(shape: Shape, color: Color = GREY, body: int = RESTS, reach_m: float = 0.06) -> Part | None:
    """A shape as a part of a picture; None: a kind without an outline. A plane is cut `reach_m` from the origin."""
    found = outline(shape, np.zeros(3), reach_m)
    if found is None:
        return None
    fine = isinstance(smooth(shape), Sphere | Mesh | FieldShape) and len(found[1]) >= _FINE
    return part(*found, color, body, smooth=fine)
