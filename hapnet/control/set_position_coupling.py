"""The way of a set-position on one side: reception, stages, silence, step limit, modulator, ledger.

The device's servo (set_position_servo.py) and the virtual world's steps both drive one `SetPositionCoupling`; only the
energy that they harvest differs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from hapnet.checks import Vector
from hapnet.control.coupling import CouplingSample, Mass, S, Update, vector_of
from hapnet.control.ledger import Ledger
from hapnet.control.limits import Silence, step_towards
from hapnet.control.pspm import Modulation
from hapnet.control.smoothing import Pipeline
from hapnet.mechanics.spring import Spring


class Modulator(Protocol):
    """What turns a received set-position into the one the spring is tied to."""

    @property
    def set_position(self) -> Vector: ...
    @property
    def spring(self) -> Spring: ...
    @property
    def energy(self) -> float: ...
    @property
    def deficit(self) -> float: ...
    @property
    def account(self) -> float: ...

    def modulate(self, y: Vector, x: Vector, dissipated: float, received: float, keep: float = 0.0) -> Modulation: ...
    def split_reservoir(self, most: float = ...) -> float: ...


class SetPositionCoupling:
    """One side's coupling between its position x and what the other side sends.

    Parameters
    ----------
    modulator : `SetPositionModulator` or `ZeroOrderHold`, at rest at the side's position.
    stages : filters and predictors before the modulator.
    silence : what to do when nothing arrives.
    longest_step : limit of the set-position's step an update [m]; infinite: none.
    kinetic : kinetic energy at the start [J].
    kept_for_peers : with so little left in the reservoir a new peer gets a hundredth of it, and not half [J].
    """

    def __init__(
        self,
        modulator: Modulator,
        *,
        stages: Pipeline,
        silence: Silence,
        longest_step: float = math.inf,
        kinetic: float = 0.0,
        kept_for_peers: float = 0.0,
    ) -> None:
        self.modulator = modulator
        self.spring = modulator.spring
        self.stages = stages
        self.silence = silence
        self.longest_step = longest_step
        self.ledger = Ledger(kinetic, modulator.account)
        self.target: Vector = modulator.set_position
        """y(k) as asked of the modulator [m]: after the stages and silence, before the step limit."""
        self.has_sample = False
        """Has something arrived that no update has used yet?"""
        self.account = modulator.account
        """The reservoir's content as the ledger counts it [J]: energy less deficit."""
        self.energy_min = modulator.energy
        self.deficit_max = 0.0
        self.discarded = 0.0
        self.spare: Callable[[], float] = lambda: math.inf
        """What the reservoir can do without now [J]; a servo that holds a torque says how much."""
        self._kept_for_peers = kept_for_peers
        self._received: Vector = modulator.set_position
        self._sent_s: float | None = None
        self._credit = 0.0
        stages.reset(modulator.set_position)

    @property
    def set_position(self) -> Vector:
        """ybar [m]."""
        return self.modulator.set_position

    @property
    def reservoir(self) -> float:
        """E [J]."""
        return self.modulator.energy

    @property
    def deficit(self) -> float:
        """What a measured, negative D left unpaid [J]."""
        return self.modulator.deficit

    def receive(self, sample: CouplingSample, sent_s: float) -> None:
        """A set-position arrived [m]; `sent_s` is the sender's time [s]."""
        self._received = vector_of(sample)
        self._sent_s = sent_s
        self.has_sample = True

    def credit(self, energy: float) -> None:
        """Shuffled energy arrived [J]; the next update uses it, once."""
        self._credit += energy
        self.has_sample = True

    def on_peer_changed(self) -> float:
        """Another peer takes the first one's place: half of the reservoir is for it, which begins with none [J].

        Without any it could not begin: the least of it lets it render a little force, against which the hand works for
        more. So of the last that is left, only a hundredth is given: there is some for the next peers too. The stages
        begin anew: its clock and its place have nothing to do with the first one's.
        """
        self.stages.reset(self.target)
        most, energy = self.spare(), self.modulator.energy
        if energy <= 2.0 * self._kept_for_peers:
            most = min(most, energy / 100.0)
        energy = self.modulator.split_reservoir(most)
        self.ledger.send(energy)
        self.account = self.modulator.account
        return energy

    def potential(self, x: Vector) -> float:
        """phi [J] with the present ybar."""
        return self.spring.between(self.modulator.set_position, x)

    def update(self, dt: float, x: Vector, dissipated: float, keep: float = 0.0) -> Modulation:
        """One PSPM instant, `dt` seconds after the last, at position x [m] with D = `dissipated` [J].

        `keep` is what spring and reservoir must hold afterwards, as far as they can [J]. The energy to send is in the
        result; the ledger already counts it as sent.
        """
        sent_s = self._sent_s
        self._sent_s = None
        y = self.stages.step(dt, self._received, sent_s)
        if self.silence.step(dt, fresh=sent_s is not None):
            y = x
        self.target = y
        if self.longest_step != math.inf:
            y = step_towards(self.modulator.set_position, y, self.longest_step)
        return self._modulate(y, x, dissipated, keep)

    def release(self, x: Vector, dissipated: float) -> Modulation:
        """One PSPM instant that lets the spring go at once: ybar = x, and y stays there until something arrives.

        It is passive as any other y is; what the spring had stored goes to the reservoir.
        """
        self._received = self.target = x
        self._sent_s = None
        self.stages.reset(x)
        return self._modulate(x, x, dissipated)

    def _modulate(self, y: Vector, x: Vector, dissipated: float, keep: float = 0.0) -> Modulation:
        credit = self._credit
        self._credit = 0.0
        self.has_sample = False
        modulator = self.modulator
        result = modulator.modulate(y, x, dissipated, credit, keep)
        self.ledger.credit(credit)
        if result.sent:
            self.ledger.send(result.sent)
        self.account = modulator.account
        if result.energy < self.energy_min:
            self.energy_min = result.energy
        if result.deficit > self.deficit_max:
            self.deficit_max = result.deficit
        self.discarded += result.discarded
        return result


class SetPositionSteps:
    """The world's end: a `WorldCoupling` whose mass has its own spring, tied to ybar.

    Parameters
    ----------
    coupling : the set-position's way.
    """

    def __init__(self, coupling: SetPositionCoupling) -> None:
        self.coupling = coupling

    def advance(self, mass: Mass[S], dt: float, contacts: Sequence[Any]) -> S:
        return mass.step(dt, self.coupling.set_position, contacts)

    def update(self, dt: float, x: Vector, dissipated: float) -> Update:
        """PSPM at the onset of a step; the device is told x."""
        return Update(x, self.coupling.update(dt, x, dissipated).sent)
