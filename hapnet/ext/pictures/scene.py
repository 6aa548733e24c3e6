"""The figure of a scene: its solids and bodies, and the paths of device and proxy around them.

Moving bodies are drawn at the time of the largest force, with the contacts of that moment, and faintly at other times:
at the start and at the end, and if there are few bodies also in between.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hapnet.checks import Array
from hapnet.ext.arms.picture import ArmPicture
from hapnet.ext.pictures.style import DEVICE_COLOR, WORLD_COLOR, headed, sheet
from hapnet.ext.solids.rigid import parts_of_words
from hapnet.plant.worlds.picture import RESTS, SOFT, Part, Touch
from hapnet.recording.drawing import SceneSample, unpack
from hapnet.recording.poses import of_point
from hapnet.recording.samples import Columns, Recording
from hapnet.summary.words import get

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST_TRIANGLES = 40_000
"""A mesh with more triangles is drawn as its corners only."""

_MOST_POINTS = 4000
_FAR_M = 0.5
_FEW_BODIES, _FEW = 3, 10
_FEW_ARMS = 3
_MM = 1e3
_MM_PER_N = 10.0
_OPACITY, _FAINT = 0.6, 0.12
_ZOOMS = (1.15, 1.1, 1.05, 1.0, 0.95, 0.9, 0.85, 0.8, 0.75, 0.7, 0.65, 0.6)
_RED, _AMBER = "#b91c1c", "#d97706"


def scene_figure(recording: Recording) -> Figure | None:
    """Solids, bodies, an arm's links and paths in 3-D, 180 mm wide.

    None: the scene's parts are not known, or it has fewer axes and nothing moves.
    """
    recording = of_point(recording)
    device, world, arm = recording.device, recording.world, ArmPicture.of(recording.meta)
    if device is None or world is None:
        return None
    by_joints = arm is not None and arm.by_joints
    parts = () if by_joints else _parts(recording)
    if (device["position_m"].shape[1] > 3 and not by_joints) or not (parts or arm):
        return None
    peak, others = _moments(recording.scene, world)
    moves = peak is not None and any(part.body != RESTS for part in parts)
    if device["position_m"].shape[1] != 3 and not moves and not by_joints:
        return None
    if arm is not None and arm.by_joints:
        hand, proxy = (
            np.array([arm.tip(position) for position in columns["position_m"][:: _every(columns)].tolist()])
            for columns in (device, world)
        )
        force = np.zeros_like(proxy)  # torques at joints are not drawn
    else:
        hand, proxy, force = (
            np.pad(columns[name], ((0, 0), (0, 3 - columns[name].shape[1])))  # three axes
            for columns, name in ((device, "position_m"), (world, "position_m"), (world, "contact_force_N"))
        )
    deep = world["penetration_m"][:: _every(world) if by_joints else 1] > 0.0
    pressed = deep if deep.any() else np.linalg.norm(force, axis=1) > 0.0  # a force law has no depth
    with sheet(120) as fig:
        axes: Any = fig.add_subplot(projection="3d", computed_zorder=False)
        shown = _placed(parts, peak)
        ghosts = [part for moment in others for part in _placed(parts, moment) if part.body != RESTS]
        shown, ghosts = (_near(proxy, some) for some in (shown, ghosts))
        if arm is not None:
            links, ghost_links = _arm_at(arm, recording)
            shown, ghosts = shown + links, ghosts + ghost_links
        when = ", with the bodies at the time of the largest force" if moves or arm is not None else ""
        name = get(recording.meta, "params", "scene") or get(recording.meta, "scene")  # as the user has given it
        headed(fig, f"Scene {name}: the paths of device and proxy{when}", letters=100)
        _frame(axes, np.concatenate([hand, proxy, *[part.vertices for part in (*shown, *ghosts)]]), _seen_from(force))
        _surfaces(axes, [part for part in shown if part.body == RESTS], _OPACITY, zorder=0)
        _surfaces(axes, ghosts, _FAINT, zorder=1)
        _surfaces(axes, [part for part in shown if part.body != RESTS], 1.0, zorder=2)
        _path(axes, hand, DEVICE_COLOR, "device")
        _path(axes, proxy, WORLD_COLOR, "proxy")
        if pressed.any():
            axes.plot(*(proxy[pressed] * _MM).T, ".", color=_RED, markersize=3, label="proxy in contact", zorder=5)
        if peak is not None:
            _contacts(axes, peak.contacts())
        axes.legend(loc="upper left")
    return fig


def _every(columns: Columns) -> int:
    return -(-len(columns["time_ns"]) // _MOST_POINTS)


def _arm_at(arm: ArmPicture, recording: Recording) -> tuple[list[Part], list[Part]]:
    """The arm's links at the time of the largest force, and at other times."""
    device = recording.device
    assert device is not None
    top = int(np.linalg.norm(device["force_N"], axis=1).argmax())
    moments = [top, *np.linspace(0, len(device["time_ns"]) - 1, _FEW_ARMS).astype(int).tolist()]
    placed = []
    times = np.array([one.time_ns for one in recording.posture])
    for moment in moments:
        near = np.abs(times - device["time_ns"][moment]).argmin() if len(times) else -1
        posture = recording.posture[near].angles_rad if len(times) else ()
        poses = arm.poses(arm.angles(device["position_m"][moment].tolist(), posture))
        placed.append([_moved(part, poses) for part in arm.parts])
    return placed[0], [part for some in placed[1:] for part in some if part.body != RESTS]


