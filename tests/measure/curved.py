"""A device that slides over a ball through a bad link: the force that it gets beside the ball's own.

``python -m tests.measure curved`` prints the table of hapnet/ext/solids/rigid.md.
"""

from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np

from hapnet import ForceWorld, Obstacle, Plane
from hapnet.assembly.scenes import for_its_scene
from hapnet.checks import Vector
from hapnet.params import Params
from hapnet.plant.operator import Impedance
from hapnet.simulation.simulation import Simulation

CENTRE, RADIUS, K, K_WORLD, K_WALL = np.array((0.05, 0.0, 0.0)), 0.03, 100.0, 500.0, 3000.0
DEEP_M, SWING_RAD = 0.01, 0.6
LINK = "delay 40ms"


def own_ball(*, dof: int = 3, reports: bool = True) -> ForceWorld:
    """The ball as a force law of one's own, without damping."""
    centre = tuple(CENTRE[:dof].tolist())

    def push(position: Vector, velocity: Vector, time: float) -> Vector:
        away = np.array(position) - centre
        distance = float(np.linalg.norm(away))
        return tuple((K_WALL * max(0.0, RADIUS - distance) / distance * away).tolist())

    def planes(position: Vector, time: float) -> list[Plane]:
        return [Plane.of_ball(position, centre, RADIUS, K_WALL)]

    return ForceWorld([Obstacle(push, planes=planes if reports else None)], dof=dof, name="ball")


def untold(*, dof: int = 3) -> ForceWorld:
    return own_ball(dof=dof, reports=False)


class Slide:
    """A stiff hand: it goes 10 mm deep in half a second, and from then to and fro around the ball."""

    speed_mps = 0.05

    def __init__(self, dof: int, impedance: Impedance) -> None:
        self.impedance, self._dof = Impedance(0.5, 60.0, 3000.0), dof

    def reference(self, t: float) -> Vector:
        within = min(1.0, t / 0.5)
        within = within * within * (3.0 - 2.0 * within)
        radius = RADIUS + 0.02 - (0.02 + DEEP_M) * within
        swing = max(0.0, t - 0.7) * self.speed_mps / ((RADIUS - DEEP_M) * SWING_RAD)
        angle = SWING_RAD * np.sin(swing)
        place = CENTRE + radius * np.array((-np.cos(angle), np.sin(angle), 0.0))
        return tuple(place[: self._dof].tolist())


def error_N(
    speed_mps: float, steps_s: tuple[float, float], *, flat: bool = False, dof: int = 3, seconds: float = 3.0,
    scene: str = "sphere", watch: Callable[[Simulation], None] | None = None, **more: object,
) -> tuple[float, float]:  # fmt: skip
    """The root mean square of the force's difference from the ball's own, felt without delay, and of that force [N]."""
    import_module("tests.measure.curved").Slide.speed_mps = speed_mps  # of the module that the run imports
    given = {
        "device.stiffness": K,
        "scene": scene, "dof": dof, "operator": "tests.measure.curved:Slide", "link.up": LINK, "link.down": LINK,
        "duration_s": seconds, "record_hz": 1000.0, "world.step_min_s": steps_s[0], "world.step_max_s": steps_s[1],
        **more,
    }  # fmt: skip
    params = for_its_scene(Params().set(given))
    run = Simulation(params, 1, kernel=False)
    if flat:
        contacts: Any = run.world.scene.contacts
        report = contacts.planes
        contacts.planes = lambda x, reach: tuple(plane._replace(curvatures=()) for plane in report(x, reach))
    if watch is not None:
        watch(run)
    result = run.run()
    assert result.summary["verdict"]["passive"]
    device = result.recording.device
    sliding = slice(1500, round(seconds * 1000) - 100)
    x = device["position_m"][sliding]
    spring = device["force_N"][sliding] + params.device.damping * np.gradient(x, 1e-3, axis=0)
    away = x - CENTRE[:dof]
    distance = np.linalg.norm(away, axis=1, keepdims=True)
    own = K * K_WALL / (K_WORLD + K_WALL) * np.maximum(0.0, RADIUS - distance) * away / distance
    return tuple(float(np.sqrt(np.mean(np.sum(f * f, axis=1)))) for f in (spring - own, own))  # type: ignore[return-value]


def main() -> None:
    print("| peak speed | steps [ms] | flat planes | with curvature | of |")
    print("|---|---|---|---|---|")
    for speed in (0.02, 0.05, 0.1):
        for steps in ((0.001, 0.001), (0.01, 0.05)):
            (flat, own), (bent, _) = (error_N(speed, steps, flat=flat) for flat in (True, False))
            print(
                f"| {1e3 * speed:.0f} mm/s | {1e3 * steps[0]:.0f} to {1e3 * steps[1]:.0f} | {flat:.4f} N, "
                f"{100 * flat / own:.1f} % | {bent:.4f} N, {100 * bent / own:.2f} % | {own:.2f} N |"
            )
