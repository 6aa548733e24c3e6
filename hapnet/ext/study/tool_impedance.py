"""The impedance of a tool that turns, over frequency: its handle is moved along an axis or turned about an axis.

The handle moves 10 mm beyond the place where the tool first touches the scene's first solid, and stays there; a free
tool stays at home. From there it is moved by 2 mm, or turned by the angle at which the ends of the pose's arms move by
2 mm.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from hapnet.assembly.build import Setup, prepare
from hapnet.checks import Array, Vector, one_of
from hapnet.errors import InvalidParameter
from hapnet.ext.study.impedance import IMPOSING, Way, approach, imposed_m, swing
from hapnet.ext.tools.contacts import ToolContacts
from hapnet.ext.tools.device import turned
from hapnet.ext.tools.scene import ToolScene
from hapnet.ext.tools.tool import place
from hapnet.mechanics.pose import ARM_M, arms, rotation, wrench
from hapnet.params import Params
from hapnet.recording.poses import of_point, of_turning
from hapnet.recording.samples import Recording

AXES = "xyz"
ALONG, ABOUT = "along-", "about-"
MOTIONS = (*(ALONG + axis for axis in AXES), *(ABOUT + axis for axis in AXES))
"""The motions by name."""

_SETTLES_S, _STEP_S = 20.0, 0.01
_BY = 1e-6
"""The shift of a pose for a difference quotient: metres, and radians times the arms' length."""


def motions(params: Params) -> tuple[str, str]:
    """The two motions of most interest: along the axis that leads into the first solid, and about the next axis."""
    solids = _scene(params).contacts.solids
    normal = solids[0].shape.near((0.0, 0.0, 0.0)).gradient if solids else (0.0, 0.0, 1.0)
    axis = int(np.argmax(np.abs(normal)))
    return ALONG + AXES[axis], ABOUT + AXES[(axis + 1) % 3]


def turns(motion: str) -> bool:
    """Whether this motion is a rotation, in rad and Nm."""
    return motion.startswith(ABOUT)


def path_of(setup: Setup, motion: str) -> Way:
    """The hand that makes this motion, and the true impedance there.

    Raises InvalidParameter: there is no such motion, or the scene is not a tool among solids.
    """
    one_of("motion", motion, MOTIONS)
    axis, scene = AXES.index(motion[-1]), _scene(setup.params)
    depth, amplitude = imposed_m(setup.params.device)
    home = _home(scene.contacts, depth)
    true = _truth(setup.params, scene, turned(home, (0.0, 0.0, 0.0)))
    row = 3 + axis if turns(motion) else axis
    return Way(
        _Hand(home, axis, turns(motion), amplitude),
        partial(_along, axis, turns(motion)),
        lambda hz: true(hz)[row],
    )


class _Hand:
    """A hand that moves to `home` (3,) [m], and from there along or about the axis; amplitude : at the arms [m]."""

    def __init__(self, home: Vector, axis: int, turns: bool, amplitude: float) -> None:
        self.impedance = IMPOSING
        self._home, self._axis, self._turns, self._amplitude = home, axis, turns, amplitude

    def reference(self, t: float) -> Vector:
        share, moved = approach(t), self._amplitude * swing(t)
        at, turn = [share * part for part in self._home], [0.0] * 3
        if self._turns:
            turn[self._axis] = moved / ARM_M
        else:
            at[self._axis] += moved
        return turned(tuple(at), tuple(turn))


def _along(axis: int, turns: bool, recording: Recording) -> tuple[Array, Array]:
    device = of_turning(recording) if turns else of_point(recording)
    assert device is not None
    assert device.device is not None, "a simulated run has both sides"
    return device.device["position_m"][:, axis], -device.device["force_N"][:, axis]


def _scene(params: Params) -> ToolScene:
    scene = prepare(params).scene
    if not isinstance(scene, ToolScene):
        raise InvalidParameter("scene", params.scene, "a tool among solids, whose true impedance is known")
    return scene