def _moved(part: Part, poses: Array) -> Part:
    if part.body < 0:
        return part
    return part._replace(vertices=part.vertices @ _turn(poses[part.body, 3:]).T + poses[part.body, :3])


def _parts(recording: Recording) -> tuple[Part, ...]:
    """The parts from the recording or, for an old recording or a scene too large to be sent, from the scene's text."""
    recorded = () if recording.drawing is None else unpack(recording.drawing.data)
    return recorded or parts_of_words(get(recording.meta, "scene"))


def _moments(scene: Sequence[SceneSample], world: Columns) -> tuple[SceneSample | None, list[SceneSample]]:
    """The scene at the time of the largest force, and at other times."""
    if not scene:
        return None, []
    top = int(np.linalg.norm(world["contact_force_N"], axis=1).argmax())
    times = np.array([one.time_ns for one in scene])
    peak = scene[int(np.abs(times - world["time_ns"][top]).argmin())]
    count = _FEW if len(peak.bodies()) <= _FEW_BODIES else 2
    return peak, [scene[i] for i in np.linspace(0, len(scene) - 1, count).astype(int)]


def _placed(parts: Sequence[Part], moment: SceneSample | None) -> list[Part]:
    """The parts at the places of their bodies."""
    if moment is None:
        return list(parts)
    poses, soft, placed = moment.bodies(), moment.vertices(), []
    for part in parts:
        vertices = part.vertices
        if part.body == SOFT and len(soft) >= len(vertices):
            vertices, soft = soft[: len(vertices)], soft[len(vertices) :]
            part = part._replace(vertices=vertices)
        placed.append(_moved(part, poses) if part.body < len(poses) else part)
    return placed


def _near(path: Array, parts: Sequence[Part]) -> list[Part]:
    """The parts without bodies that are far away, such as a body that fell off a table."""
    middle = path.mean(axis=0)
    return [part for part in parts if part.body == RESTS or np.abs(part.vertices - middle).max() < _FAR_M]


