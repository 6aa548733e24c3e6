"""The stages before any law that takes set-positions: they replace the other side's position for the law.

At the device the local contact model computes it at every tick, from the world's samples and the own position; at the
world the prediction computes it at every step. The law's own controllers follow, so a claim that holds for any
set-position remains valid. A claim that needs the other side's real position does not.
"""

from __future__ import annotations

from collections.abc import Callable

from hapnet.checks import Vector
from hapnet.control.contact_model import ContactModel
from hapnet.control.coupling import CouplingSample, DeviceLaw, LawSteps, Update, WorldLaw
from hapnet.control.law_state import Tank
from hapnet.control.predicted_device import PredictedDevice
from hapnet.control.reporter import SampleReporter
from hapnet.mechanics.contacts import Mass, Step, Surroundings

Takes = Callable[[Vector], CouplingSample]
"""Converts a set-position [m] to the law's kind of sample."""


class StagedDevice:
    """The device's end of a law, with the local contact model before it.

    law : the law's end. model : computes the set-position. takes : converts the set-position to the law's sample.
    """

    def __init__(self, law: DeviceLaw, model: ContactModel, takes: Takes) -> None:
        self._law, self._model, self._takes = law, model, takes
        self.tank: Tank | None = getattr(law, "tank", None)

    @property
    def set_position(self) -> Vector:
        return self._law.set_position

    def stamped(self, sample: CouplingSample, sent_s: float, age_s: float) -> None:
        """Take in a message of the world, as `CouplingState.receive`."""
        self._model.receive(sample, sent_s, age_s)

    def receive(self, sample: CouplingSample) -> None:
        """Do nothing: the model has received the sample."""

    def on_peer_changed(self) -> None:
        self._model.reset(self._law.set_position)
        self._law.on_peer_changed()

    def force(self, dt: float, x: Vector, v: Vector, held: Vector) -> Vector:
        self._law.receive(self._takes(self._model.step(dt, x)))
        return self._law.force(dt, x, v, held)

    def next_sample(self, x: Vector, v: Vector) -> CouplingSample:
        return self._law.next_sample(x, v)

    def release(self, dt: float, x: Vector, held: Vector) -> None:
        self._model.release(x)
        self._law.release(dt, x, held)


class StagedWorld:
    """The world's end of a law, with the prediction before it. The arguments are like those of `StagedDevice`."""

    def __init__(self, law: WorldLaw, predicted: PredictedDevice, takes: Takes) -> None:
        self._law, self._predicted, self._takes = law, predicted, takes
        self.tank: Tank | None = getattr(law, "tank", None)

    @property
    def set_position(self) -> Vector:
        return self._law.set_position

    def stamped(self, sample: CouplingSample, sent_s: float, age_s: float) -> None:
        """Take in the device's position, as `CouplingState.receive`."""
        self._predicted.receive(sample, sent_s, age_s)

    def receive(self, sample: CouplingSample) -> None:
        """Do nothing: the prediction has received the sample."""

    def on_peer_changed(self) -> None:
        self._predicted.reset(self._law.set_position)
        self._law.on_peer_changed()

    def aim(self, dt: float, x: Vector) -> None:
        """Compute the set-position for a step of `dt` seconds from x [m], and pass it to the law."""
        self._law.receive(self._takes(self._predicted.step(dt, x)))

    def begin(self) -> None:
        self._law.begin()

    def impedance(self, dt: float) -> tuple[float, Vector]:
        return self._law.impedance(dt)

    def moved(self, dt: float, vhat: Vector, x: Vector, v: Vector) -> None:
        self._law.moved(dt, vhat, x, v)

    def next_sample(self) -> CouplingSample:
        return self._law.next_sample()


class StagedSteps(LawSteps):
    """A `WorldCoupling` made of a `StagedWorld`; `reporter` makes the samples of the proxy and its surroundings."""

    def __init__(self, law: StagedWorld, initial_energy: float, reporter: SampleReporter) -> None:
        super().__init__(law, initial_energy, law.stamped)
        self._staged, self._reporter = law, reporter

    def advance(self, mass: Mass, dt: float, contacts: Surroundings) -> Step:
        done = super().advance(mass, dt, contacts)
        self._reporter.moved(done, contacts)
        return done

    def update(self, dt: float, x: Vector, dissipated: float) -> Update:
        """Begin a step. Returns the sample of the proxy and the planes around it; the law's own sample is not sent."""
        self._reporter.look(dt, x)
        self._staged.aim(dt, x)
        shuffled = super().update(dt, x, dissipated).shuffled
        return Update(self._reporter.proxy(x, None), shuffled)
