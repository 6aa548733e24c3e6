"""Marks in the page's 3-D part: the device's planes, the force's arrow, the spring, and the names of handle and proxy.

Scene units are centimetres, so that motions of some 40 mm suit viser's camera and clipping.
"""

from __future__ import annotations

import math
from itertools import zip_longest
from typing import Literal

import numpy as np
import viser
from numpy.typing import NDArray

from hapnet.checks import MOST_PLANES, Array, Vector
from hapnet.ext.page.contacts import turned_to
from hapnet.mechanics.plane import Plane

UNIT = 100.0
"""Scene units per metre."""

FORCE_UNIT = 1.0
"""Length of the arrow, in scene units per newton."""

BLUE, ORANGE, GREEN, SLATE = (37, 99, 235), (234, 88, 12), (22, 163, 74), (71, 85, 105)
RED = (220, 38, 38)

PROXY_RADIUS, MARK_RADIUS = 0.3, 0.12
EXTENT = 4.5  # of a wall, from the origin, where no other wall ends it
THIN = 0.1  # of each of several walls
DEPTH = 3.0  # of a wall, across the plane of motion
_BEYOND = 0.4  # a plane of the device extends so far beyond a wall
_FLAT_M = 1e-3  # a plane of a curved surface is drawn as far as it is within this distance of the surface
_LIFT = 0.75  # the arrow is drawn above the spring, which has the same direction


class DevicePlanes:
    """The planes that the device has received, moved back by the proxy's radius like the walls. up : where up is."""

    def __init__(self, scene: viser.SceneApi, dof: int, up: Array) -> None:
        self._up = up
        self._known: tuple[Plane, ...] = ()
        self.nodes = [_add_plane(scene, number, dof) for number in range(MOST_PLANES)]
        self._name = scene.add_label(
            "/model_name", "the device's model", anchor="top-left", font_screen_scale=0.75, visible=False
        )

    def show(self, planes: tuple[Plane, ...], proxy: Array) -> None:
        """Draw these planes; that of a curved surface as a small piece at the foot of the proxy."""
        if planes == self._known:
            return
        self._known = planes
        for node, plane in zip_longest(self.nodes, planes[:MOST_PLANES]):
            normal = padded(() if plane is None else plane.normal)
            node.visible = float(np.linalg.norm(normal)) > 0.5
            if plane is not None and node.visible:
                share = _flat_share(plane)
                beside = proxy - normal * float(normal @ proxy) if share < 1.0 else np.zeros(3)
                node.position = beside + normal * (plane.offset_m * UNIT + PROXY_RADIUS + THIN / 2.0)
                node.scale = (1.0, share, share)
                node.wxyz = turned_to(normal)
        self._name.visible = self.nodes[0].visible
        if planes:
            self._name.position = np.array(self.nodes[0].position) - self._up * (EXTENT + _BEYOND)


class ForceArrow:
    """The force at the handle, as an arrow with its size in newtons. up : where up is."""

    def __init__(self, scene: viser.SceneApi, up: Array) -> None:
        self._up = up
        self.arrow = scene.add_arrows(
            "/handle/force",
            np.zeros((1, 2, 3)),
            GREEN,
            shaft_radius=0.07,
            head_radius=0.19,
            head_length=0.4,
            visible=False,
        )
        self._newtons = scene.add_label("/handle/force_label", "", anchor="bottom-center", visible=False)

    def show(self, force: Array) -> None:
        """Draw the force [N]; a very small one is hidden."""
        size = float(np.linalg.norm(force))
        self.arrow.visible = self._newtons.visible = size > 0.02
        if size <= 0.02:
            return
        tail = self._up * _LIFT
        tip = tail + padded(force) * FORCE_UNIT
        self.arrow.points = np.array([[tail, tip]], dtype=np.float32)
        self._newtons.position = (tail + tip) / 2.0 + self._up * 0.25
        self._newtons.text = f"{size:.2f} N"


