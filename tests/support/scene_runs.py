"""Whole runs in front of rigid scenes over bad links, with the accounts that theory.md owes, from its equations."""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hapnet.checks import Vector
from hapnet.ext.solids.rigid_contacts import RigidContacts
from hapnet.mechanics.contacts import Step, Surroundings
from hapnet.params import Params
from hapnet.plant.operator import Impedance, minimum_jerk
from hapnet.plant.worlds.scene import Scene
from hapnet.plant.worlds.walls import Wall
from hapnet.simulation.simulation import Simulation
from tests.support.solids import Account, torus, write_stl

BAD_LINKS = {
    "jitter and loss": "delay 40ms 10ms loss 2%",
    "bursts": "delay 60ms 20ms distribution normal loss gemodel 1% 20%",
    "much loss": "delay 20ms loss 20%",
    "reordering": "delay 30ms 15ms reorder 25% loss 5%",
}
STEPS_S = {"1 ms": (0.001, 0.001), "10 to 50 ms": (0.010, 0.050), "100 ms": (0.100, 0.100)}

SCENES = {
    "plane": "plane?normal=1,0.3,-0.1",
    "sphere": "sphere",
    "cuboid": "cuboid",
    "cylinder": "cylinder",
    "relief": "plane?relief=0.9mm,4mm",
    "rough sphere": "sphere?relief=0.6mm,3mm",
    "heights": "heights:{}/ripple.csv?unit=mm&spacing=0.5mm",
    "mesh": "mesh:{}/torus.stl?unit=mm",
    "texture": "cylinder?texture=1,3mm",
    "several": "sphere + plane?normal=0,0,-1&at=0,0,-3mm + cuboid?at=50mm,20mm,0mm",
    "wedge": "plane?normal=1,0.8,0&at=20mm,0mm,0mm + plane?normal=1,-0.8,0.3&at=20mm,0mm,0mm",
    "walls": "tests.support.scene_runs:wedge",
}
"""Words of scenes, with a place for the files' directory."""


def words(name: str, files: Path, friction: float = 0.0) -> str:
    parts = SCENES[name].format(files).split(" + ")
    if friction:
        parts = [f"{part}{'&' if '?' in part else '?'}friction={friction:g}" for part in parts]
    return " + ".join(parts)


def write_files(directory: Path) -> Path:
    """The files of the scenes: a torus of 10,000 triangles, and a ripple of 0.3 mm with a wavelength of 4 mm."""
    write_stl(directory / "torus.stl", *torus())
    across = 2.0 * math.pi * 0.5 * np.arange(81) / 4.0
    heights = 0.1 * (1.0 + np.sin(across)[:, None] + np.sin(across)[None, :])
    np.savetxt(directory / "ripple.csv", heights, delimiter=",", fmt="%.6f")
    return directory


def wedge(*, dof: int = 3, step_min_s: float = 0.01, step_max_s: float = 0.05) -> Scene:
    """Flat walls that act on one another."""
    normals = ((1.0, 0.8, 0.0), (1.0, -0.8, 0.3))
    walls = tuple([Wall(n, 0.02 / math.hypot(*n), 3000.0, 10.0) for n in normals])
    return Scene("wedge", 3, walls, step_min_s, step_max_s)


class Stroke:
    """A hand that presses to 33 mm and moves across that, while solids begin at 20 mm; then it withdraws."""

    def __init__(self, *, dof: int, impedance: Impedance) -> None:
        self.impedance = impedance

    def reference(self, t: float) -> Vector:
        inside = minimum_jerk(t / 1.5) - minimum_jerk((t - 2.7) / 0.5)
        return (
            0.033 * inside,
            0.008 * inside * math.sin(4.0 * (t - 1.0)),
            0.008 * inside * math.sin(2.5 * (t - 1.0)),
        )


class Outcome(NamedTuple):
    balance_J: float  #: the greatest |(13)|
    env_slack_J: float
    last_force_N: float  #: after the hand has withdrawn
    depth_m: float  #: the greatest
    jump_95_N: float  #: the 95th percentile of the force's steps while it is touched
    scale: float  #: the least share of the true depth that the anchored energy allowed; 1: all
    slack_J: float  #: the least of both halves of the theorem
    touched: int  #: steps with contact


def run(
    scene: str, link: str, steps_s: tuple[float, float], seconds: float = 4.0, seed: int = 3, **more: object
) -> Outcome:
    """A simulated run with PSPM, a hand that strokes, and its accounts."""
    params = Params().set({
        "scene": scene, "operator": "tests.support.scene_runs:Stroke", "link.up": link, "link.down": link,
        "duration_s": seconds, "world.step_min_s": steps_s[0], "world.step_max_s": steps_s[1], "dof": 3, **more,
    })  # fmt: skip
    simulation = Simulation(params, seed, kernel=False)
    contacts, mass = simulation.setup.scene.contacts, simulation.world.mass
    M, B, K = (scale * np.eye(3) for scale in (0.02, 14.0, 500.0))
    account = Account(contacts, M, B, K)
    worst, minimum = 0.0, 1.0
    step = mass.step

    def witness(dt: float, ybar: Vector, surroundings: Surroundings) -> Step:
        """(13), from the state before and after."""
        nonlocal worst, minimum
        x0, v0 = np.array(mass.position), np.array(mass.velocity)
        done = step(dt, ybar, surroundings)
        x1, v1, y = np.array(mass.position), np.array(mass.velocity), np.array(ybar)
        vhat = 0.5 * (v0 + v1)
        gained = 0.5 * (v1 @ M @ v1 - v0 @ M @ v0 + (x1 - y) @ K @ (x1 - y) - (x0 - y) @ K @ (x0 - y))
        worst = max(worst, abs(dt * float(np.dot(done.force, vhat)) - float(gained + dt * vhat @ B @ vhat)))
        if isinstance(contacts, RigidContacts):
            minimum = min(minimum, contacts.scale)
        return done

    mass.step = witness  # type: ignore[method-assign]
    result = simulation.run()
    world = result.recording.world
    force = np.array(account.forces)
    touched = np.any(force[1:] != 0.0, axis=1) & np.any(force[:-1] != 0.0, axis=1)
    jumps = np.linalg.norm(np.diff(force, axis=0), axis=1)[touched]
    slack = min(result.summary[side]["ledger"]["slack_J"] for side in ("device", "world"))
    return Outcome(
        max(worst, account.worst_J), min(account.least_slack_J, result.summary["environment"]["env_slack_J"]),
        float(np.linalg.norm(world["contact_force_N"][-1])), float(world["penetration_m"].max()),
        float(np.percentile(jumps, 95)) if len(jumps) else 0.0, minimum, slack, int(np.any(force != 0.0, axis=1).sum()),
    )  # fmt: skip
