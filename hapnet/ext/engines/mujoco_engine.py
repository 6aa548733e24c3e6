"""MuJoCo as an engine: a model with a proxy in it, stepped by `mj_step2` and `mj_step1`, so that each substep ends with
all forces, contacts and energies of its end."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike

from hapnet.checks import Array, Signal, Vector
from hapnet.ext.engines.engine import Engine
from hapnet.ext.engines.engine_world import EngineWorld
from hapnet.ext.engines.mujoco_model import PREFIX, HandProxy, MujocoModel, asked, held_first, load, warnings
from hapnet.ext.engines.mujoco_picture import ModelPicture
from hapnet.ext.engines.mujoco_planes import SpherePlanes
from hapnet.ext.engines.mujoco_proxy import MujocoProxy
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


class MujocoEngine(Engine):
    """The running model that `scene` names; `dof` of its axes are the hand's. Methods are those of `Engine`.

    held : the proxy of each hand; by default of one hand, as the scene names it. This engine has the first.

    Raises InvalidParameter.
    """

    def __init__(self, scene: str, dof: int, held: Sequence[HandProxy] = ()) -> None:
        self.dof: int = dof
        self.scene: str = scene
        all_found = self._load(scene, _SMALLEST_MASS, held or (held_first(scene),))
        self.found: MujocoModel = all_found[0]
        found = self.found
        self.substep_s = self._substep_s = float(found.model.opt.timestep)
        self.warnings = tuple(warnings(found))
        self.overlaps = len(found.overlaps)
        self._engine, self._model, self._data = found.engine, found.model, found.data
        self._signature = found.engine.mjtState.mjSTATE_FULLPHYSICS
        self._saved = np.empty(found.engine.mj_stateSize(found.model, self._signature))
        self._dofs = list(found.dofs)
        self._has_motors = bool(found.model.nu)
        self._first_geom = int(found.model.body_geomadr[found.body])
        rk4 = found.model.opt.integrator == found.engine.mjtIntegrator.mjINT_RK4
        if rk4:  # then mj_step2 integrates by Euler's method: see the warning
            found.model.opt.integrator = found.engine.mjtIntegrator.mjINT_EULER
        self._weigh()
        self.proxies: tuple[MujocoProxy, ...] = tuple([MujocoProxy(one, dof) for one in all_found])
        self._proxy = self.proxies[0]
        reported, self._planes = asked(scene).planes, None
        if found.dofs and not found.model.nflex and reported != "none":
            planes = self._planes_of(found, reported == "all")
            self._planes = planes if planes.any_fits else None

    def _load(self, scene: str, mass: float, held: Sequence[HandProxy]) -> tuple[MujocoModel, ...]:
        return load(scene, self.dof, mass, held)

    def _planes_of(self, found: MujocoModel, everything: bool) -> SpherePlanes:
        return SpherePlanes(found, self.dof, everything=everything)

    def weigh(self, mass: ArrayLike) -> None:
        """Set the `mass` of an added sphere [kg]; a body of the model keeps its own. Raises InvalidParameter."""
        if self._proxy.is_sphere:
            self._proxy.weigh(mass)
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
        return self._proxy.position()

    def velocity(self) -> Vector:
        """The proxy's velocity [m/s]."""
        return self._proxy.velocity()

    def inverse_mass(self) -> float | Array:
        """The proxy's inverse mass without contacts (n, n) [1/kg]."""
        return self._proxy.inverse_mass()

    def contact_force(self) -> Vector | None:
        """The force of all contacts on an added sphere [N]."""
        return self._proxy.contact_force()

    def depth(self) -> float:
        """The proxy's greatest depth in the bodies that it touches [m]."""
        return self._proxy.depth()

    def place(self, position: Vector) -> bool:
        """Put an added sphere at rest at `position` [m]; returns whether it is free. A body of the model stays."""
        return self._proxy.place(position)

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
        self._proxy.release()
        self._proxy.push(force)

    def diagnosis(self) -> str:
        """Report whether the model diverges without the hand too, from its start and with its own timestep."""
        engine, model, data = self._engine, self._model, self._engine.MjData(self._model)
        model.opt.timestep = self.substep_s
        for proxy in self.proxies:
            for geom in proxy.found.geoms if proxy.is_sphere else ():
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
