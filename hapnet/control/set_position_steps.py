"""The world's end of a coupling of set-positions: it moves the mass, runs PSPM at each step, and makes the samples."""

from __future__ import annotations

from math import dist, inf
from typing import Any

from hapnet.checks import Vector
from hapnet.control.carrying import carry, plan
from hapnet.control.coupling import Update, counted
from hapnet.control.reporter import SampleReporter
from hapnet.control.set_position_coupling import SetPositionCoupling, update
from hapnet.mechanics.contacts import Mass, Step, Surroundings


class SetPositionSteps:
    """The world's end: a `WorldCoupling` with a spring of its own, which ties the mass to ybar.

    coupling : this side's set-position coupling.
    reporter : makes the sample of the proxy and of the surfaces around it; None: only its position is sent.
    stretch_m : y is at most this far from a proxy that touches something [m].
    """

    def __init__(
        self, coupling: SetPositionCoupling, reporter: SampleReporter | None = None, stretch_m: float = inf
    ) -> None:
        self.coupling = coupling
        self.reporter = reporter
        self.stretch_m = stretch_m
        coupling.carries = int(reporter is not None and not coupling.stages.stages)
        self._carries = False

    def advance(self, mass: Mass, dt: float, contacts: Surroundings) -> Step:
        coupling = self.coupling
        done = mass.step(dt, coupling.set_position, contacts)
        self._carries = bool(coupling.carries) and mass.can_be_carried
        if self._carries and any(coupling.carried):
            carry(coupling, mass, contacts, n := len(done.position), dt)
            moved: Any = mass
            done = done._replace(position=mass.position, velocity=tuple(moved.vhat[:n]))
        if self.reporter is not None:
            self.reporter.moved(done, contacts)
        return done

    def counted(self, dt: float, x: Vector, kinetic: float, work: float, dissipated: float) -> Update:
        """Count a step in the ledger and run the law, as `control.coupling.counted` does."""
        return counted(self, dt, x, kinetic, work, dissipated)

    def update(self, dt: float, x: Vector, dissipated: float) -> Update:
        """Run PSPM at the start of a step. The sample for the device is x, with the surfaces around it."""
        reporter = self.reporter
        if reporter is not None:
            reporter.look(dt, x)
        coupling = self.coupling
        coupling.choose(dt, x)
        if reporter is not None and reporter.touches and (far := dist(coupling.y, x)) > self.stretch_m:
            share = self.stretch_m / far
            coupling.y[:] = [a + share * (b - a) for a, b in zip(x, coupling.y, strict=True)]
        if reporter is not None and self._carries:
            plan(coupling, reporter.predicted, reporter.contacts, len(x), x)
        update(coupling, dt, x, dissipated, 0.0)
        return Update(x if reporter is None else reporter.proxy(x, coupling.level), coupling.shuffled)
