"""The solids of a rigid scene in the page's 3-D part, made anew from the words that name the scene."""

from __future__ import annotations

import numpy as np
import viser

from hapnet.checks import Array
from hapnet.errors import HapnetError
from hapnet.plant.worlds import rigid
from hapnet.plant.worlds.mesh import Mesh, Triangles
from hapnet.plant.worlds.rigid_contacts import Solid
from hapnet.plant.worlds.shapes import Cuboid, Cylinder, HalfSpace, Shape, Sphere, Textured

GREY = (148, 163, 184)
_EXTENT = 9.0  # of a plane, across
_THICKNESS = 0.1


def solids_of(scene: object) -> tuple[Solid, ...]:
    """The solids of the scene with these words; none if it is another one, or its files are not here."""
    build = rigid.builder(scene) if isinstance(scene, str) else None
    try:
        return () if build is None else build().contacts.solids
    except HapnetError:
        return ()


def add_solids(scene: viser.SceneApi, solids: tuple[Solid, ...], unit: float) -> None:
    """Draw them; `unit` is scene units per metre."""
    for number, solid in enumerate(solids):
        shape: Shape = solid.shape
        while isinstance(shape, Textured):  # its relief is too fine to be seen
            shape = shape.shape
        name = f"/solid_{number}"
        if isinstance(shape, Sphere):
            place = unit * np.array(shape.centre)
            scene.add_icosphere(name, unit * shape.radius, GREY, subdivisions=4, opacity=0.6, position=place)
        elif isinstance(shape, Cuboid):
            place = unit * np.array(shape.centre)
            scene.add_box(name, GREY, unit * np.array(shape.size), opacity=0.6, position=place)
        elif isinstance(shape, HalfSpace):
            normal = np.array(shape.normal)
            place = normal * (unit * shape.offset + 0.5 * _THICKNESS)
            size = (_THICKNESS, _EXTENT, _EXTENT)
            scene.add_box(name, GREY, size, opacity=0.35, position=place, wxyz=turned_to(normal), side="double")
        elif isinstance(shape, Mesh | Cylinder):
            vertices, triangles = cylinder(shape) if isinstance(shape, Cylinder) else (shape.vertices, shape.triangles)
            scene.add_mesh_simple(name, (unit * vertices).astype(np.float32), triangles, color=GREY, opacity=0.6)


def cylinder(shape: Cylinder, sides: int = 48) -> tuple[Array, Triangles]:
    """Vertices (2 `sides`, 3) [m] and triangles of a cylinder."""
    turn = 2.0 * np.pi * np.arange(sides) / sides
    ring = np.stack([shape.radius * np.cos(turn), shape.radius * np.sin(turn), np.full(sides, 0.5 * shape.length)], 1)
    ends = np.concatenate([ring, ring * (1.0, 1.0, -1.0)])
    first = np.arange(sides)
    second = np.roll(first, -1)
    side = np.concatenate(
        [np.stack([first, first + sides, second], 1), np.stack([second, first + sides, second + sides], 1)]
    )
    fan = np.stack([np.zeros(sides - 2, dtype=int), first[1:-1], first[2:]], 1)
    triangles = np.concatenate([side, fan, fan[:, ::-1] + sides])
    return np.roll(ends, shape.axis + 1, axis=1) + shape.centre, triangles


def turned_to(direction: Array) -> Array:
    """The quaternion (w, x, y, z) that turns the x axis to `direction`, a unit vector."""
    w = 1.0 + float(direction[0])
    if w < 1e-9:
        return np.array([0.0, 0.0, 0.0, 1.0])
    turn = np.array([w, 0.0, -direction[2], direction[1]])
    return np.asarray(turn / np.linalg.norm(turn))
