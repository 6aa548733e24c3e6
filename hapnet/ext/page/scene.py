"""The 3-D part of the page: handle, proxy, walls, the device's planes, spring and force; the mouse moves the hand.

Scene units are centimetres, so that motions of some 40 mm suit viser's camera and clipping.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import zip_longest
from typing import Any, Literal

import numpy as np
import viser
import viser.transforms
from numpy.typing import NDArray

from hapnet.checks import MOST_PLANES, Array, Vector
from hapnet.ext.arms.picture import ArmPicture
from hapnet.ext.page.bodies import Bodies, HandleTool
from hapnet.ext.page.contacts import ContactMarks, turned_to
from hapnet.ext.page.grab import Grab
from hapnet.ext.page.history import Snapshot, of_point
from hapnet.mechanics.plane import Plane
from hapnet.plant.worlds.picture import Part

UNIT = 100.0
"""Scene units per metre."""

FORCE_UNIT = 1.0
"""Length of the arrow, in scene units per newton."""

REACH_M = 0.1
"""The mouse leads the hand at most this far from the origin on each axis: the workspace of a desktop device [m]."""

BLUE, ORANGE, GREEN, SLATE = (37, 99, 235), (234, 88, 12), (22, 163, 74), (71, 85, 105)
RED = (220, 38, 38)

_HANDLE_RADIUS, _PROXY_RADIUS, _MARK_RADIUS = 0.38, 0.3, 0.12
_EXTENT = 4.5  # of a wall, from the origin, where no other wall ends it
_THICKNESS, _THIN = 0.8, 0.1  # of a single wall, and of each of several walls
_DEPTH = 3.0  # of a wall, across the plane of motion
_BEYOND = 0.4  # a plane of the device extends so far beyond a wall
_FLAT_M = 1e-3  # a plane of a curved surface is drawn as far as it is within this distance of the surface
_LIFT = 0.75  # the arrow is drawn above the spring, which has the same direction
_FOV = math.radians(30.0)
_DISTANCE = 24.0
_SEEN = 5.0  # half the width that is visible between the panels from that distance
_LEAST_SEEN = 4.0  # half the width that is visible in a narrow window
_AROUND = 3.0  # the surroundings of the hand that are always visible


_BESIDE_AN_ARM = (0.64, 0.64, 0.42)
"""The direction from which the camera shows an arm, with the arm's base behind the hand."""