def _home(contacts: ToolContacts, depth: float) -> Vector:
    """Where the tool is moved (3,) [m]: `depth` into the first solid, on the shortest way from the start."""
    if not contacts.solids:
        return (0.0, 0.0, 0.0)
    shape = contacts.solids[0].shape
    distance, gradient = shape.near((0.0, 0.0, 0.0))
    path = -np.array(gradient) / np.linalg.norm(gradient)
    travelled = 0.0
    while travelled < distance:
        near = contacts.within(turned(tuple((travelled * path).tolist()), (0.0, 0.0, 0.0)), distance)
        if near and near[0][0] < _BY:
            break
        travelled += near[0][0] if near else distance
    return tuple(((min(travelled, distance) + depth) * path).tolist())


def _truth(params: Params, scene: ToolScene, x: Vector) -> Callable[[float], Array]:
    """The impedances (6,) at a frequency [Hz], of the device at x (12,) [m] along and about each axis, others held.

    The tool itself, a rigid body of the virtual mass and its inertia with its contacts, through the given springs
    without delay, damper and friction, for small motions about its rest position:

        Z = A - B (G + j w C - w^2 M)^-1 H

    with the derivatives of the device's wrench by its own pose and the tool's (A, B), and of the tool's wrench by both
    poses (H, G).
    """
    K, K_world = (np.broadcast_to(side.stiffness, 12) for side in (params.device, params.world))
    mass = scene.proxy(params.world.mass, params.world.damping, params.world.stiffness)
    for _ in range(round(_SETTLES_S / _STEP_S)):
        mass.step(_STEP_S, x, scene.contacts)
    y, body = mass.position, mass.body
    R = rotation(y)
    M = np.zeros((6, 6))
    M[:3, :3], M[3:, 3:] = body.mass * np.eye(3), R @ np.diag(list(body.inertia)) @ R.T
    A = -_rates(lambda x: _pulled(K, x, y), x)
    B = -_rates(lambda y: _pulled(K, x, y), y)
    H = _rates(lambda x: _pulled(K_world, y, x), x)
    G = -_rates(lambda y: _pulled(K_world, y, x) + _contact(scene.contacts, y)[0], y)
    C = _contact(scene.contacts, y)[1]

    def impedances(frequency_hz: float) -> Array:
        s = 2j * np.pi * frequency_hz
        found: Array = np.diag(A + B @ np.linalg.solve(G + s * C + s * s * M, H))
        return found

    return impedances


def _pulled(K: Array, x: Vector, y: Vector) -> Array:
    """The wrench (6,) of the spring K (12,) on a body at x (12,) whose other end is at y (12,)."""
    return np.concatenate(wrench(x, tuple((K * np.subtract(y, x)).tolist())))


def _contact(contacts: ToolContacts, y: Vector) -> tuple[Array, Array]:
    """The wrench (6,) of the solids on the tool at rest at y (12,), and the damping (6, 6) of its contacts."""
    found, damping = np.zeros(6), np.zeros((6, 6))
    for distance, point, normal, solid in contacts.within(y, 0.0):
        lever = np.subtract(place(y, point, contacts.arm_m), y[:3])
        along = np.concatenate([normal, np.cross(lever, normal)])
        found += solid.stiffness * distance * along
        damping += solid.damping * np.outer(along, along)
    return found, damping


def _rates(wrench_at: Callable[[Vector], Array], x: Vector) -> Array:
    """The derivative (6, 6) of a wrench by the translation and rotation of a body at x (12,) [m]."""
    columns = []
    for i in range(6):
        by = np.zeros(12)
        if i < 3:
            by[i] = _BY
        else:
            by[3:] = np.cross(_BY / ARM_M * np.eye(3)[i - 3], arms(x)).ravel()
        step = _BY if i < 3 else _BY / ARM_M
        columns.append((wrench_at(tuple(x + by)) - wrench_at(tuple(x - by))) / (2.0 * step))
    return np.stack(columns, axis=1)
