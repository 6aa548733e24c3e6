"""A rigid tool in a MuJoCo model: a free body, moved by the virtual coupling and by its contacts.

The engine integrates it. Its coordinates are those of a pose (`hapnet.mechanics.pose`), counted from where it begins,
and the coupling's force along them becomes force and torque at its centre. `hapnet.ext.engines.engine_account` charges
that force times the displacement of the coordinates, whatever the engine did.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from hapnet.checks import Array, Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.engines.engine_world import EngineWorld
from hapnet.ext.engines.mujoco_engine import MujocoEngine
from hapnet.ext.engines.mujoco_model import MOST_LIFTS, HandProxy, MujocoModel, add_free_body, asked, load, raised
from hapnet.ext.engines.mujoco_planes import NearGeom, SpherePlanes
from hapnet.ext.tools.contacts import different, rigid_plane
from hapnet.ext.tools.tool import Tool
from hapnet.mechanics.plane import Plane
from hapnet.mechanics.pose import ARM_M, AXES, DOF, coordinates, wrench
from hapnet.units import POSE

_MARGIN_M = 0.03
"""The contact margin of the tool: the engine lists contacts that are nearer than this [m]."""

_LIFT_M = 0.001

_STILL: Vector = (1.0, 0.0, 0.0, 0.0)


def mujoco_tool_world(text: str, scene: str, tool: Tool, min_s: float, max_s: float) -> EngineWorld:
    """The world `text`: `tool` in the model that `scene` names. Raises InvalidParameter."""
    return EngineWorld(MujocoToolEngine(scene, tool), name=text, min_s=min_s, max_s=max_s)


class MujocoToolEngine(MujocoEngine):
    """The model that `scene` names, with a tool in the hand. It begins upright at ``?at=``, or at a free place above.

    Raises InvalidParameter.
    """

    units: str = POSE

    def __init__(self, scene: str, tool: Tool) -> None:
        self._tool = tool
        self._home = np.zeros(3)
        super().__init__(scene, AXES)

    def _load(self, scene: str, mass: float, held: Sequence[HandProxy]) -> tuple[MujocoModel, ...]:
        (found,) = load(scene, DOF, mass, [HandProxy()], partial(_add_tool, self._tool, mass))
        self._place = int(found.model.jnt_qposadr[found.model.body_jntadr[found.body]])
        start = found.data.qpos[self._place : self._place + 7]
        start[:3], start[3:] = asked(scene).at or (0.0, 0.0, 0.0), _STILL

        def lift() -> None:
            start[2] += _LIFT_M

        tries = 1 if asked(scene).at else MOST_LIFTS
        if not raised(found.engine, found.model, found.data, found.body, lift, tries):
            raise InvalidParameter("scene", scene, "a model with room for the tool, or ?at=X,Y,Z [m] where it is free")
        self._home = np.array(start[:3])
        return (found,)

    def _planes_of(self, found: MujocoModel, everything: bool) -> SpherePlanes:
        return ToolPlanes(found, everything=everything)

    def position(self) -> Vector:
        at = self._data.qpos[self._place : self._place + 7]
        return coordinates((at[:3] - self._home).tolist(), at[3:].tolist())

    def velocity(self) -> Vector:
        first = self._dofs[0]
        moved = self._data.qvel[first : first + 3]
        spin = self._data.xmat[self.found.body].reshape(3, 3) @ self._data.qvel[first + 3 : first + 6]
        return (*moved.tolist(), *np.cross(spin, self._arms()).ravel().tolist())

    def inverse_mass(self) -> Array:
        """The inverse mass of a rigid body along the coordinates, from its six degrees of freedom."""
        body = self.found.body
        turn = self._data.ximat[body].reshape(3, 3)
        lightness = (turn / self._model.body_inertia[body]) @ turn.T
        crossed = [np.cross(np.eye(3), arm).T for arm in self._arms()]  # w -> w x P
        spread = np.concatenate(crossed)
        matrix = np.zeros((AXES, AXES))
        matrix[:3, :3] = np.eye(3) / self._model.body_mass[body]
        matrix[3:, 3:] = spread @ lightness @ spread.T
        return matrix

    def contact_force(self) -> Vector | None:
        """None: it is not known along the coordinates."""
        return None

    def depth(self) -> float:
        """The depth of the tool in the bodies that it touches [m]."""
        contacts, count = self._data.contact, self._data.ncon
        mine = (contacts.geom[:count] == self._first_geom).any(axis=1)
        return max(0.0, -float(contacts.dist[:count][mine].min())) if mine.any() else 0.0

    def place(self, position: Vector) -> bool:
        """Do nothing: the tool stays where it is."""
        return position == self.position()

    def _apply(self, force: Vector) -> None:
        push, torque = wrench(self.position(), force)
        self._data.xfrc_applied[self.found.body] = (*push, *torque)

    def _arms(self) -> Array:
        """The arms P_j, a row each [m]."""
        arms: Array = ARM_M * self._data.xmat[self.found.body].reshape(3, 3).T
        return arms


class ToolPlanes(SpherePlanes):
    """The planes of the engine's own contacts with the tool, touching or nearly."""

    def __init__(self, found: MujocoModel, *, everything: bool = False) -> None:
        super().__init__(found, AXES, everything=everything)

    def around(self, position: Vector, reach_m: float) -> tuple[Plane, ...] | None:
        """The deepest planes of different directions. None: the tool touches a body that no plane describes."""
        data, planes = self._found.data, list[tuple[float, Plane]]()
        centre = data.xpos[self._found.body]
        for i in range(data.ncon):
            contact = data.contact[i]
            if self._own not in contact.geom:
                continue
            first = int(contact.geom[0]) == self._own
            other = int(contact.geom[1 if first else 0])
            if other < 0 or not self._fits[other]:
                if contact.dist < 0.0:
                    return None
                continue
            if contact.dist > reach_m:
                continue
            n, point, distance = np.array(contact.frame[:3]), np.array(contact.pos), float(contact.dist)
            normal = n if first else -n
            near = NearGeom(other, normal, -distance, point, contact.solref, contact.solimp)
            r = point - 0.5 * distance * normal - centre  # the contact's point lies midway between the surfaces
            soft, speed = self._soft(near), self._speed(near)
            made = rigid_plane(position, ARM_M, r.tolist(), tuple(normal.tolist()), distance, *soft, speed)
            planes.append((distance, made))
        planes.sort(key=lambda one: one[0])
        return different(plane for _, plane in planes)


def _add_tool(tool: Tool, mass: float, engine: Any, spec: Any) -> None:
    kind, size = engine.mjtGeom.mjGEOM_BOX, [0.5 * length for length in tool.size]
    if tool.round:
        kind, size = engine.mjtGeom.mjGEOM_CYLINDER, [0.5 * tool.size[0], 0.5 * tool.size[2], 0.0]
    add_free_body(engine, spec, {"type": kind, "size": size, "mass": mass}, _MARGIN_M)
