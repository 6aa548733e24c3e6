"""MuJoCo as an engine: a model with a proxy in it, stepped by `mj_step2` and `mj_step1`, so that each substep ends with
all forces, contacts and energies of its end."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import isfinite
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hapnet import checks
from hapnet.checks import Array, Signal, Vector
from hapnet.errors import InvalidParameter
from hapnet.ext.engines.engine import Engine
from hapnet.ext.engines.engine_world import EngineWorld
from hapnet.ext.engines.mujoco_model import PREFIX, MujocoModel, asked, load, warnings
from hapnet.ext.engines.mujoco_picture import ModelPicture
from hapnet.ext.engines.mujoco_planes import SpherePlanes
from hapnet.mechanics.plane import Plane
from hapnet.plant.worlds.scene import STEP_MAX_S, STEP_MIN_S, checked_dof
from hapnet.records.vectors import inner

_MOST_J = 1e15
"""A model with more energy than this has diverged [J]."""

_LONGEST_PROOF_S = 60.0
"""The most time for which a diverged model is simulated again without the hand [s]."""

_SMALLEST_MASS = 0.02
"""The mass of the sphere until the parameter is set [kg]."""


FIRST_WORDS = ()
"""The first words of texts that describe such a world: none, as a model has a prefix."""


def builder(text: str) -> Callable[..., EngineWorld] | None:
    """A function that makes the world of the model that `text` names; None: the text names no model."""
    return partial(mujoco_world, text) if text.startswith(PREFIX) else None


def mujoco_world(
    scene: str, /, *, dof: int = 3, step_min_s: float = STEP_MIN_S, step_max_s: float = STEP_MAX_S
) -> EngineWorld:
    """The world of the model that `scene` names, see `hapnet.ext.engines.mujoco_model`.

    dof : axes of the hand, the model's first ones. step_min_s, step_max_s : range of the step time T_k [s].

    Raises InvalidParameter.
    """
    world = EngineWorld(MujocoEngine(scene, checked_dof(dof)), name=scene, min_s=step_min_s, max_s=step_max_s)
    world.name = "mujoco"
    return world


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


class MujocoEngine(Engine):
    """The running model that `scene` names; `dof` of its axes are the hand's. Methods are those of `Engine`."""

    def __init__(self, scene: str, dof: int) -> None:
        self.dof: int = dof
        self.found: MujocoModel = self._load(scene, _SMALLEST_MASS)
        found = self.found
        self.substep_s = self._substep_s = float(found.model.opt.timestep)
        self.warnings = tuple(warnings(found))
        self.overlaps = len(found.overlaps)
        self._engine, self._model, self._data = found.engine, found.model, found.data
        self._signature = found.engine.mjtState.mjSTATE_FULLPHYSICS
        self._saved = np.empty(found.engine.mj_stateSize(found.model, self._signature))
        self._dofs = list(found.dofs)
        self._slides = _Slides.of(found, dof)
        self._has_motors = bool(found.model.nu)
        self._first_geom = int(found.model.body_geomadr[found.body])
        self._geoms = int(found.model.body_geomnum[found.body])
        self._jacobian = np.zeros((3, found.model.nv))
        rk4 = found.model.opt.integrator == found.engine.mjtIntegrator.mjINT_RK4
        if rk4:  # then mj_step2 integrates by Euler's method: see the warning
            found.model.opt.integrator = found.engine.mjtIntegrator.mjINT_EULER
        self._origin = (0.0,) * dof
        self._weigh()
        self._origin = self.position()
        reported, self._planes = asked(scene).planes, None
        if found.dofs and not found.model.nflex and reported != "none":
            planes = self._planes_of(found, reported == "all")
            self._planes = planes if planes.any_fits else None

    def _load(self, scene: str, mass: float) -> MujocoModel:
        return load(scene, self.dof, mass)

    def _planes_of(self, found: MujocoModel, everything: bool) -> SpherePlanes:
        return SpherePlanes(found, self.dof, everything=everything)

    def weigh(self, mass: ArrayLike) -> None:
        """Set the `mass` of an added sphere [kg]; a body of the model keeps its own. Raises InvalidParameter."""
        if not self._dofs:
            return
        kg = float(checks.vector("mass", mass, 1)[0]) if np.size(mass) == 1 else 0.0
        if not kg > 0.0:
            raise InvalidParameter("mass", mass, "one positive number [kg] in a MuJoCo scene")
        model = self._model
        share = kg / float(model.body_mass[self.found.body])
        model.body_mass[self.found.body] *= share
        model.body_inertia[self.found.body] *= share
        self._engine.mj_setConst(model, self._engine.MjData(model))  # mj_setConst changes the data passed to it
        self._weigh()

    def _weigh(self) -> None:
        """Update the values that depend on the model's masses."""
        weights = np.outer(self._model.body_mass * self._model.body_gravcomp, self._model.opt.gravity)
        self._weights = [(body, *weights[body].tolist()) for body in np.flatnonzero(weights.any(axis=1)).tolist()]
        self._engine.mj_forward(self._model, self._data)

    # -- state -------------------------------------------------------------------------------------------------------

    def energy_J(self) -> tuple[float, float]:
        """Kinetic and potential energy [J]; a weight that the model compensates has no potential here."""
        data = self._data
        potential, kinetic = data.energy.tolist()
        for body, *weight in self._weights:
            potential += inner(weight, data.xipos[body].tolist())
        return kinetic, potential

    def position(self) -> Vector:
        """The proxy's displacement from its start [m]."""
        data, found = self._data, self.found
        if self._dofs:
            return tuple(self._slides.position.tolist())
        place = data.site_xpos[found.site] if found.site >= 0 else data.xipos[found.body]
        return tuple([x - at for x, at in zip(place.tolist(), self._origin, strict=False)])  # the first axes

    def velocity(self) -> Vector:
        """The proxy's velocity [m/s]."""
        if self._dofs:
            return tuple(self._slides.velocity.tolist())
        return tuple((self._rows() @ self._data.qvel).tolist())

    def inverse_mass(self) -> float | Array:
        """The proxy's inverse mass without contacts (n, n) [1/kg]."""
        if self._dofs:
            return 1.0 / float(self._model.body_mass[self.found.body])
        rows = np.array(self._rows())
        solved = np.zeros_like(rows)
        self._engine.mj_solveM(self._model, self._data, solved, rows)
        return rows @ solved.T

    def contact_force(self) -> Vector | None:
        """The force of all contacts on an added sphere [N]."""
        return tuple(self._slides.contact.tolist()) if self._dofs else None

    def depth(self) -> float:
        """The proxy's greatest depth in the bodies that it touches [m]."""
        contacts, count = self._data.contact, self._data.ncon
        if not count:
            return 0.0
        # as unsigned numbers, those below the first geom are large
        own = ((contacts.geom[:count] - self._first_geom).view(np.uint32) < self._geoms).nonzero()[0].tolist()
        return max(0.0, -min([float(contacts.dist[i]) for i in own])) if own else 0.0

    def place(self, position: Vector) -> bool:
        """Put an added sphere at rest at `position` [m]; returns whether it is free. A body of the model stays."""
        if not self._dofs:
            return position == self.position()
        self._slides.position[:], self._slides.velocity[:] = position, 0.0
        self._engine.mj_forward(self._model, self._data)
        return self.depth() == 0.0

    def signal(self, name: str, value: Signal) -> None:
        """Set the commands of all actuators (`name` is ``ctrl``), or of one (``ctrl.NAME``); others are ignored."""
        given = value if isinstance(value, tuple) else (value,)
        if not all(isinstance(one, int | float) and isfinite(one) for one in given):
            return
        head, _, actuator = name.partition(".")
        if name == "ctrl" and len(given) == self._model.nu:
            self._data.ctrl[:] = given
        elif head == "ctrl" and len(given) == 1:
            which = self._engine.mj_name2id(self._model, self._engine.mjtObj.mjOBJ_ACTUATOR, actuator)
            if which >= 0:
                self._data.ctrl[which] = given[0]

    def planes(self, position: Vector, reach_m: float) -> tuple[Plane, ...] | None:
        """The planes around an added sphere. None: it touches a body that no plane describes, or there is a flex, or
        the hand holds a body of the model, with its weight and joints.
        """
        return None if self._planes is None else self._planes.around(position, reach_m)

    def picture(self) -> ModelPicture:
        return ModelPicture(self.found, self.position())

    # -- steps -------------------------------------------------------------------------------------------------------

    def save(self) -> Array:
        self._engine.mj_getState(self._model, self._data, self._saved, self._signature)
        return self._saved

    def restore(self, state: Array) -> None:
        self._engine.mj_setState(self._model, self._data, state, self._signature)
        self._engine.mj_step1(self._model, self._data)

    def slow(self, factor: float) -> None:
        self._data.qvel[:] *= factor
        self._engine.mj_step1(self._model, self._data)

    def substep(self, dt: float, force: Vector) -> float:
        if dt != self._substep_s:
            before, self._substep_s = self._substep_s, dt
            self._model.opt.timestep = dt
            if dt > 1.5 * before:  # contacts may not be stiffer than their step allows: recompute them
                self._engine.mj_step1(self._model, self._data)
        data = self._data
        self._apply(force)
        self._engine.mj_step2(self._model, data)
        # the new velocity moves the actuators
        supplied = dt * float(data.qfrc_actuator @ data.qvel) if self._has_motors else 0.0
        self._engine.mj_step1(self._model, data)
        return supplied

    def _apply(self, force: Vector) -> None:
        data = self._data
        if self._dofs:
            self._slides.push[:] = force
            return
        found = self.found
        push = np.zeros(3)
        push[: self.dof] = force
        data.xfrc_applied[found.body, :3] = push
        if found.site >= 0:
            data.xfrc_applied[found.body, 3:] = np.cross(data.site_xpos[found.site] - data.xipos[found.body], push)

    def diagnosis(self) -> str:
        """Report whether the model diverges without the hand too, from its start and with its own timestep."""
        engine, model, data = self._engine, self._model, self._engine.MjData(self._model)
        model.opt.timestep = self.substep_s
        for geom in self.found.geoms if self._dofs else ():
            model.geom_contype[geom] = model.geom_conaffinity[geom] = 0
        if self.found.key >= 0:
            engine.mj_resetDataKeyframe(model, data, self.found.key)
        data.ctrl[:] = self._data.ctrl
        until_s = min(2.0 * self._data.time, _LONGEST_PROOF_S)
        while data.time < until_s:
            engine.mj_step(model, data)
            if not abs(data.energy[0] + data.energy[1]) < _MOST_J:
                return f"; the model diverges by itself, {data.time:.3g} s after its start, without the hand"
        return ""

    def _rows(self) -> Array:
        """The proxy's Jacobian (n, nv)."""
        engine, model, data, found = self._engine, self._model, self._data, self.found
        if found.site >= 0:
            engine.mj_jacSite(model, data, self._jacobian, None, found.site)
        else:
            engine.mj_jacBodyCom(model, data, self._jacobian, None, found.body)
        return self._jacobian[: self.dof]
