"""The figure of a rigid scene: its solids, and the ways of device and proxy around them."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from hapnet.checks import Array
from hapnet.plant.worlds.outlines import outline, solids_of
from hapnet.recording.samples import Recording
from hapnet.report.style import DEVICE_COLOR, MM, STYLE, WORLD_COLOR
from hapnet.report.words import get

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST_TRIANGLES = 20_000
"""Of a larger mesh only the corners are drawn."""

_MOST_POINTS = 4000
_MARGIN_M = 0.01
_MM = 1e3


def scene_figure(recording: Recording) -> Figure | None:
    """Solids and ways in 3-D, 180 mm wide. None: the scene has no solids or fewer axes, or its files are gone."""
    device, world = recording.device, recording.world
    if device is None or world is None or device["position_m"].shape[1] != 3:
        return None
    if not (solids := solids_of(get(recording.meta, "scene"))):
        return None
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    pressed = np.linalg.norm(world["contact_force_N"], axis=1) > 0.0
    ways = np.concatenate([device["position_m"], world["position_m"]])
    centre, reach = ways.mean(axis=0), float(np.ptp(ways, axis=0).max()) / 2.0 + _MARGIN_M
    with matplotlib.rc_context(STYLE):
        fig = Figure(figsize=(180 * MM, 120 * MM), dpi=150, layout="constrained")
        FigureCanvasAgg(fig)
        axes: Any = fig.add_subplot(projection="3d")
        seen = [ways]
        for solid in solids:
            if (found := outline(solid.shape, centre, reach)) is None:
                continue
            vertices, triangles = found
            seen.append(vertices)
            if len(triangles) > _MOST_TRIANGLES:
                points = vertices[:: -(-len(vertices) // _MOST_POINTS)] * _MM
                axes.scatter(*points.T, s=0.5, color="0.6", linewidths=0.0)
                continue
            faces = Poly3DCollection(vertices[triangles] * _MM, facecolors="0.8", alpha=0.35, shade=True, zorder=0)
            axes.add_collection3d(faces)
        _way(axes, device["position_m"], DEVICE_COLOR, "device")
        _way(axes, world["position_m"], WORLD_COLOR, "proxy")
        if pressed.any():
            touched = world["position_m"][pressed] * _MM
            axes.plot(*touched.T, ".", color="#b91c1c", markersize=3, label="proxy in contact", zorder=5)
        _frame(axes, np.concatenate(seen), _seen_from(world["contact_force_N"]))
        axes.legend(loc="upper left")
        title = fill(f"Scene {get(recording.meta, 'scene')}: the ways of device and proxy", 100)
        fig.suptitle(title, fontsize=9, parse_math=False)
    return fig


def _way(axes: Any, position: Array, color: str, label: str) -> None:
    step = -(-len(position) // _MOST_POINTS)
    axes.plot(*(position[::step] * _MM).T, color=color, linewidth=1.2, label=label, zorder=4)


def _frame(axes: Any, points: Array, azimuth: float) -> None:
    """All of it, the same scale along all axes."""
    low, high = points.min(axis=0) * _MM, points.max(axis=0) * _MM
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(np.maximum(high - low, 1.0), zoom=1.15)
    axes.view_init(elev=25.0, azim=azimuth)


def _seen_from(force: Array) -> float:
    """From the side of the mean contact force, so that no solid hides the contact [degrees]."""
    x, y, _ = force.sum(axis=0)
    return float(np.degrees(np.arctan2(y, x))) + 35.0 if x or y else -60.0
