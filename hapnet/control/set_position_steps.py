"""The world's end of a coupling of set-positions: it moves the mass, runs PSPM at each step, and makes the samples."""

from __future__ import annotations

from hapnet.checks import Vector
from hapnet.control.carrying import carry, plan
from hapnet.control.coupling import Update, counted
from hapnet.control.reporter import SampleReporter
from hapnet.control.set_position_coupling import SetPositionCoupling, update
from hapnet.control.tool_in_contact import ToolInContact
from hapnet.mechanics.contacts import Mass, Step, Surroundings


class SetPositionSteps:
    """The world's end: a `WorldCoupling` with a spring of its own, which ties the mass to ybar.

    coupling : this side's set-position coupling.
    reporter : makes the sample of the proxy and of the surfaces around it; None: only its position is sent.
    in_contact : limits y of a tool that touches something; None: it is no tool.
    """

    def __init__(
        self,
        coupling: SetPositionCoupling,
        reporter: SampleReporter | None = None,
        in_contact: ToolInContact | None = None,
    ) -> None:
        self.coupling = coupling
        self.reporter = reporter
        self.in_contact = in_contact
        coupling.carries = int(reporter is not None and not coupling.stages.stages)
        self._carries = False

    def advance(self, mass: Mass, dt: float, contacts: Surroundings) -> Step:
        coupling = self.coupling
        done = mass.step(dt, coupling.set_position, contacts)
        self._carries = bool(coupling.carries) and mass.can_be_carried
        n = len(done.position)
        if self._carries and any(coupling.carried) and carry(coupling, mass, contacts, n, dt):
            velocity = tuple([v + way / dt for v, way in zip(done.velocity, coupling.carried, strict=False)])
            done = done._replace(position=mass.position, velocity=velocity)
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
        coupling, tool = self.coupling, self.in_contact
        if reporter is not None and tool is not None:
            tool.predict_less(dt, reporter.touches, reporter.predicted)
        coupling.choose(dt, x)
        if reporter is not None and tool is not None and reporter.touches:
            tool.keep_near(x, coupling.y)
        if reporter is not None and self._carries:
            plan(coupling, reporter.predicted, reporter.contacts, len(x), x)
        update(coupling, dt, x, dissipated, 0.0)
        return Update(x if reporter is None else reporter.proxy(x, coupling.level), coupling.shuffled)
