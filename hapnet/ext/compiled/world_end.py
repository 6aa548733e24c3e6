"""A step of the virtual mass, and of the world's end of a coupling, as compiled calls for real time."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import Any

from hapnet.checks import Vector
from hapnet.control import predicted_device, set_position_coupling as couplings
from hapnet.control.coupling import CouplingSample, Update, counted, level_of, vector_of
from hapnet.control.predicted_device import PredictedDevice
from hapnet.control.reporter import SampleReporter
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.control.set_position_steps import SetPositionSteps
from hapnet.ext.compiled.sides import move_among
from hapnet.mechanics.contacts import Mass, Step, Surroundings
from hapnet.plant import integrator
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds.walls import Contacts
from hapnet.records.record import OfAxes, Record, equation

RECEIVE, MOVE, UPDATE = range(3)
"""The actions of a call."""


class WorldEndRecord(Record):
    """The world's end of a coupling of set-positions, with the virtual mass among walls, and the arguments of a call.

    doing : `RECEIVE`, `MOVE` or `UPDATE`. x, kinetic, work, dissipated : arguments of an update, as in
    `WorldControl.step`. x, sent_s, age_s, level : arguments of a received sample; a level below 0: none.
    """

    mass: PassiveIntegrator
    contacts: Contacts
    coupling: SetPositionCoupling
    predicted: PredictedDevice
    doing: int
    n: int
    dt: float
    x: OfAxes
    kinetic: float
    work: float
    dissipated: float
    sent_s: float
    age_s: float
    level: float


@equation
def run_end(end: WorldEndRecord) -> bool:
    """Do the action `doing`. False: a step cannot be made, and nothing has changed."""
    if end.doing == RECEIVE:
        couplings.receive(end.coupling, end.n, end.x, end.sent_s)
        if end.coupling.shares:
            end.coupling.peer_level = end.level
        if end.predicted.in_use:
            predicted_device.receive(end.predicted, end.n, end.x, end.sent_s, end.age_s)
    elif end.doing == UPDATE:
        counted(end, end.dt, end.x, end.kinetic, end.work, end.dissipated)
    else:
        total = 0.0
        for i in range(end.n):
            total += end.coupling.modulator.ybar[i]
        if not abs(total) < inf or not integrator.factored(end.mass, end.dt, integrator.OWN):
            return False
        move_among(end.mass, end.contacts, end.dt, end.coupling)
        end.kinetic = integrator.kinetic(end.mass)
    return True


def enter(ends: Sequence[WorldEndRecord]) -> bool:
    """Do the end's action `doing`; False: it is impossible. This is the entry to the compiled code."""
    return run_end(ends[0])


class CompiledCoupling(SetPositionCoupling):
    """A `SetPositionCoupling`, with its prediction, that receives samples by a compiled call."""

    def runs(self, array: Any, end: Any, run: Any) -> None:
        """Set the compiled function.

        array, end : the end's memory. run : the compiled function.
        """
        self._array, self._end, self._run = array, end, run

    def receive(self, sample: CouplingSample, sent_s: float, age_s: float) -> None:
        end, level = self._end, level_of(sample)
        end.x[: end.n], end.level = vector_of(sample), -1.0 if level is None else level
        end.sent_s, end.age_s, end.doing = sent_s, age_s, RECEIVE
        self._run(self._array)


class CompiledMass(PassiveIntegrator):
    """A virtual mass that compiled steps move."""

    def belongs(self, end: Any) -> None:
        """Set the place of the mass's end."""
        self._end = end

    @property
    def kinetic_J(self) -> float:
        kinetic: float = self._end.kinetic
        return kinetic

    def ended(self) -> Step:
        """Return the result of the last step."""
        tau, end = tuple(self.coupling_force[:]), tuple(self.x[:])
        return Step(tuple(self.vhat[:]), tuple(self.force[:]), self.work, self.dissipated, tau, end, self.penetration)


class CompiledSteps(SetPositionSteps):
    """`SetPositionSteps` with compiled steps of `mass` among the walls `contacts`.

    coupling, reporter : as in `SetPositionSteps`. array, end : the end's memory. run : the compiled function.
    """

    def __init__(
        self,
        coupling: CompiledCoupling,
        reporter: SampleReporter | None,
        mass: CompiledMass,
        contacts: Contacts,
        array: Any,
        end: Any,
        run: Any,
    ) -> None:
        super().__init__(coupling, reporter)
        self.mass, self.contacts = mass, contacts
        self._array, self._end, self._run = array, end, run
        self._moved = False

    def advance(self, mass: Mass, dt: float, contacts: Surroundings) -> Step:
        self._moved = mass is self.mass and contacts is self.contacts and self._moves(dt)
        if not self._moved:
            return super().advance(mass, dt, contacts)
        done = self.mass.ended()
        if self.reporter is not None:
            self.reporter.moved(done, contacts)
        return done

    def _moves(self, dt: float) -> bool:
        self._end.dt, self._end.doing = dt, MOVE
        return bool(self._run(self._array))

    def counted(self, dt: float, x: Vector, kinetic: float, work: float, dissipated: float) -> Update:
        if not self._moved:  # the end's memory has no such surroundings, so it could carry the proxy through them
            return super().counted(dt, x, kinetic, work, dissipated)
        end, reporter = self._end, self.reporter
        if reporter is not None:
            reporter.look(dt, x)
        end.doing, end.dt, end.x[: len(x)] = UPDATE, dt, x
        end.kinetic, end.work, end.dissipated = kinetic, work, dissipated
        self._run(self._array)
        coupling = self.coupling
        sample = x if reporter is None else reporter.proxy(x, coupling.level)
        return Update(sample, coupling.shuffled)
