"""Draws the force on a hand that slides over a grain, over 4g: rendered by the device, and by the world alone.

python -m examples.pictures.grain --out DIR
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from examples.pictures.drawing import canvas, saved
from hapnet import simulate
from hapnet.checks import Array, Vector
from hapnet.ext.pictures.style import DEVICE_COLOR, WORLD_COLOR
from hapnet.ext.solids.rigid import RigidScene
from hapnet.ext.solids.rigid_contacts import RigidContacts, Solid
from hapnet.ext.solids.shapes import HalfSpace
from hapnet.mechanics.effects import Effects, Grain
from hapnet.mechanics.plane import Plane
from hapnet.plant.operator import Impedance

SPEED_MPS, DEEP_M, FACE_M = 0.05, 0.01, 0.02
LENGTH_M = 1.6e-3
WAVES = {1: 2e-4, 3: 1e-4, 8: 5e-5}
"""Waves of the grain: their number in a period, and their height [m]."""
K, K_WORLD, K_WALL = 200.0, 500.0, 3000.0
FELT = 1.0 / (1.0 / K + K_WORLD / (K * K_WALL))
BEGIN_S, WINDOW_S, SHOWN_S = 1.0, 0.96, 0.2

_period = np.arange(256) / 256
GRAIN = Grain.of(
    [float(sum(high * np.sin(2 * np.pi * n * at) for n, high in WAVES.items())) for at in _period], LENGTH_M, (0, 1, 0)
)


class Hand:
    """A firm hand: half a second to 10 mm deep, then along y."""

    def __init__(self, dof: int, impedance: Impedance) -> None:
        self.impedance, self._dof = Impedance(0.5, 60.0, 3000.0), dof

    def reference(self, t: float) -> Vector:
        within = min(1.0, t / 0.5)
        within = within * within * (3.0 - 2.0 * within)
        return ((FACE_M + DEEP_M) * within, max(0.0, t - 0.7) * SPEED_MPS, 0.0)[: self._dof]


class AtWorldsRate(RigidContacts):
    """A world that lifts its planes by the height of the grain at the proxy."""

    def planes(self, position: Sequence[float], reach_m: float) -> tuple[Plane, ...]:
        high = GRAIN.at(position)
        return tuple([
            plane._replace(offset_m=plane.offset_m - high, effects=None) for plane in super().planes(position, reach_m)
        ])  # fmt: skip


def rough() -> RigidScene:
    """A plane with the grain."""
    return RigidScene("grain", 3, [Solid(HalfSpace((1.0, 0.0, 0.0), FACE_M), effects=Effects(grain=GRAIN))])


def late() -> RigidScene:
    """The same, with the grain at the world's rate."""
    scene = rough()
    scene.contacts = AtWorldsRate(scene.contacts.solids, 3)
    return scene


def pushes(scene: str) -> tuple[Array, str]:
    """The normal force at each tick while the hand slides [N], and the verdict."""
    result = simulate(
        {"scene": f"{__spec__.name}:{scene}", "operator": f"{__spec__.name}:Hand",
         "duration_s": BEGIN_S + WINDOW_S + 0.1, "record_hz": 1000.0,
         "device.stiffness": K, "link.up": "4g", "link.down": "4g"},
        seed=1,
    )  # fmt: skip
    device = result.recording.device
    assert device is not None
    begin = int(np.searchsorted(device["time_s"], BEGIN_S))
    force = -device["force_N"][begin : begin + round(1e3 * WINDOW_S), 0]
    return force, "passive" if result.summary["verdict"]["passive"] else "not passive"


def main() -> None:
    figure = canvas(180.0, 80.0)
    figure.suptitle("A hand slides over a grain at 50 mm/s, over 4g", fontsize=9.5, fontweight="bold")
    time, spectrum = figure.subplots(1, 2)
    for scene, label, color in (
        ("late", "by the world, at its steps", WORLD_COLOR),
        ("rough", "by the device, at 1 kHz", DEVICE_COLOR),
    ):
        force, verdict = pushes(scene)
        count = round(1e3 * SHOWN_S)
        time.plot(np.arange(count), force[:count], color=color, label=f"{label} ({verdict})")
        wave = 2e3 * np.abs(np.fft.rfft(force - force.mean())) / len(force)
        spectrum.plot(np.fft.rfftfreq(len(force), 1e-3), wave, color=color)
    asked = [(SPEED_MPS / LENGTH_M * n, 1e3 * FELT * high) for n, high in WAVES.items()]
    spectrum.plot(*zip(*asked, strict=True), "o", color="black", markerfacecolor="none", label="asked")
    time.set(xlabel="time [ms]", ylabel="normal force at the device [N]")
    spectrum.set(xlabel="frequency [Hz]", ylabel="amplitude [mN]", xlim=(0.0, 350.0))
    spectrum.set_ylim(bottom=0.0)
    figure.legend(loc="outside lower center", ncols=3)
    saved(figure, "grain.png")


if __name__ == "__main__":
    main()
