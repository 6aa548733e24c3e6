"""MuJoCo's steps with the environment's account: what the engine is given, what it stores, what it must pay back.

An observer sums what goes into the engine: the exact work F . (x_{k+1} - x_k) of the coupling's force, and that
of the model's actuators, the S of `hapnet.plant.worlds.account`. With U the kinetic and potential energy

    account += F . (x_{k+1} - x_k) + S_{k+1} - S_k - (U_{k+1} - U_k)

is what contacts, dampers and friction have dissipated since. Below 0 the engine has made energy. The debt is paid at
once by damping: all velocities are scaled by sqrt(1 - debt/kinetic energy), which takes exactly the debt. Contacts
give back some of what is pressed into them, which U does not know, so the account keeps what was dissipated, up to a
ceiling.
"""

from __future__ import annotations

from math import isfinite, sqrt
from operator import sub

import numpy as np

from hapnet.checks import Array, Signal, Vector
from hapnet.errors import HapnetError
from hapnet.mechanics.contacts import Observed
from hapnet.plant.worlds.mujoco_model import Model
from hapnet.records.vectors import inner

CEILING_J = 0.05
"""The most that the account keeps of what was dissipated [J]: what contacts and flexes store is less."""

_MOST_J = 1e15
"""A model with more energy than this has failed [J]."""

_LONGEST_PROOF_S = 60.0
"""So much of a model that diverged is simulated again without the hand, at most [s]."""

_ROUNDING = 1e-14
"""A debt of this share of the energy [J] is rounding."""