class PageScene:
    """Draws a pair with `dof` axes between `surfaces` (`hapnet.plant.worlds.scene.Surface` as dicts).

    One and two axes are seen from the front, three from slightly above, with z upwards.
    More than twenty attributes: one for each thing that is drawn.

    lead : called with the hand's target, (n,) [m], during a drag of the handle; None: it cannot be dragged.
    wall_name : the label of a single wall. parts : of the world, drawn beside its walls.
    arm : the device, if it is an arm; with axes in radians, handle and proxy are drawn at its tip.
    turns : one of the parts is a tool that the handle turns. hints : write at the handle how to use it, until the
        first drag.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        dof: int,
        surfaces: Iterable[Mapping[str, Any]],
        lead: Callable[[Vector], None] | None,
        wall_name: str = "wall",
        parts: Sequence[Part] = (),
        arm: ArmPicture | None = None,
        *,
        turns: bool = False,
        hints: bool = False,
    ) -> None:
        self.dof = dof
        self._arm = arm
        self._server = server
        scene = self._scene = server.scene
        scene.reset()
        scene.set_up_direction("+z" if dof > 2 else "+y")
        self._look(parts)
        _add_grid(scene, dof)
        walls = list(surfaces) if self._in_metres else []
        for number, surface in enumerate(walls):
            _add_wall(scene, number, dof, walls, surface, wall_name)
        self._bodies = Bodies(scene, parts, UNIT)
        self._links = None if arm is None else Bodies(scene, arm.parts, UNIT, "link")
        self._contacts = ContactMarks(scene, UNIT, FORCE_UNIT)
        self._known: tuple[Plane, ...] = ()
        self._planes = [_add_plane(scene, number, dof) for number in range(MOST_PLANES)]
        self._model_name = scene.add_label(
            "/model_name", "the device's model", anchor="top-left", font_screen_scale=0.75, visible=False
        )
        ball = partial(scene.add_icosphere, cast_shadow=False, receive_shadow=False)
        self._target = ball("/target", _HANDLE_RADIUS, SLATE, opacity=0.25, visible=False)
        self._handle = ball("/handle", _HANDLE_RADIUS, BLUE, opacity=0.5 if parts else None)  # before the contacts
        self._proxy = ball("/proxy", _PROXY_RADIUS, ORANGE)
        self._tool = HandleTool(scene, parts, UNIT) if turns else None
        self._mark = ball("/set_position", _MARK_RADIUS, SLATE)
        self._touch = scene.add_icosphere("/touch", _MARK_RADIUS, RED, cast_shadow=False, visible=False)
        self._spring = scene.add_line_segments(
            "/spring", _coil(), SLATE, thickness=2.5, thickness_units="screen", visible=False
        )
        self._arrow = scene.add_arrows(
            "/handle/force",
            np.zeros((1, 2, 3)),
            GREEN,
            shaft_radius=0.07,
            head_radius=0.19,
            head_length=0.4,
            visible=False,
        )
        self._newtons = scene.add_label("/handle/force_label", "", anchor="bottom-center", visible=False)
        below = (0.0, -0.55, 0.0) if dof < 3 else (0.0, 0.0, -0.55)
        self._names = [  # side by side if both are at the same place
            scene.add_label("/handle/name", " handle ", position=below, anchor="top-right", font_screen_scale=0.85),
            scene.add_label("/proxy/name", " proxy ", position=below, anchor="top-left", font_screen_scale=0.85),
        ]
        self._hint = scene.add_label(
            "/handle/hint", " drag me ", position=0.55 * self._up, anchor="bottom-center",
            visible=hints and lead is not None,
        )  # fmt: skip
        self._handle_is_right = False
        self._spot = np.zeros(3)
        self._farther: dict[int, float] = {}
        self._grab = (
            None
            if lead is None
            else Grab(scene, "/handle", _HANDLE_RADIUS, lambda: self._spot, partial(self._follow, lead))
        )

    @property
    def hints(self) -> bool:
        """Whether the hint at the handle is shown."""
        return self._hint.visible

    def show_target(self, position: Vector | None) -> None:
        """Show the hand's target; None: unknown, not shown."""
        self._target.visible = position is not None
        if position is not None:
            self._target.position = _spot(position)

    def update(self, snapshot: Snapshot) -> None:
        """Draw the newest sample of each side."""
        whole, snapshot = snapshot, of_point(snapshot)
        device, world = snapshot.device, snapshot.world
        with self._server.atomic():
            if self._tool is not None:
                self._tool.update(whole)
            for track, node in ((device, self._handle), (world, self._proxy)):
                node.visible = track is not None
                if track is not None:
                    node.position = self._place(track.position_m[-1])
            self._mark.visible = device is not None
            if device is not None:
                self._spot = self._place(device.position_m[-1])
                self._mark.position = self._place(device.set_position_m[-1])
                self._show_force(device.force_N[-1] if self._in_metres else np.zeros(3))
                if self._links is not None and self._arm is not None:
                    self._links.move(
                        self._arm.poses(self._arm.angles(device.position_m[-1].tolist(), snapshot.posture))
                    )
            if snapshot.scene is not None:
                self._bodies.update(snapshot.scene)
            self._contacts.update([] if snapshot.scene is None else snapshot.scene.contacts())
            self._show_touch(snapshot)
            planes = (snapshot.planes or ()) if self._in_metres else ()
            self._show_planes(planes, np.zeros(3) if world is None else self._place(world.position_m[-1]))
            if device is not None and world is not None:
                self._show_spring(self._place(device.position_m[-1]), self._place(world.position_m[-1]))
                self._part_names(self._place(device.position_m[-1])[0] - self._place(world.position_m[-1])[0])

    @property
    def _in_metres(self) -> bool:
        """Whether the axes are places in space."""
        return self._arm is None or not self._arm.by_joints

    def _place(self, position: Array) -> Array:
        """The point of the scene at which this position is drawn."""
        return _spot(position if self._arm is None else self._arm.tip(position.tolist()))

    def _part_names(self, apart: float) -> None:
        """Put the two names on different sides; `apart` : how far the handle is to the right of the proxy."""
        if abs(apart) > _MARK_RADIUS and (apart > 0.0) != self._handle_is_right:
            self._handle_is_right = apart > 0.0
            sides: list[Literal["top-left", "top-right"]] = ["top-right", "top-left"]
            for name, side in zip(self._names, reversed(sides) if self._handle_is_right else sides, strict=True):
                name.anchor = side

    def _show_touch(self, snapshot: Snapshot) -> None:
        """Mark the point at which a wall pushes: in front of the proxy by its depth, along the force."""
        world = snapshot.world if snapshot.scene is None and self._in_metres else None
        depth = 0.0 if world is None else float(world.penetration_m[-1])
        force = np.zeros(3) if world is None else _padded(world.force_N[-1])
        size = float(np.linalg.norm(force))
        self._touch.visible = depth > 0.0 and size > 0.0
        if world is not None and self._touch.visible:
            self._touch.position = _spot(world.position_m[-1]) + force * (UNIT * depth / size)

    def _show_planes(self, planes: tuple[Plane, ...], proxy: Array) -> None:
        """Draw the planes that the device has received, moved back by the proxy's radius like the walls.

        The plane of a curved surface is drawn as a small piece at the foot of the proxy.
        """
        if planes == self._known:
            return
        self._known = planes
        for node, plane in zip_longest(self._planes, planes[:MOST_PLANES]):
            normal = _padded(() if plane is None else plane.normal)
            node.visible = float(np.linalg.norm(normal)) > 0.5
            if plane is not None and node.visible:
                share = _flat_share(plane)
                beside = proxy - normal * float(normal @ proxy) if share < 1.0 else np.zeros(3)
                node.position = beside + normal * (plane.offset_m * UNIT + _PROXY_RADIUS + _THIN / 2.0)
                node.scale = (1.0, share, share)
                node.wxyz = turned_to(normal)
        self._model_name.visible = self._planes[0].visible
        if planes:
            self._model_name.position = np.array(self._planes[0].position) - self._up * (_EXTENT + _BEYOND)

    def _show_force(self, force: Array) -> None:
        size = float(np.linalg.norm(force))
        self._arrow.visible = self._newtons.visible = size > 0.02
        if size <= 0.02:
            return
        tail = self._up * _LIFT
        tip = tail + _padded(force) * FORCE_UNIT
        self._arrow.points = np.array([[tail, tip]], dtype=np.float32)
        self._newtons.position = (tail + tip) / 2.0 + self._up * 0.25
        self._newtons.text = f"{size:.2f} N"

    def _show_spring(self, a: Array, b: Array) -> None:
        path = b - a
        length = float(np.linalg.norm(path))
        self._spring.visible = length > 0.05
        if length <= 0.05:
            return
        self._spring.position = a
        self._spring.wxyz = turned_to(path / length)
        self._spring.scale = (length, 1.0, 1.0)

    def _look(self, parts: Sequence[Part]) -> None:
        """Point the cameras straight at the plane of motion, so that the dragged handle stays under the mouse.

        With three axes: at the parts at rest around the hand, from as far away as they need.
        """
        self._up = np.array([0.0, 0.0, 1.0]) if self.dof > 2 else np.array([0.0, 1.0, 0.0])
        tilt = math.radians(20.0)
        back = (0.0, -math.cos(tilt), math.sin(tilt)) if self.dof > 2 else (0.0, 0.0, 1.0)
        middle, distance = _view_of(parts) if self.dof > 2 else (np.zeros(3), _DISTANCE)
        if self._arm is not None:
            back, middle, distance = _BESIDE_AN_ARM, *_view_of_arm(self._arm)
        self._front = middle + distance * np.array(back), middle
        self.look(self._server.initial_camera)
        for client in self._server.get_clients().values():
            self.look(client.camera)

    def look(self, camera: viser.InitialCameraConfig | viser.CameraHandle) -> None:
        """Point this camera as it was at the start."""
        camera.fov = _FOV
        position, middle = self._front
        if isinstance(camera, viser.CameraHandle):
            camera.up_direction = self._up  # a user may have turned it
            position = middle + _farther(camera) * (position - middle)
        camera.position, camera.look_at = position, middle

    def _follow(self, lead: Callable[[Vector], None], middle: Array) -> None:
        self._hint.visible = False
        if np.isfinite(middle).all():
            lead(tuple(np.clip(middle[: self.dof] / UNIT, -REACH_M, REACH_M).tolist()))

    def fit(self) -> None:
        """Fit the ball of `Grab` and the cameras to the size of each window; to be called now and then."""
        cameras = {number: client.camera for number, client in self._server.get_clients().items()}
        if self._grab is not None:
            self._grab.fit(cameras.values())
        for number, camera in cameras.items():
            farther = _farther(camera)
            if abs(self._farther.get(number, 1.0) - farther) > 0.02:  # the window has become narrower, or wider
                self.look(camera)
            self._farther[number] = farther


