"""The picture of a MuJoCo model: all geoms that its own viewer shows, and its flexes.

Its frame is the hand's: the proxy begins at the origin.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array, Vector
from hapnet.ext.engines.mujoco_model import MujocoModel
from hapnet.ext.solids.outlines import Outline, ball, cuboid, cylinder
from hapnet.ext.solids.rigid_contacts import padded
from hapnet.ext.solids.shapes import Cylinder
from hapnet.plant.worlds.picture import RESTS, SOFT, Color, Part, Touch, part, shared

_SHOWN_GROUPS = 3
"""Geoms of later groups are hidden, as in MuJoCo's viewer."""

_PLAIN = (0.5, 0.5, 0.5, 1.0)
"""MuJoCo's default colour: then the material's colour counts."""

_INFINITE_M = 0.12
"""Half the side of an infinite plane in the picture [m]."""

_SIDES = 24
_PROXY_OPACITY = 115
"""The opacity of the sphere that was added for the hand, of 255."""


def moving_bodies(found: MujocoModel) -> NDArray[Any]:
    """The model's numbers of the bodies whose poses are in its picture."""
    moves = np.flatnonzero((found.model.body_weldid != 0) | (found.model.body_mocapid >= 0))
    return moves[moves > 0]


class ModelPicture:
    """The picture of a running model, with its proxy at `position` (n,) [m]."""

    def __init__(self, found: MujocoModel, position: Vector) -> None:
        self._found = found
        self._model, self._data, self._kinds = found.model, found.data, found.engine.mjtGeom
        place = self._data.site_xpos[found.site] if found.site >= 0 else self._data.xipos[found.body]
        self._origin = np.array(place) - padded(position)
        model = self._model
        self._bodies = moving_bodies(found)
        flexes = [i for i in range(model.nflex) if model.flex_dim[i] > 1]
        self._soft = [self._soft_rows(i) for i in flexes]
        self.parts: tuple[Part, ...] = (*self._geoms(), *map(self._flex, flexes))

    def poses(self) -> Array:
        """The poses of the moving bodies (B, 7): place [m], and unit quaternion w, x, y, z."""
        data, bodies = self._data, self._bodies
        return np.concatenate([data.xpos[bodies] - self._origin, data.xquat[bodies]], axis=1)

    def soft(self) -> Array:
        """The present vertices of all soft parts, one after another (V, 3) [m]."""
        if not self._soft:
            return np.zeros((0, 3))
        return np.concatenate([self._data.flexvert_xpos[rows] for rows in self._soft]) - self._origin

    def touches(self, position: Vector, force: Vector) -> list[Touch]:
        """The engine's contacts of a proxy at `position` (n,) [m] with `force` (n,) [N] in all."""
        data, own = self._data, self._found.geoms
        found = []
        for contact in data.contact[: data.ncon]:
            one, other = (int(geom) for geom in contact.geom)
            if contact.dist > 0.0 or (one in own) is (other in own):
                continue
            sign = 1.0 if other in own else -1.0  # the frame's first axis points from the first geom to the second
            point, normal = contact.pos - self._origin, sign * contact.frame[:3]
            found.append((tuple(point.tolist()), tuple(normal.tolist()), float(contact.friction[0])))
        return shared(padded(force), found) if any(force) else []

    def _geoms(self) -> list[Part]:
        model, data = self._model, self._data
        numbers = {int(body): number for number, body in enumerate(self._bodies)}
        parts = []
        for geom in range(model.ngeom):
            color = self._color(geom)
            if not color[3] or model.geom_group[geom] >= _SHOWN_GROUPS or (found := self._outline(geom)) is None:
                continue
            (vertices, triangles), smooth = found
            body = numbers.get(int(model.geom_bodyid[geom]), RESTS)
            if body == RESTS:
                turn, place = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom] - self._origin
            else:
                turn, place = self._turned(model.geom_quat[geom]), model.geom_pos[geom]
            if self._found.dofs and geom in self._found.geoms:
                color = (*color[:3], _PROXY_OPACITY)  # so that its contacts are visible through it
            parts.append(part(vertices @ turn.T + place, triangles, color, body, smooth=smooth))
        return parts

    def _outline(self, geom: int) -> tuple[Outline, bool] | None:
        """A geom's surface in its own frame, and whether it is curved."""
        model, kinds = self._model, self._kinds
        kind, (a, b, c) = kinds(int(model.geom_type[geom])), model.geom_size[geom].tolist()
        if kind == kinds.mjGEOM_BOX:
            return cuboid((2.0 * a, 2.0 * b, 2.0 * c)), False
        if kind == kinds.mjGEOM_PLANE:
            (vertices, triangles) = cuboid((2.0 * (a or _INFINITE_M), 2.0 * (b or _INFINITE_M), 0.002))
            return (vertices - (0.0, 0.0, 0.001), triangles), False
        if kind == kinds.mjGEOM_CYLINDER:
            return cylinder(Cylinder((0.0, 0.0, 0.0), a, 2.0 * b)), False
        if kind in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_ELLIPSOID, kinds.mjGEOM_CAPSULE):
            vertices, triangles = ball(_SIDES, 2.0 * b / a if kind == kinds.mjGEOM_CAPSULE else 0.0)
            size = (a, b, c) if kind == kinds.mjGEOM_ELLIPSOID else (a, a, a)
            return (vertices * size, triangles), True
        if kind in (kinds.mjGEOM_MESH, kinds.mjGEOM_SDF):
            mesh = int(model.geom_dataid[geom])
            first, face = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
            vertices = model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])]
            return (vertices, model.mesh_face[face : face + int(model.mesh_facenum[mesh])]), False
        return self._heights(int(model.geom_dataid[geom])) if kind == kinds.mjGEOM_HFIELD else None

    def _heights(self, field: int) -> tuple[Outline, bool]:
        """The upper side of a height field."""
        model = self._model
        rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
        x, y, high, _ = model.hfield_size[field].tolist()
        first = int(model.hfield_adr[field])
        heights = high * model.hfield_data[first : first + rows * columns]
        across, along = np.meshgrid(np.linspace(-x, x, columns), np.linspace(-y, y, rows))
        at = np.arange(rows * columns).reshape(rows, columns)
        a, b, c, d = at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]
        triangles = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
        return (np.stack([across.ravel(), along.ravel(), heights], 1), triangles), True

    def _flex(self, flex: int) -> Part:
        """The surface of a deformable body; of a volume, its shell."""
        model = self._model
        if model.flex_dim[flex] == 3:
            first, count, table = int(model.flex_shelldataadr[flex]), int(model.flex_shellnum[flex]), model.flex_shell
        else:
            first, count, table = int(model.flex_elemdataadr[flex]), int(model.flex_elemnum[flex]), model.flex_elem
        triangles = table[first : first + 3 * count].reshape(-1, 3)
        vertices = self._data.flexvert_xpos[self._soft_rows(flex)] - self._origin
        return part(vertices, triangles, _bytes(model.flex_rgba[flex]), SOFT, smooth=True)

    def _soft_rows(self, flex: int) -> slice:
        first = int(self._model.flex_vertadr[flex])
        return slice(first, first + int(self._model.flex_vertnum[flex]))

    def _color(self, geom: int) -> Color:
        model = self._model
        own, material = model.geom_rgba[geom], int(model.geom_matid[geom])
        return _bytes(model.mat_rgba[material] if material >= 0 and np.allclose(own, _PLAIN) else own)

    def _turned(self, quaternion: Array) -> Array:
        matrix = np.zeros(9)
        self._found.engine.mju_quat2Mat(matrix, quaternion)
        return matrix.reshape(3, 3)


def _bytes(rgba: Any) -> Color:
    red, green, blue, opacity = (round(255.0 * min(1.0, max(0.0, float(value)))) for value in rgba)
    return red, green, blue, opacity
