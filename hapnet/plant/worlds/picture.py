"""The picture of a world: surfaces of triangles, the present poses of its bodies, and the proxy's contacts.

This is for pages and figures only; nothing here acts on the proxy. A world that can be drawn has a method `picture`.
The methods of its result are called some 60 times a second, on the thread that steps the world.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hapnet.checks import Array, Vector

Color: TypeAlias = tuple[int, int, int, int]
"""Red, green, blue and opacity, 0 to 255."""

RESTS, SOFT = -1, -2
"""In place of a body's number: a part that rests; a soft part, with new vertices each time."""

GREY: Color = (148, 163, 184, 153)


class Part(NamedTuple):
    """A surface in the frame of its body, or of the scene if it rests."""

    vertices: NDArray[Any]  #: (N, 3) [m]
    triangles: NDArray[Any]  #: (M, 3), as indices of vertices
    color: Color
    body: int  #: index of its body's pose, or `RESTS` or `SOFT`
    smooth: bool  #: True: a curved surface; False: edges are visible


class Touch(NamedTuple):
    """A contact of the proxy. Vectors have three axes."""

    point: Vector  #: on the surface [m]
    normal: Vector  #: of unit length, out of the touched surface
    friction: float  #: Coulomb's mu
    force_N: Vector  #: on the proxy


HERE, LEFT, FREE = "here", "left", "free"
"""The states of a hand: its device is there; it was there, and has left or is silent; nobody has come yet."""


class SeenHand(NamedTuple):
    """A hand of a world with several."""

    name: str
    state: str  #: `HERE`, `LEFT` or `FREE`
    body: int  #: index of the pose of the body that it holds, in the picture; -1: it is the hand whose picture it is


class Picture(Protocol):
    """The picture of a world during a run."""

    @property
    def parts(self) -> tuple[Part, ...]: ...

    def poses(self) -> Array:
        """The poses of the moving bodies (B, 7): place [m], and unit quaternion w, x, y, z."""

    def soft(self) -> Array:
        """The present vertices of all soft parts, one after another (V, 3) [m]."""

    def touches(self, position: Vector, force: Vector) -> list[Touch]:
        """The contacts of a proxy at `position` (n,) [m] which feels `force` (n,) [N] in all."""


class StillDefaults:
    """The methods of a `Picture` without moving or soft parts."""

    def poses(self) -> Array:
        """No poses: nothing moves."""
        return np.zeros((0, 7))

    def soft(self) -> Array:
        """No vertices: there are no soft parts."""
        return np.zeros((0, 3))


def part(vertices: Any, triangles: Any, color: Color = GREY, body: int = RESTS, *, smooth: bool = False) -> Part:
    """Make a part from any arrays."""
    return Part(np.asarray(vertices, dtype=np.float32), np.asarray(triangles, dtype=np.uint32), color, body, smooth)


def at_rest(places: Sequence[Sequence[float]]) -> Array:
    """The poses of unrotated bodies at these places (B, n) [m]."""
    poses = np.zeros((len(places), 7))
    poses[:, 3] = 1.0
    for row, place in zip(poses, places, strict=True):
        row[: min(3, len(place))] = place[:3]
    return poses


_ROUNDS = 30


def shared(force: Vector, found: Sequence[tuple[Vector, Vector, float]]) -> list[Touch]:
    """Divide `force` (3,) [N] among contacts with these points, normals and frictions.

    A single contact gets the whole force. Several push along their normals so that their sum is as close to the force
    as possible (non-negative least squares, by coordinates); the rest is divided in proportion to mu times the push.
    With more contacts than axes many solutions are possible: this is one of them.
    """
    if len(found) == 1:
        return [Touch(*found[0], force)]
    normals = np.array([normal for _, normal, _ in found]).reshape(-1, 3)
    pushes, left = np.zeros(len(found)), np.array(force, dtype=float)
    for _ in range(_ROUNDS):
        for i, normal in enumerate(normals):
            more = max(-pushes[i], float(normal @ left))
            pushes[i] += more
            left -= more * normal
    grips = pushes * [friction for _, _, friction in found]
    total = float(grips.sum())
    shares = grips / total if total > 0.0 else pushes / (float(pushes.sum()) or 1.0)
    forces = pushes[:, None] * normals + shares[:, None] * left
    return [Touch(*one, tuple(each)) for one, each in zip(found, forces.tolist(), strict=True)]