def _view_of(parts: Sequence[Part]) -> tuple[Array, float]:
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


def _spot(position: Array | Vector) -> Array:
    return _padded(position) * UNIT


def _padded(vector: Array | Vector) -> Array:
    """The first three axes of `vector`; missing ones are 0."""
    out = np.zeros(3)
    shown = np.asarray(vector, dtype=float)[:3]
    out[: len(shown)] = shown
    return out


def _coil(turns: int = 9, radius: float = 0.16, lead: float = 0.12) -> NDArray[np.float32]:
    """A spring along x from 0 to 1, its ends straight, as segments (N, 2, 3)."""
    along = np.linspace(0.0, 1.0, turns * 12 + 1)
    angle = 2.0 * math.pi * turns * along
    points = np.stack([lead + (1.0 - 2.0 * lead) * along, radius * np.sin(angle), radius * (np.cos(angle) - 1.0)], 1)
    points = np.vstack([[0.0, 0.0, 0.0], points, [1.0, 0.0, 0.0]])
    return np.stack([points[:-1], points[1:]], 1).astype(np.float32)


def _add_grid(scene: viser.SceneApi, dof: int) -> None:
    scene.add_label(
        "/scale",
        "a square: 10 mm",
        position=(-4.6, 0.0, -5.9) if dof > 2 else (-4.6, -5.9, 0.0),
        anchor="center-left",
        font_screen_scale=0.85,
    )
    scene.add_grid(
        "/grid",
        width=24.0,
        height=24.0,
        plane="xz" if dof > 2 else "xy",
        cell_size=1.0,
        section_size=5.0,
        cell_color=(226, 232, 240),
        section_color=(203, 213, 225),
        position=(0.0, _EXTENT + 1.0, 0.0) if dof > 2 else (0.0, 0.0, -3.0),
        shadow_opacity=0.0,
    )


