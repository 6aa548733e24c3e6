"""Draws a peg that a simulated hand puts into its hole over 4g, as a moving picture: a section, force and torque.

The hand presses the peg beside the hole, slides to it, aims 1 mm and 5 degrees wrong, and wrings the peg in the hole.

python -m examples.pictures.peg --out DIR
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from matplotlib.patches import Polygon
from PIL import Image

from examples.pictures.drawing import animated, canvas, image
from hapnet.checks import Array, Vector
from hapnet.ext.pictures.style import DEVICE_COLOR, WORLD_COLOR, described
from hapnet.ext.tools.device import turned
from hapnet.mechanics.pose import rotation
from hapnet.params import Params
from hapnet.plant.operator import Impedance, minimum_jerk
from hapnet.recording.poses import of_point, of_turning
from hapnet.simulation.simulation import simulate
from hapnet.summary.words import outcome

RADIUS, LENGTH, HOLE, MOUTH, CHAMFER = 5.0, 30.0, 5.2, -20.0, 1.0  # [mm]
SCENE = f"tool:peg + hole?at=0,0,{MOUTH:g}mm&chamfer={CHAMFER:g}mm&radius={HOLE:g}mm&stiffness=10000"
FRAME_S = 0.1

WAY = (  # time [s], place along x and z [mm], turn about y [degrees], and what happens on the way there
    (0.0, 0.0, 0.0, 0.0, ""),
    (1.2, 8.0, -2.0, 11.0, "the hand turns the peg"),
    (2.4, 8.0, -12.0, 11.0, "it presses the peg on the block"),
    (3.4, 1.0, -12.0, 5.0, "it slides to the hole"),
    (4.8, 1.0, -39.0, 5.0, "1 mm and 5° askew: the hole guides it"),
    (5.6, 0.0, -39.0, 12.0, "it wrings the peg in the hole"),
    (6.6, 0.0, -39.0, -12.0, "it wrings the peg in the hole"),
    (7.2, 0.0, -39.0, 0.0, "it wrings the peg in the hole"),
    (8.8, 0.0, 0.0, 0.0, "and takes it out"),
)


class Insertion:
    """The hand (``module:Class``): the twelve coordinates of its pose."""

    def __init__(self, dof: int, impedance: Impedance) -> None:
        self.impedance = impedance

    def reference(self, t: float) -> Vector:
        for (since, *begin), (until, *end) in pairwise([point[:4] for point in WAY]):
            if t <= until:
                share = minimum_jerk((t - since) / (until - since))
                x, z, turn = (a + share * (b - a) for a, b in zip(begin, end, strict=True))
                return turned((1e-3 * x, 0.0, 1e-3 * z), (0.0, math.radians(turn), 0.0))
        return turned((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def corners(x: Array) -> Array:
    """Corners of the peg at a pose x (12,), in the plane of x and z (4, 2) [mm]."""
    turn = rotation(x)[::2, ::2]
    flat = np.array([(-RADIUS, -15.0), (RADIUS, -15.0), (RADIUS, 15.0), (-RADIUS, 15.0)]) * (1.0, LENGTH / 30.0)
    return flat @ turn.T + 1e3 * x[:3:2]


def block(side: float) -> Polygon:
    """One half of the block's section."""
    wide = HOLE + CHAMFER
    ways = [(30.0, MOUTH), (wide, MOUTH), (HOLE, MOUTH - CHAMFER), (HOLE, -70.0), (30.0, -70.0)]
    return Polygon([(side * x, z) for x, z in ways], facecolor="0.78", edgecolor="0.45")


def frames() -> tuple[list[Image.Image], str]:
    """The frames of the moving picture, and what the last one shows."""
    changes = {"scene": SCENE, "operator": f"{__name__}:Insertion", "duration_s": WAY[-1][0], "record_hz": 1000.0}
    result = simulate(Params().set({**changes, "link.up": "4g", "link.down": "4g"}), 1)
    recording = result.recording
    point, turning = of_point(recording).device, of_turning(recording)
    device, world = recording.device, recording.world
    assert device is not None
    assert world is not None
    assert point is not None
    assert turning is not None
    assert turning.device is not None
    times = device["time_s"]
    curves = {
        "force on the hand [N]": (np.linalg.norm(point["force_N"], axis=1), "#16a34a"),
        "torque on the hand [mNm]": (1e3 * np.linalg.norm(turning.device["force_N"], axis=1), "#9333ea"),
    }
    round_trip = result.summary["path"]["round_trip_p50_ms"]
    kept = {"good": "passive", "bad": "NOT passive", "unknown": "not known"}[outcome(result.summary)]
    figure = canvas(190.0, 105.0)
    grid = figure.add_gridspec(2, 2, width_ratios=[1.0, 1.35])
    section = figure.add_subplot(grid[:, 0])
    section.set(xlim=(-25.0, 25.0), ylim=(-60.0, 20.0), xticks=[], yticks=[], aspect="equal")
    section.grid(visible=False)
    for side in (-1.0, 1.0):
        section.add_patch(block(side))
    proxy = Polygon(corners(world["position_m"][0]), facecolor=WORLD_COLOR, alpha=0.85, label="peg, in the world")
    handle = Polygon(corners(device["position_m"][0]), facecolor="none", edgecolor=DEVICE_COLOR, linewidth=2.0,
                     label="where the hand is")  # fmt: skip
    section.add_patch(proxy)
    section.add_patch(handle)
    section.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=2, fontsize=8, columnspacing=1.0)
    words = section.set_title("", fontsize=10)
    figure.suptitle(f"Peg in hole, 0.2 mm clearance, over 4g (round trip {round_trip:.0f} ms): {kept}", fontsize=12)
    lines = []
    for row, (label, (values, colour)) in enumerate(curves.items()):
        panel = figure.add_subplot(grid[row, 1])
        panel.set(xlim=(0.0, times[-1]), ylim=(0.0, 1.1 * values.max()), ylabel=label)
        lines.append((panel.plot([], [], color=colour, linewidth=1.6)[0], values))
    panel.set_xlabel("time [s]")
    made = []
    for now in np.arange(FRAME_S, times[-1], FRAME_S):
        i = int(np.searchsorted(times, now))
        j = max(int(np.searchsorted(world["time_s"], now, side="right")) - 1, 0)
        proxy.set_xy(corners(world["position_m"][j]))
        handle.set_xy(corners(device["position_m"][i]))
        words.set_text(next(point[4] for point in WAY if now <= point[0]))
        for line, values in lines:
            line.set_data(times[:i], values[:i])
        made.append(image(figure))
    return made, described(figure)


def main() -> None:
    animated(*frames(), "peg.gif", FRAME_S)


if __name__ == "__main__":
    main()