def _turn(quaternion: Array) -> Array:
    """The matrix of a unit quaternion w, x, y, z."""
    w, x, y, z = quaternion
    return np.array(
        [
            (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
            (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
            (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
        ]
    )


def _surfaces(axes: Any, parts: Sequence[Part], opacity: float, zorder: int) -> None:
    """Draw all triangles in one collection, so that they are sorted by depth; of too many, only their corners.

    Parts at rest are drawn before moving parts, as a table's triangles are too large to be sorted.
    """
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    faces, colors = [], []
    for part in parts:
        if len(part.triangles) > _MOST_TRIANGLES:
            points = part.vertices[:: -(-len(part.vertices) // _MOST_POINTS)] * _MM
            axes.scatter(*points.T, s=0.5, color="0.6", linewidths=0.0)
        elif len(part.triangles):
            faces.append(part.vertices[part.triangles] * _MM)
            *color, own = (channel / 255.0 for channel in part.color)
            colors.append(np.tile((*color, own * opacity), (len(part.triangles), 1)))
    if faces:
        paint = np.concatenate(colors)
        seams = {"edgecolors": paint, "linewidths": 0.3} if opacity == 1.0 else {"linewidths": 0.0}
        axes.add_collection3d(
            Poly3DCollection(np.concatenate(faces), facecolors=paint, shade=True, zorder=zorder, **seams)
        )


def _contacts(axes: Any, touches: Sequence[Touch]) -> None:
    """Draw each contact's friction cone, as high as the normal force is long, and the force in it."""
    top_N = np.linalg.norm(sum((np.array(touch.force_N) for touch in touches), np.zeros(3)))
    force_label, cone_label = f"the largest force, {top_N:.2g} N", "its friction cone"
    for touch in touches:
        point, normal = np.array(touch.point) * _MM, np.array(touch.normal)
        force = _MM_PER_N * np.array(touch.force_N)
        axes.plot(*np.stack([point, point + force], 1), color=_RED, linewidth=2.0, zorder=6, label=force_label)
        axes.plot(*point, "o", color=_RED, markersize=4, zorder=6)
        force_label = ""
        if touch.friction > 0.0 and (height := float(force @ normal)) > 0.0:
            one = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
            one /= np.linalg.norm(one)
            turn = np.linspace(0.0, 2.0 * np.pi, 49)[:, None]
            around = np.cos(turn) * one + np.sin(turn) * np.cross(normal, one)
            rim = point + height * (normal + touch.friction * around)
            axes.plot(*rim.T, color=_AMBER, linewidth=1.0, zorder=6, label=cone_label)
            cone_label = ""
            for edge in rim[:-1:6]:
                axes.plot(*np.stack([point, edge], 1), color=_AMBER, linewidth=0.6, zorder=6)


def _path(axes: Any, position: Array, color: str, label: str) -> None:
    step = -(-len(position) // _MOST_POINTS)
    axes.plot(*(position[::step] * _MM).T, color=color, linewidth=1.2, label=label, zorder=4)


def _frame(axes: Any, points: Array, azimuth: float) -> None:
    """Fit the axes to all points, with the same scale, as large as their labels allow; they are still empty."""
    low, high = points.min(axis=0) * _MM, points.max(axis=0) * _MM
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    sides = np.maximum(high - low, 1.0)
    for name, side in zip("xyz", sides, strict=True):
        axes.locator_params(axis=name, nbins=7 if side > 0.4 * sides.max() else 3)
    axes.view_init(elev=25.0, azim=azimuth)
    figure = axes.figure
    for zoom in _ZOOMS:
        axes.set_box_aspect(sides, zoom=zoom)
        for _ in range(2):  # the first time the labels are still where they were
            figure.draw_without_rendering()
        labels = [axis.get_tightbbox(figure.canvas.get_renderer()) for axis in (axes.xaxis, axes.yaxis, axes.zaxis)]
        if all(figure.bbox.contains(x, y) for box in labels for x, y in box.corners()):
            break
    figure.set_layout_engine("none")  # what is drawn from now on moves nothing


def _seen_from(force: Array) -> float:
    """The azimuth of the camera [degrees], on the side of the mean contact force, so that it is not hidden."""
    x, y, _ = force.sum(axis=0)
    return float(np.degrees(np.arctan2(y, x))) + 35.0 if x or y else -60.0
