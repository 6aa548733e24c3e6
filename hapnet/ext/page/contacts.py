"""The proxy's contacts in the page's 3-D part: points, friction cones, and the force in each cone.

A cone has its tip at the contact, and its height is the length of the normal force. So the force's arrow ends at the
cone's base: inside the rim while the contact sticks, on the rim while it slides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import viser
from numpy.typing import NDArray

from hapnet.checks import Array
from hapnet.plant.worlds.picture import Touch

RED, AMBER = (220, 38, 38), (245, 158, 11)

_MOST = 8
_FELT_N = 0.02
_MIN_HEIGHT = 0.4  # of a cone, in scene units
_POINT_RADIUS = 0.12
_SIDES = 32


@dataclass
class _Marks:
    """The drawing of one contact."""

    point: viser.IcosphereHandle
    cone: viser.MeshHandle
    arrow: viser.ArrowsHandle


class ContactMarks:
    """Draws contacts; `unit` is scene units per metre, `force_unit` per newton."""

    def __init__(self, scene: viser.SceneApi, unit: float, force_unit: float) -> None:
        self._scene, self._unit, self._force_unit = scene, unit, force_unit
        self._marks: list[_Marks] = []

    def update(self, touches: Sequence[Touch]) -> None:
        """Show these contacts, and hide all others."""
        while len(self._marks) < min(_MOST, len(touches)):
            self._marks.append(self._add(len(self._marks)))
        for marks, touch in zip(self._marks, touches, strict=False):
            self._show(marks, touch)
        for marks in self._marks[len(touches) :]:
            marks.point.visible = marks.cone.visible = marks.arrow.visible = False

    def _show(self, marks: _Marks, touch: Touch) -> None:
        place, normal = self._unit * np.array(touch.point), np.array(touch.normal)
        force = self._force_unit * np.array(touch.force_N)
        marks.point.position = place
        marks.point.visible = True
        marks.arrow.visible = float(np.linalg.norm(force)) > _FELT_N * self._force_unit
        if marks.arrow.visible:
            marks.arrow.points = np.array([[place, place + force]], dtype=np.float32)
        marks.cone.visible = touch.friction > 0.0
        if marks.cone.visible:
            height = max(_MIN_HEIGHT, float(force @ normal))
            marks.cone.position, marks.cone.wxyz = place, turned_to(normal)
            marks.cone.scale = (height, touch.friction * height, touch.friction * height)

    def _add(self, number: int) -> _Marks:
        scene, name = self._scene, f"/contact_{number}"
        vertices, triangles = cone()
        return _Marks(
            scene.add_icosphere(f"{name}/point", _POINT_RADIUS, RED, cast_shadow=False, receive_shadow=False),
            scene.add_mesh_simple(
                f"{name}/cone", vertices, triangles, color=AMBER, opacity=0.35, side="double",
                cast_shadow=False, receive_shadow=False,
            ),
            scene.add_arrows(
                f"{name}/force", np.zeros((1, 2, 3), dtype=np.float32), RED,
                shaft_radius=0.05, head_radius=0.14, head_length=0.3,
            ),
        )  # fmt: skip


def cone() -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """The side of a cone with its tip at the origin, whose base at x = 1 has the radius 1."""
    turn = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    rim = np.stack([np.ones(_SIDES), np.cos(turn), np.sin(turn)], 1)
    first = np.arange(1, _SIDES + 1)
    triangles = np.stack([np.zeros_like(first), first, np.roll(first, -1)], 1)
    return np.vstack([np.zeros(3), rim]).astype(np.float32), triangles.astype(np.uint32)


def turned_to(direction: Array) -> Array:
    """The quaternion (w, x, y, z) that turns the x axis to `direction`, a unit vector."""
    w = 1.0 + float(direction[0])
    if w < 1e-9:
        return np.array([0.0, 0.0, 0.0, 1.0])
    turn = np.array([w, 0.0, -direction[2], direction[1]])
    return np.asarray(turn / np.linalg.norm(turn))
