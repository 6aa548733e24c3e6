"""What a scene would give a device without delay: its own world, in steps of 1 ms, along the way that was recorded.

A proxy of hardly any mass and damping hangs on the world's spring from the device's position x. Where it rests, at p,
the springs in series render K (p - x), as far as the actuator goes. Walls and solids rub, but have no damper.

A step of a soft body takes some 10 ms, however long it is. So its steps are of 5 ms, and only the windows are computed
that are asked for.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hapnet.assembly.build import prepare
from hapnet.assembly.scenes import for_its_scene
from hapnet.checks import Array
from hapnet.ext.tools.scene import ToolScene
from hapnet.params import Params
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.recording.samples import Recording

STEP_S, SOFT_STEP_S = 1e-3, 5e-3
LIGHT, OF_MODEL = (1e-4, 0.2), (0.02, 2.0)
"""Mass [kg] and damping [Ns/m] of the proxy; in a model its contacts depend on what it weighs."""

SETTLING_S = 2.0
"""So long before a window begins the proxy comes from its start to where the device was, and then follows it."""

WHOLE = ((0.0, np.inf),)


class Undelayed(NamedTuple):
    touching: Array  #: (N,) does the scene push the proxy?
    force_N: Array  #: (N, n) on the device
    known: Array  #: (N,) is the sample in one of the windows? Elsewhere the two above are false and 0


def undelayed(
    recording: Recording, windows: Sequence[tuple[float, float]] = WHOLE, soft_step_s: float = SOFT_STEP_S
) -> Undelayed:
    """At each sample of the device. windows : begins and ends [s]; used for soft bodies only."""
    given = recording.meta["params"]
    soft = given["scene"].startswith("soft")
    device = recording.device
    t, x = device["time_s"], device["position_m"]
    limit = given["device"]["force_limit_N"] * given["device"]["spring_share"] or np.inf
    touching, force, known = np.zeros(len(t), dtype=bool), np.zeros_like(x), np.zeros(len(t), dtype=bool)
    step_s = soft_step_s if soft else STEP_S
    for begin, end in windows if soft else WHOLE:
        times = np.arange(max(t[0], begin - SETTLING_S), min(t[-1], end), step_s)
        way = np.stack([np.interp(times + step_s, t, one) for one in x.T], axis=1)
        places, pushes = _follow(recording, way, step_s, comes=begin > t[0])
        here = np.flatnonzero((t >= begin) & (t <= end))
        at = np.clip(np.searchsorted(times, t[here] - step_s), 0, len(times) - 1)
        known[here], touching[here] = True, pushes[at] > 1e-12
        pull = given["device"]["stiffness"] * np.where(touching[here, None], places[at] - way[at], 0.0)
        size = np.linalg.norm(pull, axis=1, keepdims=True)
        force[here] = pull * np.minimum(1.0, limit / np.maximum(size, 1e-9))
    return Undelayed(touching, force, known)


def _follow(recording: Recording, way: Array, step_s: float, comes: bool) -> tuple[Array, Array]:
    """Where the proxy is when its spring's end follows `way` (N, n) [m], and the square of what pushes it (N,) [N^2].

    comes : does it come there from the scene's start, in half of `SETTLING_S`?
    """
    given = recording.meta["params"]
    wall = {f"world.wall.{name}": value for name, value in given["world"]["wall"].items()}
    wall["world.wall.damping"] = 1e-6
    scene = prepare(
        for_its_scene(Params().set({"scene": given["scene"], "dof": given["dof"], **wall})), "continuous"
    ).scene
    stiffness = given["world"]["stiffness"]
    mass, damping = OF_MODEL if scene.moves_proxy and not isinstance(scene, ToolScene) else LIGHT
    proxy = scene.proxy(mass, damping, stiffness) or PassiveIntegrator(mass, damping, stiffness, scene.start)
    contacts = scene.contacts
    if comes:
        for share in np.linspace(0.0, 1.0, round(0.5 * SETTLING_S / step_s)):
            proxy.step(step_s, tuple((share * way[0] + (1.0 - share) * np.array(scene.start)).tolist()), contacts)
    places, pushes = np.empty_like(way), np.empty(len(way))
    for k, goal in enumerate(way.tolist()):
        done = proxy.step(step_s, tuple(goal), contacts)
        places[k] = done.position
        push = (contacts.contact_force if scene.moves_proxy else None) or done.force
        pushes[k] = sum(f * f for f in push or ())
    return places, pushes
