"""The depth of a device in obstacles (flat walls or solids), and the force of the true environment at its place."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import groupby
from typing import Protocol

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.ext.solids.rigid_contacts import RigidContacts, Solid, padded
from hapnet.ext.tools.contacts import ToolContacts
from hapnet.plant.worlds.protocol import World
from hapnet.plant.worlds.walls import Contacts, Wall


class WallOrSolid(Protocol):
    """A wall, or a solid of any shape."""

    @property
    def stiffness(self) -> float:
        """K_w [N/m]."""

    def depths(self, positions: Array) -> Array:
        """(N,) the depth of each of `positions` (N, n) below the nearest surface [m]; negative outside."""

    def normals(self, positions: Array) -> Array:
        """(N, n) the unit normals there, into the obstacle; 0 if a solid's normal has no part along the n axes."""


class SolidObstacle:
    """A solid of a scene with n axes. It keeps its last results, as several metrics need the same positions."""

    def __init__(self, solid: Solid) -> None:
        self.stiffness: float = solid.stiffness
        self._shape = solid.shape
        self._positions: Array | None = None
        self._depths = self._normals = np.empty(0)

    def depths(self, positions: Array) -> Array:
        self._compute(positions)
        return self._depths

    def normals(self, positions: Array) -> Array:
        self._compute(positions)
        return self._normals

    def _compute(self, positions: Array) -> None:
        if positions is self._positions:
            return
        found = [self._shape.near(padded(place)) for place in positions.tolist()]
        self._depths = np.array([-distance for distance, _ in found])
        out = np.array([gradient for _, gradient in found]).reshape(-1, 3)[:, : positions.shape[1]]
        sizes = np.linalg.norm(out, axis=1, keepdims=True)
        self._normals = -out / np.where(sizes, sizes, 1.0)
        self._positions = positions


def obstacles(world: World) -> tuple[WallOrSolid, ...] | None:
    """The obstacles of `world`; None: they are not known, as in a force field or another engine."""
    contacts = world.contacts
    if isinstance(contacts, RigidContacts):
        return tuple([SolidObstacle(solid) for solid in contacts.solids])
    if isinstance(contacts, ToolContacts):  # the depth of a tool depends on more than its point
        return None if contacts.solids else ()
    return tuple(world.walls) if world.walls or isinstance(contacts, Contacts) else None


def has_friction(world: World) -> bool:
    """Whether any solid of `world` has friction, or touches a tool that turns. Then the force at a place does not
    follow from a spring alone.
    """
    contacts = world.contacts
    if isinstance(contacts, ToolContacts):
        return bool(contacts.solids)
    return isinstance(contacts, RigidContacts) and any(solid.friction for solid in contacts.solids)


def normal_where_deepest(obstacle: WallOrSolid, positions: Array) -> Vector:
    """The normal (n,) at the deepest sample; a wall's normal is the same everywhere."""
    if isinstance(obstacle, Wall):
        return obstacle.normal
    return tuple(obstacle.normals(positions)[int(np.argmax(obstacle.depths(positions)))].tolist())


def environment_force(
    position: Array,
    times: Sequence[float],
    walls: Callable[[float], Iterable[WallOrSolid]],
    stiffness: Callable[[WallOrSolid], float],
) -> Array:
    """Force of the true environment on a device at `position` (N, n) [m]: (N, n) [N].

    It is the force of a local, ideal rendering without delay at rest: each wall pushes the device out along its normal,
    with the stiffness of the springs and the wall in series, and free space gives no force. So the environment is the
    same for all couplings (the "transparency" of D. A. Lawrence 1993 is that its force is felt), and drag, lag and
    softness of a coupling all count as its error.

    times : of the positions [s]. walls : returns the walls at a time. stiffness : returns the stiffness of a wall in
        series with the springs [N/m].
    """
    pieces = []
    first = 0
    for standing, group in groupby(tuple(walls(t)) for t in times):
        piece = slice(first, first := first + sum(1 for _ in group))
        pieces.append(standing_force(position[piece], standing, stiffness))
    return np.concatenate(pieces)


def standing_force(position: Array, walls: Iterable[WallOrSolid], stiffness: Callable[[WallOrSolid], float]) -> Array:
    """As `environment_force`, for walls that do not change."""
    force = np.zeros_like(position)
    for wall in walls:
        depth = np.maximum(wall.depths(position), 0.0)
        force -= stiffness(wall) * (depth[:, None] * wall.normals(position))
    return force
