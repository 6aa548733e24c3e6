"""The 3-D part of the page: handle, proxy, walls, the device's planes, spring and force; the mouse moves the hand."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import viser

from hapnet.checks import Array, Vector
from hapnet.ext.arms.picture import ArmPicture
from hapnet.ext.page import marks
from hapnet.ext.page.bodies import Bodies, HandleTool
from hapnet.ext.page.cameras import REACH_M, Cameras
from hapnet.ext.page.contacts import ContactMarks
from hapnet.ext.page.grab import Grab
from hapnet.ext.page.hands import HandMarks
from hapnet.ext.page.history import Snapshot, of_point
from hapnet.ext.page.marks import MARK_RADIUS, PROXY_RADIUS, UNIT, padded, spot
from hapnet.plant.worlds.picture import Part

_HANDLE_RADIUS = 0.38
_THICKNESS = 0.8  # of a single wall


class PageScene:
    """Draws a pair with `dof` axes between `surfaces` (`hapnet.plant.worlds.scene.Surface` as dicts).

    One and two axes are seen from the front, three from slightly above, with z upwards.

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
        scene = server.scene
        scene.reset()
        scene.set_up_direction("+z" if dof > 2 else "+y")
        self.cameras = Cameras(server, dof, parts, arm)
        _add_grid(scene, dof)
        walls = list(surfaces) if self._in_metres else []
        for number, surface in enumerate(walls):
            _add_wall(scene, number, dof, walls, surface, wall_name)
        self._bodies = Bodies(scene, parts, UNIT)
        self._hands = HandMarks(scene, self._bodies, UNIT, self.cameras.up)
        self._links = None if arm is None else Bodies(scene, arm.parts, UNIT, "link")
        self._contacts = ContactMarks(scene, UNIT, marks.FORCE_UNIT)
        self._planes = marks.DevicePlanes(scene, dof, self.cameras.up)
        ball = partial(scene.add_icosphere, cast_shadow=False, receive_shadow=False)
        self._target = ball("/target", _HANDLE_RADIUS, marks.SLATE, opacity=0.25, visible=False)
        # before the contacts, which are seen through it
        self._handle = ball("/handle", _HANDLE_RADIUS, marks.BLUE, opacity=0.5 if parts else None)
        self._proxy = ball("/proxy", PROXY_RADIUS, marks.ORANGE)
        self._tool = HandleTool(scene, parts, UNIT) if turns else None
        self._mark = ball("/set_position", MARK_RADIUS, marks.SLATE)
        self._touch = scene.add_icosphere("/touch", MARK_RADIUS, marks.RED, cast_shadow=False, visible=False)
        self._spring = marks.SpringCoil(scene)
        self._force = marks.ForceArrow(scene, self.cameras.up)
        self._names = marks.BallNames(scene, dof, hint=hints and lead is not None)
        self._spot = np.zeros(3)
        self._grab = (
            None
            if lead is None
            else Grab(scene, "/handle", _HANDLE_RADIUS, lambda: self._spot, partial(self._follow, lead))
        )

    @property
    def hints(self) -> bool:
        """Whether the hint at the handle is shown."""
        return self._names.hint.visible

    def show_target(self, position: Vector | None) -> None:
        """Show the hand's target; None: unknown, not shown."""
        self._target.visible = position is not None
        if position is not None:
            self._target.position = spot(position)

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
                self._force.show(device.force_N[-1] if self._in_metres else np.zeros(3))
                if self._links is not None and self._arm is not None:
                    self._links.move(
                        self._arm.poses(self._arm.angles(device.position_m[-1].tolist(), snapshot.posture))
                    )
            if snapshot.scene is not None:
                self._bodies.update(snapshot.scene)
            if (own := self._hands.update(snapshot)) is not None:
                self._proxy.color = own.color
                self._names.name_proxy(own.name)
            self._contacts.update([] if snapshot.scene is None else snapshot.scene.contacts())
            self._show_touch(snapshot)
            planes = (snapshot.planes or ()) if self._in_metres else ()
            self._planes.show(planes, np.zeros(3) if world is None else self._place(world.position_m[-1]))
            if device is not None and world is not None:
                self._spring.show(self._place(device.position_m[-1]), self._place(world.position_m[-1]))
                self._names.part(self._place(device.position_m[-1])[0] - self._place(world.position_m[-1])[0])

    @property
    def _in_metres(self) -> bool:
        """Whether the axes are places in space."""
        return self._arm is None or not self._arm.by_joints

    def _place(self, position: Array) -> Array:
        """The point of the scene at which this position is drawn."""
        return spot(position if self._arm is None else self._arm.tip(position.tolist()))

    def _show_touch(self, snapshot: Snapshot) -> None:
        """Mark the point at which a wall pushes: in front of the proxy by its depth, along the force."""
        world = snapshot.world if snapshot.scene is None and self._in_metres else None
        depth = 0.0 if world is None else float(world.penetration_m[-1])
        force = np.zeros(3) if world is None else padded(world.force_N[-1])
        size = float(np.linalg.norm(force))
        self._touch.visible = depth > 0.0 and size > 0.0
        if world is not None and self._touch.visible:
            self._touch.position = spot(world.position_m[-1]) + force * (UNIT * depth / size)

    def _follow(self, lead: Callable[[Vector], None], middle: Array) -> None:
        self._names.hint.visible = False
        if np.isfinite(middle).all():
            lead(tuple(np.clip(middle[: self.dof] / UNIT, -REACH_M, REACH_M).tolist()))

    def fit(self) -> None:
        """Fit the ball of `Grab` and the cameras to the size of each window; to be called now and then."""
        cameras = {number: client.camera for number, client in self._server.get_clients().items()}
        if self._grab is not None:
            self._grab.fit(cameras.values())
        self.cameras.fit(cameras)


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
        position=(0.0, marks.EXTENT + 1.0, 0.0) if dof > 2 else (0.0, 0.0, -3.0),
        shadow_opacity=0.0,
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
        beside = max(faces) + PROXY_RADIUS if len(faces) > 1 else marks.EXTENT
        size[other] = 2.0 * beside if other < dof or dof > 2 else marks.DEPTH if other == 2 else 2.0 * marks.EXTENT
    alone = len(surfaces) == 1
    size[axis] = _THICKNESS if alone else marks.THIN
    middle[axis] = float(surface["position_m"]) * UNIT + solid * (PROXY_RADIUS + size[axis] / 2.0)
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