class SpringCoil:
    """The spring between handle and proxy."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._node = scene.add_line_segments(
            "/spring", coil(), SLATE, thickness=2.5, thickness_units="screen", visible=False
        )

    def show(self, a: Array, b: Array) -> None:
        """Draw it from a to b; a very short one is hidden."""
        path = b - a
        length = float(np.linalg.norm(path))
        self._node.visible = length > 0.05
        if length <= 0.05:
            return
        self._node.position = a
        self._node.wxyz = turned_to(path / length)
        self._node.scale = (length, 1.0, 1.0)


class BallNames:
    """The names of handle and proxy, which stay apart where both are at the same place. hint : write how to begin."""

    def __init__(self, scene: viser.SceneApi, dof: int, *, hint: bool) -> None:
        below = (0.0, -0.55, 0.0) if dof < 3 else (0.0, 0.0, -0.55)
        above = (-below[0], -below[1], -below[2])
        self.hint = scene.add_label("/handle/hint", " drag me ", position=above, anchor="bottom-center", visible=hint)
        self.labels = [
            scene.add_label("/handle/name", " handle ", position=below, anchor="top-right", font_screen_scale=0.85),
            scene.add_label("/proxy/name", " proxy ", position=below, anchor="top-left", font_screen_scale=0.85),
        ]
        self._handle_is_right = False

    def name_proxy(self, name: str) -> None:
        """Write this name at the proxy."""
        self.labels[1].text = f" {name} "

    def part(self, apart: float) -> None:
        """Put the two names on different sides; `apart` : how far the handle is to the right of the proxy."""
        if abs(apart) > MARK_RADIUS and (apart > 0.0) != self._handle_is_right:
            self._handle_is_right = apart > 0.0
            sides: list[Literal["top-left", "top-right"]] = ["top-right", "top-left"]
            for name, side in zip(self.labels, reversed(sides) if self._handle_is_right else sides, strict=True):
                name.anchor = side


def spot(position: Array | Vector) -> Array:
    """The point of the scene that stands for a position [m]."""
    return padded(position) * UNIT


def padded(vector: Array | Vector) -> Array:
    """The first three axes of `vector`; missing ones are 0."""
    out = np.zeros(3)
    shown = np.asarray(vector, dtype=float)[:3]
    out[: len(shown)] = shown
    return out


def coil(turns: int = 9, radius: float = 0.16, lead: float = 0.12) -> NDArray[np.float32]:
    """A spring along x from 0 to 1, its ends straight, as segments (N, 2, 3)."""
    along = np.linspace(0.0, 1.0, turns * 12 + 1)
    angle = 2.0 * math.pi * turns * along
    points = np.stack([lead + (1.0 - 2.0 * lead) * along, radius * np.sin(angle), radius * (np.cos(angle) - 1.0)], 1)
    points = np.vstack([[0.0, 0.0, 0.0], points, [1.0, 0.0, 0.0]])
    return np.stack([points[:-1], points[1:]], 1).astype(np.float32)


def _flat_share(plane: Plane) -> float:
    """The share of a plane within which the surface is at most `_FLAT_M` away from the plane; 1: the whole plane."""
    bend = max([abs(per_m) for _, per_m in plane.curvatures], default=0.0)
    whole = (EXTENT + _BEYOND) / UNIT
    return min(1.0, math.sqrt(2.0 * _FLAT_M / bend) / whole) if bend else 1.0


def _add_plane(scene: viser.SceneApi, number: int, dof: int) -> viser.BoxHandle:
    """A plane that the device may receive: a thin slab across the x axis, a little larger than a wall."""
    return scene.add_box(
        f"/plane_{number}",
        BLUE,
        (THIN, 2.0 * (EXTENT + _BEYOND), 2.0 * (EXTENT + _BEYOND) if dof > 2 else DEPTH + _BEYOND),
        opacity=0.15,
        cast_shadow=False,
        receive_shadow=False,
        side="double",
        visible=False,
    )
