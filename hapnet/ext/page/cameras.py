"""The cameras of the page's 3-D part: they look at the hand's surroundings, and keep them visible in narrow windows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import viser

from hapnet.checks import Array
from hapnet.ext.arms.picture import ArmPicture
from hapnet.ext.page.marks import UNIT
from hapnet.plant.worlds.picture import Part

REACH_M = 0.1
"""The mouse leads the hand at most this far from the origin on each axis: the workspace of a desktop device [m]."""

_FOV = math.radians(30.0)
_DISTANCE = 24.0
_SEEN = 5.0  # half the width that is visible between the panels from that distance
_LEAST_SEEN = 4.0  # half the width that is visible in a narrow window
_AROUND = 3.0  # the surroundings of the hand that are always visible

_BESIDE_AN_ARM = (0.64, 0.64, 0.42)
"""The direction from which the camera shows an arm, with the arm's base behind the hand."""


class Cameras:
    """The cameras of all windows. They look straight at the plane of motion, so the mouse stays on a dragged handle.

    With three axes they look at the `parts` at rest around the hand, or at the arm, from as far away as these need.

    Attributes
    ----------
    up : the upward direction.
    """

    def __init__(self, server: viser.ViserServer, dof: int, parts: Sequence[Part], arm: ArmPicture | None) -> None:
        self.up = np.array([0.0, 0.0, 1.0]) if dof > 2 else np.array([0.0, 1.0, 0.0])
        tilt = math.radians(20.0)
        back = (0.0, -math.cos(tilt), math.sin(tilt)) if dof > 2 else (0.0, 0.0, 1.0)
        middle, distance = view_of(parts) if dof > 2 else (np.zeros(3), _DISTANCE)
        if arm is not None:
            back, middle, distance = _BESIDE_AN_ARM, *_view_of_arm(arm)
        self._front = middle + distance * np.array(back), middle
        self._farther: dict[int, float] = {}
        self.look(server.initial_camera)
        for client in server.get_clients().values():
            self.look(client.camera)

    def look(self, camera: viser.InitialCameraConfig | viser.CameraHandle) -> None:
        """Point this camera as it was at the start."""
        camera.fov = _FOV
        position, middle = self._front
        if isinstance(camera, viser.CameraHandle):
            camera.up_direction = self.up  # a user may have turned it
            position = middle + _farther(camera) * (position - middle)
        camera.position, camera.look_at = position, middle

    def fit(self, cameras: Mapping[int, viser.CameraHandle]) -> None:
        """Move a window's camera if the window has become narrower, or wider."""
        for number, camera in cameras.items():
            farther = _farther(camera)
            if abs(self._farther.get(number, 1.0) - farther) > 0.02:
                self.look(camera)
            self._farther[number] = farther


def view_of(parts: Sequence[Part]) -> tuple[Array, float]:
    """The middle of the hand's surroundings, and the distance from which all of them is visible between the panels."""
    solid = [part.vertices for part in parts if part.body < 0 and len(part.vertices)]
    points = UNIT * np.clip(np.concatenate(solid), -REACH_M, REACH_M) if solid else np.zeros((1, 3))
    low, high = np.minimum(points.min(axis=0), -_AROUND), np.maximum(points.max(axis=0), _AROUND)
    middle = np.array([(low[0] + high[0]) / 2.0, 0.0, (low[2] + high[2]) / 4.0])
    return middle, _DISTANCE * max(1.0, float(high[0] - low[0]) / (2.0 * _SEEN))


def _view_of_arm(arm: ArmPicture) -> tuple[Array, float]:
    """The middle of an arm at home, and the distance from which the whole arm is visible."""
    points = UNIT * arm.at_home
    low, high = np.minimum(points.min(axis=0), -_AROUND), np.maximum(points.max(axis=0), _AROUND)
    return (low + high) / 2.0, _DISTANCE * max(1.0, float(np.linalg.norm(high - low)) / (2.0 * _SEEN))


def _farther(camera: viser.CameraHandle) -> float:
    """The factor on the usual distance at which a narrow window still shows the hand's surroundings; 1: not narrow."""
    half_width = _DISTANCE * math.tan(_FOV / 2.0) * camera.image_width / max(camera.image_height, 1)
    return max(1.0, _LEAST_SEEN / half_width) if half_width > 0.0 else 1.0
