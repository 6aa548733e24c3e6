"""Planes beside none in a MuJoCo scene over a bad link: error and ripple of the force.

``python -m tests.measure mujoco_rendering`` prints the table of hapnet/plant/worlds/README.md.
"""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from hapnet.params import Params
from hapnet.simulation.simulation import Result, Simulation

LINK = "delay 40ms 10ms loss 2%"
SMOOTH = 'condim="1" priority="1"'
FACE_M, DEEP_N_M = 0.015, 1000.0
"""The block's face, for the centre of a sphere of 5 mm, and a default contact's stiffness with a sphere of 20 g."""

GEOMS = {
    "block": f'<geom type="box" pos=".07 0 .1" size=".05 .2 .05" {SMOOTH}/>',
    "block that rubs": '<geom type="box" pos=".07 0 .1" size=".05 .2 .05"/>',
    "ball": f'<geom type="sphere" pos=".05 0 .1" size=".03" {SMOOTH}/>',
}


class Rendering(NamedTuple):
    """Root mean squares [N]: of the error of the force along the normal, of that force, of its changes within 50 ms."""

    error: float
    own: float
    ripple: float
    result: Result


def scene(folder: Path, geom: str) -> str:
    path = folder / "feel.xml"
    path.write_text(f'<mujoco><option timestep="0.002"/><worldbody>{geom}</worldbody></mujoco>')
    return f"mujoco:{path}?at=0,0,0.1"


def felt(name: str, planes: str, *, round_: bool = False, operator: str = "press", seed: int = 1) -> Rendering:
    """A hand on one of `GEOMS`; `round_`: the surface is a ball of 35 mm for the sphere's centre."""
    with TemporaryDirectory() as folder:
        params = Params().set({
            "scene": f"{scene(Path(folder), GEOMS[name])}&planes={planes}", "dof": 3, "operator": operator,
            "link.up": LINK, "link.down": LINK, "duration_s": 3.0, "record_hz": 1000.0,
            "world.step_min_s": 0.01, "world.step_max_s": 0.03, "device.stiffness": 100.0,
        })  # fmt: skip
        result = Simulation(params, seed).run()
    device = result.recording.device
    x, force = device["position_m"], device["force_N"]
    spring = force + params.device.damping * np.gradient(x, 1e-3, axis=0)
    away = x - np.array((0.05, 0.0, 0.0))
    distance = np.linalg.norm(away, axis=1)
    depth = 0.035 - distance if round_ else x[:, 0] - FACE_M
    out = away / distance[:, None] if round_ else np.tile((-1.0, 0.0, 0.0), (len(x), 1))
    K, K_world = params.device.stiffness, params.world.stiffness
    own = K * DEEP_N_M / (K_world + DEEP_N_M) * np.maximum(0.0, depth)
    error = np.sum(spring * out, axis=1) - own
    touched = own > 0.05
    smooth = np.convolve(np.sum(spring * out, axis=1), np.full(50, 0.02), "same")
    ripple = (np.sum(spring * out, axis=1) - smooth)[100:-100]
    return Rendering(*(float(np.sqrt(np.mean(part**2))) for part in (error[touched], own[touched], ripple)), result)  # type: ignore[misc]


def main() -> None:
    print("| | error, none | error, planes | of | ripple, none | ripple, planes |")
    print("|---|---|---|---|---|---|")
    for name, operator, words in (
        ("block", "press", "a block without friction, pressed"),
        ("block that rubs", "press", "a block with friction 1, pressed (`planes=all`)"),
        ("block", "tests.measure.curved:Slide", "a block without friction, slid over at 50 mm/s"),
        ("ball", "tests.measure.curved:Slide", "a ball without friction, slid over at 50 mm/s"),
    ):
        without, reported = (felt(name, planes, round_=name == "ball", operator=operator) for planes in ("none", "all"))
        print(
            f"| {words} | {without.error:.3f} N | {reported.error:.3f} N | {reported.own:.2f} N "
            f"| {1e3 * without.ripple:.1f} mN | {1e3 * reported.ripple:.1f} mN |"
        )
