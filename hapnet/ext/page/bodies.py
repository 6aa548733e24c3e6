"""The picture of a world in the page's 3-D part: each surface is sent once, then only the pose of its body.

`HandleTool` draws the handle of a tool that turns at the device's pose, with its axes and its torque.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import viser

from hapnet.checks import Array
from hapnet.ext.page.history import Snapshot
from hapnet.mechanics.pose import pose, torques
from hapnet.plant.worlds.picture import RESTS, SOFT, Part
from hapnet.recording.drawing import SceneSample


class Bodies:
    """Draws `parts`; `unit` is scene units per metre. name : the beginning of their nodes' names."""

    def __init__(self, scene: viser.SceneApi, parts: Sequence[Part], unit: float, name: str = "body") -> None:
        self._unit = unit
        moving = sorted({part.body for part in parts if part.body >= 0})
        self._frames = {body: scene.add_frame(f"/{name}_{body}", show_axes=False) for body in moving}
        self._meshes: dict[int, list[viser.MeshHandle]] = {}
        self._soft: list[tuple[viser.MeshHandle, slice]] = []
        first = 0
        for number, part in enumerate(parts):
            *color, opacity = part.color
            handle = scene.add_mesh_simple(
                f"/{name}_{part.body}/part_{number}" if part.body >= 0 else f"/{name}_part_{number}",
                unit * part.vertices,
                part.triangles,
                color=(color[0], color[1], color[2]),
                opacity=None if opacity == 255 else opacity / 255.0,
                flat_shading=not part.smooth,
                side="double",
                cast_shadow=part.body != RESTS,
                receive_shadow=part.body == RESTS,
            )
            self._meshes.setdefault(part.body, []).append(handle)
            if part.body == SOFT:
                self._soft.append((handle, slice(first, first + len(part.vertices))))
                first += len(part.vertices)

    def update(self, scene: SceneSample) -> None:
        """Move the bodies and soft parts to their present places."""
        self.move(scene.bodies())
        if self._soft:
            vertices = (self._unit * scene.vertices()).astype(np.float32)
            for handle, rows in self._soft:
                if len(vertices) >= rows.stop:
                    handle.vertices = vertices[rows]

    def paint(self, body: int, color: tuple[int, int, int], opacity: float) -> None:
        """Give all of this body another colour and opacity; an opacity of 0 hides it."""
        for mesh in self._meshes.get(body, ()):
            mesh.color, mesh.opacity, mesh.visible = color, opacity if opacity < 1.0 else None, opacity > 0.0

    def move(self, poses: Array) -> None:
        """Move the moving bodies to these poses (B, 7)."""
        for body, frame in self._frames.items():
            if body < len(poses):  # viser sends only what has changed by more than rounding
                frame.position, frame.wxyz = poses[body, :3] * self._unit, poses[body, 3:]


BLUE, VIOLET = (37, 99, 235), (147, 51, 234)

TORQUE_UNIT = 0.05
"""Length of the torque's arrow, in scene units per millinewton metre."""

_FELT_MNM = 2.0
_AXES, _THICK = 2.5, 0.05  # of the frame, in scene units


class HandleTool:
    """Draws the `parts` of the body at the proxy's place; `unit` is scene units per metre."""

    def __init__(self, scene: viser.SceneApi, parts: Sequence[Part], unit: float) -> None:
        self._scene, self._parts, self._unit = scene, parts, unit
        self._frame = scene.add_frame("/tool", axes_length=_AXES, axes_radius=_THICK, visible=False)
        self._arrow = scene.add_arrows(
            "/torque", np.zeros((1, 2, 3)), VIOLET, shaft_radius=0.07, head_radius=0.19, head_length=0.4, visible=False
        )
        self._label = scene.add_label("/torque_label", "", anchor="bottom-center", visible=False)

    def update(self, snapshot: Snapshot) -> None:
        """Show the newest pose and torque."""
        device, world = snapshot.device, snapshot.world
        if world is not None and snapshot.scene is not None and self._parts:
            self._add(world.position_m[-1], snapshot.scene.bodies())
        if device is None:
            return
        place, quaternion = pose(device.position_m[-1])
        torque = 1e3 * torques(device.position_m[-1], device.force_N[-1])
        size = float(np.linalg.norm(torque))
        middle = self._unit * np.array(place)
        self._frame.visible = True
        self._frame.position, self._frame.wxyz = middle, quaternion
        self._arrow.visible = self._label.visible = size > _FELT_MNM
        if self._arrow.visible:
            self._arrow.points = np.array([[middle, middle + TORQUE_UNIT * torque]], dtype=np.float32)
            self._label.position, self._label.text = middle + TORQUE_UNIT * torque, f"{size:.0f} mNm"

    def _add(self, proxy: Array, bodies: Array) -> None:
        """Draw the body nearest to the proxy (12,) [m]; `bodies` (B, 7): their present poses."""
        tool = int(np.linalg.norm(bodies[:, :3] - proxy[:3], axis=1).argmin()) if len(bodies) else 0
        for number, part in enumerate(part for part in self._parts if part.body == tool):
            self._scene.add_mesh_simple(
                f"/tool/part_{number}", self._unit * part.vertices, part.triangles, color=BLUE, opacity=0.35,
                flat_shading=not part.smooth, side="double", cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
        self._parts = ()
