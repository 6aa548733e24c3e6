"""A hand's proxy in a running MuJoCo model: the added sphere on its slide joints, or a body or site of the model."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hapnet import checks
from hapnet.checks import Array, Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.engines.mujoco_model import MujocoModel


class _Slides(NamedTuple):
    """Views of the engine's arrays for the slide joints on which an added sphere moves."""

    position: Array
    velocity: Array
    contact: Array
    push: Array

    @classmethod
    def of(cls, found: MujocoModel, dof: int) -> _Slides:
        """The views of `dof` joints, the model's joints that the hand leads."""
        model, data = found.model, found.data
        first = found.dofs[0] if found.dofs else 0
        place = int(model.jnt_qposadr[model.dof_jntid[first]]) if found.dofs else 0
        joints = slice(first, first + dof)
        return cls(
            data.qpos[place : place + dof], data.qvel[joints], data.qfrc_constraint[joints], data.qfrc_applied[joints]
        )


class MujocoProxy:
    """The proxy of `found`; `dof` axes of the model are the hand's. Methods are those of `Engine` for this proxy."""

    def __init__(self, found: MujocoModel, dof: int) -> None:
        self.found: MujocoModel = found
        self.dof: int = dof
        self.is_sphere: bool = bool(found.dofs)
        self._engine, self._model, self._data = found.engine, found.model, found.data
        self._slides = _Slides.of(found, dof)
        self._first_geom = int(found.model.body_geomadr[found.body])
        self._geoms = int(found.model.body_geomnum[found.body])
        self._jacobian = np.zeros((3, found.model.nv))
        self._origin: Vector = (0.0,) * dof
        self._origin = self.position()

    def weigh(self, mass: ArrayLike) -> None:
        """Set the `mass` of an added sphere [kg]; a body of the model keeps its own. Raises InvalidParameter."""
        if not self.is_sphere:
            return
        kg = float(checks.vector("mass", mass, 1)[0]) if np.size(mass) == 1 else 0.0
        if not kg > 0.0:
            raise InvalidParameter("mass", mass, "one positive number [kg] in a MuJoCo scene")
        model = self._model
        share = kg / float(model.body_mass[self.found.body])
        model.body_mass[self.found.body] *= share
        model.body_inertia[self.found.body] *= share
        self._engine.mj_setConst(model, self._engine.MjData(model))  # mj_setConst changes the data passed to it

    def position(self) -> Vector:
        """Its displacement from its start [m]."""
        data, found = self._data, self.found
        if self.is_sphere:
            return tuple(self._slides.position.tolist())
        place = data.site_xpos[found.site] if found.site >= 0 else data.xipos[found.body]
        return tuple([x - at for x, at in zip(place.tolist(), self._origin, strict=False)])  # the first axes

    def velocity(self) -> Vector:
        if self.is_sphere:
            return tuple(self._slides.velocity.tolist())
        return tuple((self.rows() @ self._data.qvel).tolist())

    def inverse_mass(self) -> float | Array:
        """Its inverse mass without contacts (n, n) [1/kg]."""
        if self.is_sphere:
            return 1.0 / float(self._model.body_mass[self.found.body])
        return lightness([self])

    def contact_force(self) -> Vector | None:
        """The force of all contacts on an added sphere [N]."""
        return tuple(self._slides.contact.tolist()) if self.is_sphere else None

    def depth(self) -> float:
        """Its greatest depth in the bodies that it touches [m]."""
        contacts, count = self._data.contact, self._data.ncon
        if not count:
            return 0.0
        # as unsigned numbers, those below the first geom are large
        own = ((contacts.geom[:count] - self._first_geom).view(np.uint32) < self._geoms).nonzero()[0].tolist()
        return max(0.0, -min([float(contacts.dist[i]) for i in own])) if own else 0.0

    def place(self, position: Vector) -> bool:
        """Put an added sphere at rest at `position` [m]; returns whether it is free. A body of the model stays."""
        if not self.is_sphere:
            return position == self.position()
        self._slides.position[:], self._slides.velocity[:] = position, 0.0
        self._engine.mj_forward(self._model, self._data)
        return self.depth() == 0.0

    def release(self) -> None:
        """Take the force off a body of the model, on which several hands may push."""
        if not self.is_sphere:
            self._data.xfrc_applied[self.found.body] = 0.0

    def push(self, force: Vector) -> None:
        """Let `force` (n,) [N] act on it, beside the forces that act on its body since `release`."""
        if self.is_sphere:
            self._slides.push[:] = force
            return
        data, found, push = self._data, self.found, np.zeros(3)
        push[: self.dof] = force
        data.xfrc_applied[found.body, :3] += push
        if found.site >= 0:
            data.xfrc_applied[found.body, 3:] += np.cross(data.site_xpos[found.site] - data.xipos[found.body], push)

    def rows(self) -> Array:
        """Its Jacobian (n, nv), valid until the next call."""
        engine, model, data, found = self._engine, self._model, self._data, self.found
        if self.is_sphere:
            self._jacobian[range(self.dof), found.dofs[: self.dof]] = 1.0
        elif found.site >= 0:
            engine.mj_jacSite(model, data, self._jacobian, None, found.site)
        else:
            engine.mj_jacBodyCom(model, data, self._jacobian, None, found.body)
        return self._jacobian[: self.dof]


def lightness(proxies: list[MujocoProxy]) -> Array:
    """The inverse mass of all these proxies of one model, without contacts (N n, N n) [1/kg]."""
    rows = np.concatenate([proxy.rows() for proxy in proxies])
    found, solved = proxies[0].found, np.zeros_like(rows)
    found.engine.mj_solveM(found.model, found.data, solved, rows)
    weights: Array = rows @ solved.T
    return weights