class Engine:
    """The model while it runs.

    More than twenty attributes: the account, and what each substep would else ask of the model anew.

    found : the model. dof : how many axes the hand has: the first ones.
    """

    def __init__(self, found: Model, dof: int) -> None:
        self.found: Model = found
        self.dof: int = dof
        self.own_step_s: float = float(found.model.opt.timestep)
        self._substep_s = self.own_step_s
        self.supplied_J: float = 0.0
        self.given_J: float = 0.0
        self.paid_J: float = 0.0
        self.account_J: float = 0.0
        self.undone: int = 0
        self.undone_J: float = 0.0
        self._substeps, self._touch = 0, np.zeros(dof)
        self._engine, self._model, self._data = found.engine, found.model, found.data
        self._signature = found.engine.mjtState.mjSTATE_FULLPHYSICS
        self._saved = np.empty(found.engine.mj_stateSize(found.model, self._signature))
        self._dofs = list(found.dofs)
        # views of the engine's own arrays, of the slide joints
        place = int(found.model.jnt_qposadr[found.model.dof_jntid[found.dofs[0]]]) if found.dofs else 0
        first = found.dofs[0] if found.dofs else 0
        self._qpos, self._qvel = found.data.qpos[place : place + dof], found.data.qvel[first : first + dof]
        self._contact = found.data.qfrc_constraint[first : first + dof]
        self._push, self._energies = found.data.qfrc_applied[first : first + dof], found.data.energy
        self._has_motors = bool(found.model.nu)
        self._first_geom = int(found.model.body_geomadr[found.body])
        self._geoms = int(found.model.body_geomnum[found.body])
        self._jacobian = np.zeros((3, found.model.nv))
        rk4 = found.model.opt.integrator == found.engine.mjtIntegrator.mjINT_RK4
        if rk4:  # mj_step2 integrates by Euler's method then, as the warning says
            found.model.opt.integrator = found.engine.mjtIntegrator.mjINT_EULER
        self._origin = (0.0,) * dof
        self.weigh()
        self._origin = self.position()

    def weigh(self) -> None:
        """The model's masses were changed: find out anew what depends on them."""
        weights = np.outer(self._model.body_mass * self._model.body_gravcomp, self._model.opt.gravity)
        self._weights = [(body, *weights[body].tolist()) for body in np.flatnonzero(weights.any(axis=1)).tolist()]
        self._engine.mj_forward(self._model, self._data)
        self._energy_J = self.energy_J()

    # -- state -------------------------------------------------------------------------------------------------------

    @property
    def observed(self) -> Observed:
        return Observed(self.given_J, self.paid_J, self.undone, self.undone_J, len(self.found.overlaps))

    def energy_J(self) -> float:
        """U: kinetic and potential energy. Weight that the model compensates for has no potential."""
        data = self._data
        potential, kinetic = self._energies.tolist()
        for body, *weight in self._weights:
            potential += inner(weight, data.xipos[body].tolist())
        return float(potential + kinetic)

    def position(self) -> Vector:
        """Of the proxy, from where it began [m]."""
        data, found = self._data, self.found
        if self._dofs:
            return tuple(self._qpos.tolist())
        place = data.site_xpos[found.site] if found.site >= 0 else data.xipos[found.body]
        return tuple([x - at for x, at in zip(place.tolist(), self._origin, strict=False)])  # the first axes

    def velocity(self) -> Vector:
        """Of the proxy [m/s]."""
        if self._dofs:
            return tuple(self._qvel.tolist())
        return tuple((self._rows() @ self._data.qvel).tolist())

    def inverse_mass(self) -> Array:
        """How the proxy's velocity answers to an impulse [1/kg], without contacts: (n, n)."""
        if self._dofs:
            return np.eye(self.dof) / float(self._model.body_mass[self.found.body])
        rows = np.array(self._rows())
        solved = np.zeros_like(rows)
        self._engine.mj_solveM(self._model, self._data, solved, rows)
        return rows @ solved.T

    @property
    def contact_force(self) -> Vector:
        """Of all contacts on an added sphere, the mean over this step's substeps [N]."""
        return tuple((self._touch / max(1, self._substeps)).tolist())

    def depth(self) -> float:
        """How deep the proxy is in what it touches, where it is deepest [m]."""
        contacts, count = self._data.contact, self._data.ncon
        if not count:
            return 0.0
        # as unsigned numbers those below the first one are great
        own = ((contacts.geom[:count] - self._first_geom).view(np.uint32) < self._geoms).nonzero()[0].tolist()
        return max(0.0, -min([float(contacts.dist[i]) for i in own])) if own else 0.0

    def place(self, position: Vector) -> bool:
        """Put the added sphere at rest there [m]; returns whether it is free. A body of the model stays where it is."""
        if not self._dofs:
            return position == self.position()
        self._qpos[:], self._qvel[:] = position, 0.0
        self._engine.mj_forward(self._model, self._data)
        self._energy_J = self.energy_J()
        return self.depth() == 0.0

    def command(self, name: str, value: Signal) -> None:
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

    # -- steps -------------------------------------------------------------------------------------------------------

    def begin(self, length_s: float) -> None:
        """A step begins, whose substeps have this length [s]."""
        self._substeps = 0
        self._touch[:] = 0.0
        if length_s == self._substep_s:
            return
        before, self._substep_s = self._substep_s, length_s
        self._model.opt.timestep = length_s
        if length_s > 1.5 * before:  # contacts may not be stiffer than their step allows: look again
            self._engine.mj_step1(self._model, self._data)

    def substep(self, force: Vector, most_J: float) -> tuple[Vector, float]:
        """Advance with the coupling's `force` (n,) held [N], which may do `most_J` of work.

        Returns the force that was applied [N] and its work [J]. If that would be more, the substep is made again
        without force. If it makes a debt that nothing can pay, it is made again from rest and without force; if that
        does too, the world stands still. Substeps that were made again are counted in `undone`; `undone_J` is what
        stopping took out of the world [J].
        """
        self._engine.mj_getState(self._model, self._data, self._saved, self._signature)
        moved, supplied = self._advance(force)
        work = inner(force, moved)
        none = (0.0,) * self.dof
        if work > most_J:
            self._return(at_rest=False)
            force, work = none, 0.0
            _, supplied = self._advance(none)
        self._engine.mj_step1(self._model, self._data)
        self._substeps += 1
        if self._settle(work, supplied):
            self._touch += self._contact
            return force, work
        self._return(at_rest=True)
        _, supplied = self._advance(none)
        self._engine.mj_step1(self._model, self._data)
        if not self._settle(0.0, supplied):
            self._return(at_rest=True)
        return none, 0.0

    def _advance(self, force: Vector) -> tuple[Vector, float]:
        """One substep of the engine: the proxy's displacement [m], and the actuators' work [J]."""
        before, data = self.position(), self._data
        self._apply(force)
        self._engine.mj_step2(self._model, data)
        if not self._dofs:
            self._engine.mj_kinematics(self._model, data)
        moved = tuple(map(sub, self.position(), before))
        if not self._has_motors:
            return moved, 0.0
        return moved, self._substep_s * float(data.qfrc_actuator @ data.qvel)  # the new velocity moves it

    def _return(self, *, at_rest: bool) -> None:
        """Go back to before this substep; `at_rest`: what moved then is stopped, which goes into the account."""
        self.undone += 1
        self._engine.mj_setState(self._model, self._data, self._saved, self._signature)
        if at_rest:
            self._data.qvel[:] = 0.0
        self._engine.mj_step1(self._model, self._data)
        if at_rest:
            energy = self.energy_J()
            self.account_J += self._energy_J - energy
            self.paid_J += self._energy_J - energy
            self.undone_J += self._energy_J - energy
            self._energy_J = energy

    def _apply(self, force: Vector) -> None:
        data = self._data
        if self._dofs:
            self._push[:] = force
            return
        found = self.found
        push = np.zeros(3)
        push[: self.dof] = force
        data.xfrc_applied[found.body, :3] = push
        if found.site >= 0:
            data.xfrc_applied[found.body, 3:] = np.cross(data.site_xpos[found.site] - data.xipos[found.body], push)

    def _settle(self, work: float, supplied: float) -> bool:
        """Enter what went in during this substep, and let a debt be paid. False: it cannot be; nothing is entered."""
        energy = self.energy_J()
        if not abs(energy) < _MOST_J:
            raise HapnetError(f"the scene mujoco failed: its energy is {energy:.3g} J{self._by_itself()}")
        left = self.account_J + work + supplied - (energy - self._energy_J)
        if left < 0.0:
            self.given_J -= left
            paid = self._pay(-left)
            energy, left = energy - paid, left + paid
            if left < -_ROUNDING * abs(energy) - _ROUNDING:
                return False
            self.paid_J += paid
        self.supplied_J += supplied
        self._energy_J = energy
        self.account_J = min(max(0.0, left), CEILING_J)
        return True

    def _by_itself(self) -> str:
        """Does the model diverge without the hand too, from its start and with its own timestep?"""
        engine, model, data = self._engine, self._model, self._engine.MjData(self._model)
        model.opt.timestep = self.own_step_s
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

    def _pay(self, debt: float) -> float:
        """Damp all that moves. Returns what was paid, at most the kinetic energy [J]."""
        data = self._data
        kinetic = float(data.energy[1])
        if not kinetic > 0.0:
            return 0.0
        data.qvel[:] *= sqrt(max(0.0, 1.0 - debt / kinetic))
        self._engine.mj_step1(self._model, data)
        return kinetic - float(data.energy[1])

    def _rows(self) -> Array:
        """The proxy's Jacobian (n, nv)."""
        engine, model, data, found = self._engine, self._model, self._data, self.found
        if found.site >= 0:
            engine.mj_jacSite(model, data, self._jacobian, None, found.site)
        else:
            engine.mj_jacBodyCom(model, data, self._jacobian, None, found.body)
        return self._jacobian[: self.dof]
