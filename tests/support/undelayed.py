"""What a scene would give a device without delay: its own world, in steps of 1 ms, along the way that was recorded.

A proxy of hardly any mass and damping hangs on the world's spring from the device's position x. Where it rests, at p,
the springs in series render K (p - x), as far as the actuator goes. Walls and solids rub, but have no damper.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hapnet.assembly.build import prepare
from hapnet.checks import Array
from hapnet.params import Params
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.poses.scene import ToolScene
from hapnet.recording.samples import Recording

STEP_S = 1e-3
LIGHT, OF_MODEL = (1e-4, 0.2), (0.02, 2.0)
"""Mass [kg] and damping [Ns/m] of the proxy; in a model its contacts depend on what it weighs."""


class Undelayed(NamedTuple):
    touching: Array  #: (N,) does the scene push the proxy?
    force_N: Array  #: (N, n) on the device


def undelayed(recording: Recording) -> Undelayed:
    """At each sample of the device."""
    given = recording.meta["params"]
    wall = {f"world.wall.{name}": value for name, value in given["world"]["wall"].items()}
    wall["world.wall.damping"] = 1e-6
    params = Params().set({"scene": given["scene"], "dof": given["dof"], **wall})
    scene = prepare(params, "continuous").scene
    device = recording.device
    assert device is not None
    t, x = device["time_s"], device["position_m"]
    times = np.arange(t[0], t[-1], STEP_S)
    way = np.stack([np.interp(times + STEP_S, t, one) for one in x.T], axis=1)
    stiffness = given["world"]["stiffness"]
    mass, damping = OF_MODEL if scene.moves_proxy and not isinstance(scene, ToolScene) else LIGHT
    proxy = scene.proxy(mass, damping, stiffness) or PassiveIntegrator(mass, damping, stiffness, scene.start)
    contacts = scene.contacts
    places, pushes = np.empty_like(way), np.empty(len(way))
    for k, goal in enumerate(way.tolist()):
        done = proxy.step(STEP_S, tuple(goal), contacts)
        places[k] = done.position
        push = (contacts.contact_force if scene.moves_proxy else None) or done.force
        pushes[k] = sum(f * f for f in push or ())
    at = np.clip(np.searchsorted(times, t - STEP_S), 0, len(times) - 1)
    touching = pushes[at] > 1e-12
    force = given["device"]["stiffness"] * np.where(touching[:, None], places[at] - way[at], 0.0)
    limit = given["device"]["force_limit_N"] * given["device"]["spring_share"] or np.inf
    size = np.linalg.norm(force, axis=1, keepdims=True)
    return Undelayed(touching, force * np.minimum(1.0, limit / np.maximum(size, 1e-9)))
