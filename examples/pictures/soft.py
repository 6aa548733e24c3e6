"""Draws a simulated hand that presses a soft organ over 4g, as a moving picture: the organ's strain, and the force.

The hand presses beside a part that is eight times as stiff, slides over it, and lets go.

python -m examples.pictures.soft --out DIR
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from PIL import Image

from examples.pictures.drawing import animated, canvas, image
from hapnet.checks import Array, Vector
from hapnet.ext.pictures.style import described
from hapnet.ext.soft.soft_linear import Indices
from hapnet.ext.soft.soft_picture import COLORS, strains_shown
from hapnet.params import Params
from hapnet.plant.operator import Impedance, minimum_jerk
from hapnet.recording.drawing import unpack
from hapnet.simulation.simulation import simulate
from hapnet.summary.words import outcome

SCENE = "soft:organ?lump=8&lump_at=-14mm,12mm,0mm&lump_radius=12mm"
FRAME_S = 0.1
STRAINS = LinearSegmentedColormap.from_list(
    "strains", [(least / COLORS[-1][0], [part / 255.0 for part in color[:3]]) for least, color in COLORS]
)

WAY = (  # time [s], place along x and y [mm], and what happens on the way there
    (0.0, 0.0, 0.0, ""),
    (0.8, 10.0, -18.0, "a ball in the hand"),
    (2.2, 58.0, -18.0, "presses a soft organ"),
    (5.2, 58.0, 26.0, "and slides over a part that is eight times as stiff"),
    (6.2, 58.0, 10.0, "and slides over a part that is eight times as stiff"),
    (7.4, 5.0, 0.0, "it lets go"),
    (8.0, 0.0, 0.0, "it lets go"),
)
TOWARDS = np.array((-0.62, -0.64, 0.45)) / np.linalg.norm((-0.62, -0.64, 0.45))
RIGHT = np.array((0.64, -0.62, 0.0)) / np.hypot(0.64, 0.62)
UP = np.cross(TOWARDS, RIGHT)
LIGHT = np.array((-0.2, -0.6, 0.77))


class Press:
    """The hand, an operator (``module:Class``)."""

    def __init__(self, dof: int, impedance: Impedance) -> None:
        self.impedance = impedance

    def reference(self, t: float) -> Vector:
        for (since, *begin), (until, *end) in pairwise([point[:3] for point in WAY]):
            if t <= until:
                share = minimum_jerk((t - since) / (until - since))
                x, y = (1e-3 * (a + share * (b - a)) for a, b in zip(begin, end, strict=True))
                return (x, y, 0.0)
        return (0.0, 0.0, 0.0)


def faces(vertices: Array, triangles: Indices, colors: Array) -> tuple[Array, Array, Array]:
    """The visible triangles of a surface: corners (F, 3, 2) [mm], colours (F, 3), and nearness to the viewer."""
    corners = vertices[triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-15)
    seen = normals @ TOWARDS > 0.0
    bright = 0.62 + 0.38 * np.clip(normals[seen] @ LIGHT, 0.0, 1.0)
    flat = 1e3 * corners[seen] @ np.stack([RIGHT, UP], axis=1)
    return flat, bright[:, None] * colors[seen], corners[seen].mean(axis=1) @ TOWARDS


def frames() -> tuple[list[Image.Image], str]:
    """The frames of the moving picture, and what the last one shows."""
    changes = {"scene": SCENE, "operator": f"{__name__}:Press", "duration_s": WAY[-1][0], "record_hz": 1000.0}
    result = simulate(Params().set({**changes, "link.up": "4g", "link.down": "4g"}), 1)
    recording = result.recording
    device, samples, drawing = recording.device, recording.scene, recording.drawing
    assert device is not None
    assert drawing is not None
    parts = unpack(drawing.data)
    skin, ball = parts[0].triangles.astype(int), parts[len(COLORS)]
    seen_s = np.array([1e-9 * (sample.time_ns - recording.meta["origin_ns"]) for sample in samples])
    times, force = device["time_s"], np.linalg.norm(device["force_N"], axis=1)
    round_trip = result.summary["path"]["round_trip_p50_ms"]
    kept = {"good": "passive", "bad": "NOT passive", "unknown": "not known"}[outcome(result.summary)]
    figure = canvas(190.0, 95.0)
    grid = figure.add_gridspec(1, 2, width_ratios=[1.3, 1.0])
    view, panel = (figure.add_subplot(cell) for cell in grid)
    view.set(xlim=(-30.0, 76.0), ylim=(-28.0, 62.0), xticks=[], yticks=[], aspect="equal")
    for edge in view.spines.values():
        edge.set_visible(False)
    surface = view.add_collection(PolyCollection([], linewidths=0.3))
    words = view.set_title("", fontsize=10)
    norm = Normalize(0.0, 100.0 * COLORS[-1][0])
    bar = figure.colorbar(ScalarMappable(norm, STRAINS), ax=view, location="bottom", shrink=0.6, aspect=30, pad=0.01)
    bar.set_label("strain [%]")
    panel.set(xlim=(0.0, times[-1]), ylim=(0.0, 1.1 * force.max()), xlabel="time [s]", ylabel="force on the hand [N]")
    (line,) = panel.plot([], [], color="#16a34a", linewidth=1.6)
    figure.suptitle(f"A soft organ over 4g (round trip {round_trip:.0f} ms): {kept}", fontsize=12)
    blue = np.tile(np.array(ball.color[:3]) / 255.0, (len(ball.triangles), 1))
    made = []
    for now in np.arange(FRAME_S, times[-1], FRAME_S):
        sample = samples[max(int(np.searchsorted(seen_s, now, side="right")) - 1, 0)]
        shells = sample.vertices().reshape(len(COLORS), -1, 3)
        strains = strains_shown(shells, skin)
        colors = STRAINS(norm(100.0 * strains[skin].mean(axis=1)))[:, :3]
        hand = ball.vertices + sample.bodies()[0, :3]
        each = [faces(shells[0], skin, colors), faces(hand, ball.triangles.astype(int), blue)]
        flat, shades, near = (np.concatenate(both) for both in zip(*each, strict=True))
        order = np.argsort(near)
        surface.set(verts=list(flat[order]), facecolors=shades[order], edgecolors=shades[order])
        words.set_text(next(point[3] for point in WAY if now <= point[0]))
        i = int(np.searchsorted(times, now))
        line.set_data(times[:i], force[:i])
        made.append(image(figure))
    return made, described(figure)


def main() -> None:
    animated(*frames(), "soft.gif", FRAME_S)


if __name__ == "__main__":
    main()
