"""The world's end of a coupling of set-positions: it moves the mass, runs PSPM at each step, and makes the samples.

While a tool touches something, y is limited (ours):

* A hand pushes the device far beyond the place where its spring saturates. A spring at the world that is as long lends
  tens of millijoules to the tool, and each edge that it slips off dissipates a part. So y stays near the tool.
* A hand that levers a tool is stopped and turned by the solids. A prediction of its motion leads past them, and what
  the tool then dissipates is energy that the hand has not put in. So the longer the tool touches something, the less
  far the hand's motion is predicted. In free space the tool is carried (carrying.py), and its lag matters little.
"""

from __future__ import annotations

from math import dist

from hapnet.checks import Vector
from hapnet.control.carrying import carry, plan
from hapnet.control.coupling import Update, counted
from hapnet.control.predicted_device import PredictedDevice
from hapnet.control.reporter import SampleReporter
from hapnet.control.set_position_coupling import SetPositionCoupling, update
from hapnet.mechanics.contacts import Mass, Step, Surroundings
from hapnet.records.record import Floats

FADE_S = 0.1
"""In contact for so long, the hand's motion is not predicted; after as long without contact, it is in full [s]."""


class ToolInContact:
    """Limits y for a tool that touches something.

    stretch_m : y is at most this far from the tool [m].
    """

    def __init__(self, stretch_m: float) -> None:
        self.stretch_m = stretch_m

    def predict_less(self, dt: float, touches: bool, predicted: PredictedDevice) -> None:
        """Set the share of the time to predict, `dt` seconds after the last step began.

        touches : whether a force acted on the tool in the last step.
        """
        change = dt / FADE_S
        predicted.share = max(0.0, predicted.share - change) if touches else min(1.0, predicted.share + change)

    def keep_near(self, x: Vector, y: Floats) -> None:
        """Move y (n,) [m] towards the tool at x (n,) [m] if it is too far from it."""
        if (far := dist(y, x)) > self.stretch_m:
            share = self.stretch_m / far
            y[:] = [a + share * (b - a) for a, b in zip(x, y, strict=True)]


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
