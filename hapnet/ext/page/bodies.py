"""The picture of a world in the page's 3-D part: each surface is sent once, then only where its body is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import viser

from hapnet.checks import Array
from hapnet.plant.worlds.picture import RESTS, SOFT, Part
from hapnet.recording.drawing import SceneSample


class Bodies:
    """Draws `parts`; `unit` is scene units per metre. name : what their nodes are called."""

    def __init__(self, scene: viser.SceneApi, parts: Sequence[Part], unit: float, name: str = "body") -> None:
        self._unit = unit
        moving = sorted({part.body for part in parts if part.body >= 0})
        self._frames = {body: scene.add_frame(f"/{name}_{body}", show_axes=False) for body in moving}
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
            if part.body == SOFT:
                self._soft.append((handle, slice(first, first + len(part.vertices))))
                first += len(part.vertices)

    def update(self, scene: SceneSample) -> None:
        """Move what has moved."""
        self.move(scene.bodies())
        if self._soft:
            vertices = (self._unit * scene.vertices()).astype(np.float32)
            for handle, rows in self._soft:
                if len(vertices) >= rows.stop:
                    handle.vertices = vertices[rows]

    def move(self, poses: Array) -> None:
        """The bodies that move are now at these poses (B, 7)."""
        for body, frame in self._frames.items():
            if body < len(poses):  # viser sends only what has changed by more than rounding
                frame.position, frame.wxyz = poses[body, :3] * self._unit, poses[body, 3:]
