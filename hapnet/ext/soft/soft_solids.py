"""Rigid solids at rest around a soft body: their contacts with the surface's nodes and with the ball.

A solid is a signed distance (`hapnet.ext.solids.shapes`). A contact with it is a row: for each solid a row for each
node of the body's surface, and then a row for each solid with the ball. In a step a solid is its tangent plane at the
row's place half way. Distances are computed only for nodes that may have come near.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot

import numpy as np

from hapnet.checks import Array
from hapnet.ext.soft.soft_linear import Indices
from hapnet.ext.solids.friction import at
from hapnet.ext.solids.rigid_contacts import RigidContacts, Solid
from hapnet.mechanics.curvature import Curvature
from hapnet.mechanics.plane import Plane


class Solids:
    """The solids for a body with `count` nodes on its surface, and a ball of `radius` [m].

    Attributes: count; rows : the number of contacts. balls : the first row with the ball.
    """

    def __init__(self, solids: Sequence[Solid], count: int, radius: float) -> None:
        self.solids, self.count, self._radius = tuple(solids), count, radius
        self.balls = count * len(self.solids)
        self.rows = self.balls + len(self.solids)
        self._clear: Array = np.zeros(self.balls)  # no node is nearer to the solid than this [m]
        self._seen: Array = np.full((count, 3), np.inf)
        self._around = RigidContacts(self.solids, 3)

    def _of(self, row: int) -> tuple[Solid, bool]:
        """A row's solid, and whether the row is the ball's."""
        is_ball = row >= self.balls
        return self.solids[row - self.balls if is_ball else row // self.count], is_ball

    def tangents(self, rows: Indices, places: Array) -> tuple[Array, Array]:
        """Depths (k,) [m] and unit normals (k, 3) of rows at places (k, 3) [m].

        A normal points from the solid to a node, and from the ball to the solid.
        """
        depths, normals = np.empty(len(rows)), np.empty((len(rows), 3))
        for i, (row, place) in enumerate(zip(rows.tolist(), places.tolist(), strict=True)):
            solid, is_ball = self._of(row)
            distance, gradient = solid.shape.near(tuple(place))
            size = hypot(*gradient) or 1.0
            depths[i] = (self._radius if is_ball else 0.0) - distance
            normals[i] = [(-part if is_ball else part) / size for part in gradient]
        return depths, normals

    def depths(self, nodes: Array, travel: Array) -> Array:
        """The depths of all rows but the ball's (R,), for nodes at (M, 3) [m]; a row may move by `travel` (R,) [m].

        For a node that stays clear of a solid the value is not exact, only less than -`travel`.
        """
        moved = np.linalg.norm(nodes - self._seen, axis=1)
        self._clear -= np.concatenate([moved * solid.shape.slope for solid in self.solids] or [moved[:0]])
        self._seen = nodes.copy()
        near = np.flatnonzero(~(self._clear > travel))
        self._clear[near] = -self.tangents(near, nodes[near % self.count])[0]
        return -self._clear

    def friction(self, rows: Indices, places: Array) -> Array:
        """mu of the solids (k,)."""
        found = [at(self._of(row)[0].friction, tuple(place)) for row, place in zip(rows, places.tolist(), strict=True)]
        return np.array(found)

    def planes(self, centre: Array, reach_m: float) -> list[Plane]:
        """The planes near the ball, offset so that its centre meets them, with three axes."""
        found: list[Plane] = []
        if not self.solids:
            return found
        for plane in self._around.planes(tuple(centre.tolist()), reach_m + self._radius):
            bends = tuple(
                [Curvature(e, k / (1.0 + k * self._radius)) for e, k in plane.curvatures if k * self._radius > -0.9]
            )
            found.append(plane._replace(offset_m=plane.offset_m - self._radius, curvatures=bends))
        return found
