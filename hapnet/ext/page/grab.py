"""The invisible ball around the handle that the mouse grabs, equally large on every screen."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np
import viser

from hapnet.checks import Array

GRAB_PX = 110.0
"""A press within this distance of the handle's middle grabs it [pixels]; a press farther away turns the view."""

_SHARE, _DENSEST = 0.28, 3.0
"""A press within this share of the scene's smaller side grabs it too, as dense screens do not report their pixel ratio:
on a telephone this share is `GRAB_PX`. No screen has more than `_DENSEST` pixels where others have one."""

_LARGEST = 12.0
"""The largest radius of the ball [scene units], however far away a camera is."""


class Grab:
    """A ball around the node `parent`. A drag calls `move` with the new place of the ball's middle [scene units].

    radius : of the visible handle [scene units]; the ball is never smaller. place : returns the present middle. Create
        this last in a scene, so that it hides no transparent object.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        parent: str,
        radius: float,
        place: Callable[[], Array],
        move: Callable[[Array], None],
    ) -> None:
        self._radius, self._place = radius, place
        self._ball = scene.add_icosphere(
            f"{parent}/grab", radius, (255, 255, 255), opacity=0.0, scale=_LARGEST / radius,
            side="back",  # the pointer hits the far side, so the ball hides nothing that is in it or before it
            cast_shadow=False, receive_shadow=False,
        )  # fmt: skip
        held, stretch = np.zeros(3), 1.0

        # A coroutine, since viser keeps the order of events only for coroutines.
        @self._ball.on_drag
        async def _(event: viser.SceneNodeDragEvent[viser.IcosphereHandle]) -> None:
            nonlocal held, stretch
            camera = event.client.camera
            eye, ahead = np.array(camera.position), np.array(camera.look_at) - np.array(camera.position)
            if event.phase == "start":  # the pointer is on the ball, farther away than the middle
                start, middle = np.array(event.start_position), self._place()
                stretch = float((middle - eye) @ ahead) / (float((start - eye) @ ahead) or 1.0)
                held = eye + stretch * (start - eye) - middle
            if event.phase != "end":
                move(eye + stretch * (np.array(event.end_position) - eye) - held)

    def fit(self, cameras: Iterable[viser.CameraHandle]) -> None:
        """Make the ball large enough for each of these windows."""
        middle, radius = self._place(), self._radius
        for camera in cameras:
            away = float(np.linalg.norm(np.array(camera.position) - middle))
            height = max(camera.image_height, 1)
            pixels = max(GRAB_PX, min(_SHARE * min(height, camera.image_width), _DENSEST * GRAB_PX))
            radius = max(radius, 2.0 * away * math.tan(camera.fov / 2.0) * pixels / height)
        scale = min(radius, _LARGEST) / self._radius
        if abs(scale / float(np.max(self._ball.scale)) - 1.0) > 0.03:
            self._ball.scale = scale
