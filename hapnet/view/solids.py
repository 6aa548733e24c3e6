"""The solids of a rigid scene in the page's 3-D part."""

from __future__ import annotations

import numpy as np
import viser

from hapnet.checks import Array
from hapnet.plant.worlds.mesh import Mesh
from hapnet.plant.worlds.outlines import cylinder, smooth
from hapnet.plant.worlds.rigid_contacts import Solid
from hapnet.plant.worlds.shapes import Cuboid, Cylinder, HalfSpace, Sphere

GREY = (148, 163, 184)
_EXTENT = 9.0  # of a plane, across
_THICKNESS = 0.1


def add_solids(scene: viser.SceneApi, solids: tuple[Solid, ...], unit: float) -> None:
    """Draw them; `unit` is scene units per metre."""
    for number, solid in enumerate(solids):
        shape = smooth(solid.shape)
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


def turned_to(direction: Array) -> Array:
    """The quaternion (w, x, y, z) that turns the x axis to `direction`, a unit vector."""
    w = 1.0 + float(direction[0])
    if w < 1e-9:
        return np.array([0.0, 0.0, 0.0, 1.0])
    turn = np.array([w, 0.0, -direction[2], direction[1]])
    return np.asarray(turn / np.linalg.norm(turn))
