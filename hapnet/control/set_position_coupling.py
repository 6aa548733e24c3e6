"""The path of a set-position through one side: reception, stages, silence, step limit, modulator, ledger.

The device's servo (set_position_servo.py) and the virtual world's steps each drive one `SetPositionCoupling`. They
differ only in how they harvest energy.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from hapnet.checks import Vector
from hapnet.control.coupling import CouplingSample, Mass, Proxy, S, Update, level_of, vector_of
from hapnet.control.ledger import Ledger
from hapnet.control.limits import Silence, step_towards
from hapnet.control.prediction import PredictedDevice
from hapnet.control.pspm import Modulation
from hapnet.control.smoothing import Pipeline
from hapnet.mechanics.plane import Plane, checked
from hapnet.mechanics.spring import Spring

MOST_REACH_M = 1.0
"""Planes that are farther away are never told [m]: no desktop device reaches so far."""


class Modulator(Protocol):
    """Turns a received set-position y into the one that the spring is tied to, ybar."""

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
    @property
    def level(self) -> float | None: ...
    @property
    def modulated(self) -> bool: ...

    def give(self, dt: float, peer_level: float, keep: float) -> float: ...
    def modulate(self, y: Vector, x: Vector, dissipated: float, received: float, keep: float = 0.0) -> Modulation: ...
    def split_reservoir(self, most: float = ...) -> float: ...


class Source(Protocol):
    """Computes y from all that has arrived."""

    def receive(self, sample: CouplingSample, sent_s: float, age_s: float) -> None:
        """As `CouplingState.receive`."""

    def step(self, dt: float, x: Vector) -> Vector:
        """y [m] at the own position x [m], `dt` seconds after the last step."""

    def reset(self, position: Vector) -> None:
        """Start again at `position` [m]: the peer was replaced."""

    def release(self, position: Vector) -> None:
        """Go on from `position` [m]: the spring was released, but the peer is the same."""


class Arrived(NamedTuple):
    """What the next update uses."""

    set_position: Vector
    """The newest that was received [m]."""
    credit: float
    """Shuffled energy that no update has used yet [J]."""
    has_sample: bool
    """Has either of them arrived since the last update?"""


class SetPositionCoupling:
    """One side's coupling between its position x and what the other side sends.

    More than twenty attributes: y passes source, stages, silence, step limit and modulator, and each step is counted.

    Parameters
    ----------
    modulator : `SetPositionModulator` or `ZeroOrderHold`, at rest at the side's position.
    stages : filters and predictors before the modulator.
    source : computes y, before the stages, from all that has arrived; None: y is the newest set-position.
    silence : what to do when nothing arrives.
    longest_step : how far the set-position may move in one update [m]; infinite: no limit.
    kinetic : kinetic energy at the start [J].
    kept_for_peers : when the reservoir holds at most twice this [J], a new peer gets a hundredth of it, not half.
    shares : does it tell how full its reservoir is, and give energy to a side that needs it more?
    """

    def __init__(
        self,
        modulator: Modulator,
        *,
        stages: Pipeline,
        silence: Silence,
        source: Source | None = None,
        longest_step: float = math.inf,
        kinetic: float = 0.0,
        kept_for_peers: float = 0.0,
        shares: bool = False,
    ) -> None:
        self.modulator = modulator
        self.spring: Spring = modulator.spring
        self.stages = stages
        self.source = source
        self.silence = silence
        self.longest_step = longest_step
        self.ledger: Ledger = Ledger(kinetic, modulator.account)
        self.target: Vector = modulator.set_position
        """y(k) after the stages and silence, before the step limit [m]."""
        self.has_sample: bool = False
        """True if a sample or energy has arrived that no update has used yet."""
        self.account: float = modulator.account
        """The reservoir's content as the ledger counts it [J]: energy less deficit."""
        self.energy_min: float = modulator.energy
        self.deficit_max: float = 0.0
        self.discarded: float = 0.0
        self.updates: int = 0
        self.modulated: int = 0
        """Of these updates: how many could not pay for the whole of y."""
        self.peer_level: float | None = None
        """How full the other side's reservoir is; None: it does not tell."""
        self._shares = shares
        self.spare: Callable[[], float] = lambda: math.inf
        """Energy that the reservoir can spare now [J]; a servo that holds a torque sets this."""
        self._kept_for_peers = kept_for_peers
        self._received: Vector = modulator.set_position
        self._sent_s: float | None = None
        self._credit = 0.0
        self._potential: tuple[Vector, Vector, float] = modulator.set_position, modulator.set_position, 0.0
        stages.reset(modulator.set_position)

    @property
    def modulated_share(self) -> float | None:
        """The share of the updates that could not pay for the whole of y; None: there was none yet."""
        return self.modulated / self.updates if self.updates else None

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
        """The part of a measured, negative D that the reservoir could not cover [J]."""
        return self.modulator.deficit

    @property
    def level(self) -> float | None:
        """How full the reservoir is, to tell the other side; None: it is not told."""
        return self.modulator.level if self._shares else None

    def receive(self, sample: CouplingSample, sent_s: float, age_s: float) -> None:
        """A set-position arrived [m]; see `CouplingState.receive`."""
        if self._shares:
            self.peer_level = level_of(sample)
        if self.source is not None:
            self.source.receive(sample, sent_s, age_s)
        self._received = vector_of(sample)
        self._sent_s = sent_s
        self.has_sample = True

    def credit(self, energy: float) -> None:
        """Shuffled energy arrived [J]; the next update uses it, once."""
        self._credit += energy
        self.has_sample = True

    @property
    def arrived(self) -> Arrived:
        """What the next update uses."""
        return Arrived(self._received, self._credit, self.has_sample)

    def restore(self, arrived: Arrived) -> None:
        """The next update uses this instead."""
        self._received, self._credit, self.has_sample = arrived

    def on_peer_changed(self) -> float:
        """A new peer has replaced the old one. Returns the energy to shuffle to it [J]: half of the reservoir.

        The new peer starts with an empty reservoir and could render no force. A little energy is enough: the hand then
        works against a small force and puts in more. So a nearly empty reservoir gives only a hundredth, and keeps some
        for later peers. The stages start again, because the new peer's clock and position have nothing to do with the
        old one's.
        """
        self._reset(self.target)
        self.peer_level = None
        most, energy = self.spare(), self.modulator.energy
        if energy <= 2.0 * self._kept_for_peers:
            most = min(most, energy / 100.0)
        energy = self.modulator.split_reservoir(most)
        self.ledger.send(energy)
        self.account = self.modulator.account
        return energy

    def potential(self, x: Vector) -> float:
        """phi [J] with the present ybar; asked for several times a tick, and computed once for each x and ybar."""
        ybar, (known_ybar, known_x, phi) = self.modulator.set_position, self._potential
        if ybar is not known_ybar or x is not known_x:
            phi = self.spring.between(ybar, x)
            self._potential = ybar, x, phi
        return phi

    def update(self, dt: float, x: Vector, dissipated: float, keep: float = 0.0) -> Modulation:
        """Run PSPM once, `dt` seconds after the last time, at position x [m] with D = `dissipated` [J].

        `keep` is the energy that spring and reservoir together should keep [J]. The result contains the energy to
        send; the ledger already counts it as sent.
        """
        sent_s = self._sent_s
        self._sent_s = None
        y = self._received if self.source is None else self.source.step(dt, x)
        y = self.stages.step(dt, y, sent_s)
        if self.silence.step(dt, fresh=sent_s is not None):
            y = x
        if self.silence.is_silent:
            self.peer_level = None  # energy sent now would be lost with the link, or find a full reservoir
        self.target = y
        if self.longest_step != math.inf:
            y = step_towards(self.modulator.set_position, y, self.longest_step)
        return self._modulate(dt, y, x, dissipated, keep)

    def release(self, x: Vector, dissipated: float) -> Modulation:
        """Run PSPM once and release the spring at once: ybar = x, and y stays there until a sample arrives.

        This is as passive as any other y. The spring's stored energy goes to the reservoir.
        """
        self._received = self.target = x
        self._sent_s = None
        self.stages.reset(x)
        if self.source is not None:
            self.source.release(x)
        return self._modulate(0.0, x, x, dissipated)

    def _reset(self, position: Vector) -> None:
        self.stages.reset(position)
        if self.source is not None:
            self.source.reset(position)

    def _modulate(self, dt: float, y: Vector, x: Vector, dissipated: float, keep: float = 0.0) -> Modulation:
        credit = self._credit
        self._credit = 0.0
        self.has_sample = False
        modulator = self.modulator
        result = modulator.modulate(y, x, dissipated, credit, keep)
        self.updates += 1
        self.modulated += modulator.modulated
        if self.peer_level is not None and (given := modulator.give(dt, self.peer_level, keep)):
            result = result._replace(energy=modulator.energy, sent=result.sent + given)
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
    coupling : this side's set-position coupling.
    predicted : the coupling's source, if the proxy is sent with the planes around it; None: only its position is sent.
    reach : planes within this distance are told [m]. reach_speed : and those that a device so fast [m/s] could reach
        before it is told of them.
    """

    def __init__(
        self,
        coupling: SetPositionCoupling,
        predicted: PredictedDevice | None = None,
        reach: float = 0.0,
        reach_speed: float = 0.0,
    ) -> None:
        self.coupling = coupling
        self._predicted = predicted
        self._reach = reach
        self._reach_speed = reach_speed
        self._contacts: Any = None
        self._force: Vector = (0.0,) * len(coupling.set_position)

    def advance(self, mass: Mass[S], dt: float, contacts: Any) -> S:
        done = mass.step(dt, self.coupling.set_position, contacts)
        self._contacts = contacts
        self._force = getattr(contacts, "contact_force", done.force)  # an engine's holds the proxy's inertia too
        return done

    def update(self, dt: float, x: Vector, dissipated: float) -> Update:
        """Run PSPM at the start of a step. The sample for the device is x, with what is known of the place."""
        predicted = self._predicted
        if predicted is None:
            return Update(x, self.coupling.update(dt, x, dissipated).sent)
        reach = min(MOST_REACH_M, self._reach + self._reach_speed * predicted.turn_s)
        planes: tuple[Plane, ...] | None = ()  # it starts outside of every obstacle
        looked_m = None if self._contacts is None else reach
        if self._contacts is not None:
            tell = getattr(self._contacts, "planes", None)  # a user's own world may have been written without it
            told = None if tell is None else tell(x, reach)
            planes = None if told is None else tuple([plane.unfolded(x) for plane in checked(told, len(x))])
        predicted.planes = planes or ()
        stands_for = predicted.stands_for(dt)
        sent = self.coupling.update(dt, x, dissipated).sent
        return Update(Proxy(x, stands_for, self._force, planes, looked_m, self.coupling.level), sent)