def _flat_share(plane: Plane) -> float:
    """The share of a plane within which the surface is at most `_FLAT_M` away from the plane; 1: the whole plane."""
    bend = max([abs(per_m) for _, per_m in plane.curvatures], default=0.0)
    whole = (_EXTENT + _BEYOND) / UNIT
    return min(1.0, math.sqrt(2.0 * _FLAT_M / bend) / whole) if bend else 1.0


def _add_plane(scene: viser.SceneApi, number: int, dof: int) -> viser.BoxHandle:
    """A plane that the device may receive: a thin slab across the x axis, a little larger than a wall."""
    return scene.add_box(
        f"/plane_{number}",
        BLUE,
        (_THIN, 2.0 * (_EXTENT + _BEYOND), 2.0 * (_EXTENT + _BEYOND) if dof > 2 else _DEPTH + _BEYOND),
        opacity=0.15,
        cast_shadow=False,
        receive_shadow=False,
        side="double",
        visible=False,
    )


def _add_wall(
    scene: viser.SceneApi,
    number: int,
    dof: int,
    surfaces: list[Mapping[str, Any]],
    surface: Mapping[str, Any],
    name: str,
) -> None:
    """A slab on the solid side, moved back by the proxy's radius, as the proxy is a point but is drawn as a ball."""
    axis, solid = int(surface["axis"]), int(surface["solid"])
    if axis > 2:
        return
    middle, size = np.zeros(3), np.empty(3)
    for other in range(3):
        faces = [abs(float(s["position_m"])) * UNIT for s in surfaces if int(s["axis"]) == other]
        beside = max(faces) + _PROXY_RADIUS if len(faces) > 1 else _EXTENT
        size[other] = 2.0 * beside if other < dof or dof > 2 else _DEPTH if other == 2 else 2.0 * _EXTENT
    alone = len(surfaces) == 1
    size[axis] = _THICKNESS if alone else _THIN
    middle[axis] = float(surface["position_m"]) * UNIT + solid * (_PROXY_RADIUS + size[axis] / 2.0)
    before_the_rest = dof > 2 and (axis, solid) in ((1, -1), (2, 1))
    scene.add_box(
        f"/wall_{number}",
        (148, 163, 184),
        size,
        opacity=0.05 if before_the_rest else 0.35 if alone or dof < 3 else 0.2,
        position=middle,
        cast_shadow=False,
        receive_shadow=False,
        side="double",
    )
    if alone:
        corner = np.zeros(3)
        corner[1 if dof < 3 else 2] = size[1 if dof < 3 else 2] / 2.0 + 0.2
        scene.add_label("/wall_name", name, position=middle + corner, anchor="bottom-center", font_screen_scale=0.85)
