"""The path of a set-position through one side: reception, stages, silence, step limit, modulator, ledger.

The device's servo (set_position_servo.py) and the virtual world's steps each drive one `SetPositionCoupling`. They
differ only in how they harvest energy.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, Protocol

from hapnet.checks import Vector
from hapnet.control import ledger as ledgers, pspm, smoothing, zoh
from hapnet.control.coupling import CouplingSample, level_of, vector_of
from hapnet.control.ledger import Ledger
from hapnet.control.limits import Silence, limit_step, releases
from hapnet.control.pspm import Modulation, SetPositionModulator
from hapnet.control.smoothing import Pipeline
from hapnet.mechanics import spring as springs
from hapnet.mechanics.spring import Spring
from hapnet.records.record import Floats, OfAxes, Reals, Record, compiled_as, equation
from hapnet.records.vectors import copy


class Modulator(Protocol):
    """Turns a received set-position y into ybar, to which the spring is tied."""

    @property
    def set_position(self) -> Vector: ...
    @property
    def ybar(self) -> Floats: ...
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
    def modulated(self) -> int: ...
    @property
    def discarded(self) -> float: ...
    @property
    def jump(self) -> float: ...

    def give(self, dt: float, peer_level: float, keep: float) -> float: ...
    def modulate(self, y: Vector, x: Vector, dissipated: float, received: float, keep: float = 0.0) -> Modulation: ...
    def split_reservoir(self, most: float = ...) -> float: ...


class Source(Protocol):
    """Computes y from the samples that have arrived."""

    def receive(self, sample: CouplingSample, sent_s: float, age_s: float) -> None:
        """Take in a sample that arrived: see `CouplingState.receive`."""

    def step(self, dt: float, x: Vector) -> Vector:
        """y [m] at the own position x [m], `dt` seconds after the last step."""

    def reset(self, position: Vector) -> None:
        """Start again at `position` [m]: the peer was replaced."""

    def release(self, position: Vector) -> None:
        """Continue from `position` [m]: the spring was released, but the peer is the same."""


class Arrived(NamedTuple):
    """The received values that the next update uses."""

    set_position: Vector
    """The newest set-position received [m]."""
    credit: float
    """Shuffled energy that no update has used yet [J]."""
    has_sample: bool
    """Whether either of them has arrived since the last update."""


class SetPositionCoupling(Record):
    """One side's coupling between its position x and the set-positions from the other side.

    More than twenty attributes: y passes source, stages, silence, step limit and modulator, and each has its counts.

    modulator : `SetPositionModulator` or `ZeroOrderHold`, at rest at the side's position.
    stages : filters and predictors before the modulator.
    source : computes y, before the stages, from all samples that have arrived; None: y is the newest set-position.
    silence : the policy while nothing arrives.
    max_step : the largest step of the set-position in one update, beyond the own motion [m]; infinite: no limit.
    kinetic : kinetic energy at the start [J].
    kept_for_peers : if the reservoir holds at most twice this energy [J], a new peer gets a hundredth of it, not half.
    shares : whether this side reports its reservoir's level, and sends energy to a side that needs it more.

    Attributes
    ----------
    passive : whether the modulator is PSPM, not a zero-order hold. ledger : its account.
    place : x at the last update [m]. moved : the own motion since then [m].
    carries : whether the proxy may be carried; carried : its displacement in the present step [m], see carrying.py.
    y : the set-position of the next update [m]. aim : y(k) after the stages and silence, before the step limit [m].
    received : the newest set-position received [m]; fresh : whether it is new; sent_s : time of sending [s].
    waiting : received energy that no update has used yet [J]. has_sample : whether the next update has new input.
    account : the reservoir's content as the ledger counts it [J]: energy less deficit.
    peer_level : the level of the other side's reservoir; below 0: unknown.
    updates, modulated : the number of updates, and of those in which the energy did not suffice for y.
    shuffled : the energy to send from the last update [J].
    """

    modulator: SetPositionModulator
    stages: Pipeline
    silence: Silence
    ledger: Ledger
    passive: int
    place: OfAxes
    moved: OfAxes
    carries: int
    carried: OfAxes
    y: OfAxes
    aim: OfAxes
    received: OfAxes
    fresh: int
    sent_s: float
    waiting: float
    has_sample: int
    account: float
    max_step: float
    shares: int
    peer_level: float
    energy_min: float
    deficit_max: float
    discarded: float
    updates: int
    modulated: int
    shuffled: float

    def __init__(
        self,
        modulator: Modulator,
        *,
        stages: Pipeline,
        silence: Silence,
        source: Source | None = None,
        max_step: float = math.inf,
        kinetic: float = 0.0,
        kept_for_peers: float = 0.0,
        shares: bool = False,
    ) -> None:
        super().__init__()
        self.modulator = modulator  # type: ignore[assignment]  # Python takes any; compiled code these two
        self.spring: Spring = modulator.spring
        self.stages = stages
        self.source = source
        self.silence = silence
        self.max_step = max_step
        self.ledger = Ledger(kinetic, modulator.account)
        self.passive = int(isinstance(modulator, SetPositionModulator))
        start = modulator.set_position
        self.y, self.aim, self.received = list(start), list(start), list(start)
        self.place, self.moved, self.carried = list(start), [0.0] * len(start), [0.0] * len(start)
        self.account = modulator.account
        self.energy_min = modulator.energy
        self.peer_level = -1.0
        self.shares = int(shares)
        self.spare: Callable[[], float] = lambda: math.inf
        """Energy that the reservoir can spare now [J]; a servo that holds a torque sets this."""
        self._kept_for_peers = kept_for_peers
        stages.reset(start)

    @property
    def target(self) -> Vector:
        """y(k) after the stages and silence, before the step limit [m]."""
        return tuple(self.aim)

    @property
    def modulated_share(self) -> float | None:
        """The share of the updates in which the energy did not suffice for y; None: no updates yet."""
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
        """The reservoir's level, to be sent to the other side; None: it is not sent."""
        return self.modulator.level if self.shares else None

    def receive(self, sample: CouplingSample, sent_s: float, age_s: float) -> None:
        """Take in a set-position that arrived [m]; see `CouplingState.receive`."""
        if self.shares:
            level = level_of(sample)
            self.peer_level = -1.0 if level is None else level
        if self.source is not None:
            self.source.receive(sample, sent_s, age_s)
        receive(self, len(self.received), vector_of(sample), sent_s)

    def credit(self, energy: float) -> None:
        """Take in shuffled energy that arrived [J]; the next update uses it, once."""
        credit(self, energy)

    @property
    def arrived(self) -> Arrived:
        """The received values that the next update uses."""
        return Arrived(tuple(self.received), self.waiting, bool(self.has_sample))

    def restore(self, arrived: Arrived) -> None:
        """Replace the received values that the next update uses."""
        self.received, self.waiting, self.has_sample = list(arrived[0]), arrived[1], int(arrived[2])

    def on_peer_changed(self) -> float:
        """Start again with a new peer. Returns the energy to shuffle to it [J]: half of the reservoir.

        The new peer starts with an empty reservoir and could render no force. A little energy is enough: the hand then
        works against a small force and puts in more. So a nearly empty reservoir gives only a hundredth, and keeps the
        rest for later peers. The stages start again, because the new peer's clock and position are unrelated to the
        old peer's.
        """
        self.stages.reset(self.target)
        if self.source is not None:
            self.source.reset(self.target)
        self.peer_level = -1.0
        most, energy = self.spare(), self.modulator.energy
        if energy <= 2.0 * self._kept_for_peers:
            most = min(most, energy / 100.0)
        energy = self.modulator.split_reservoir(most)
        self.ledger.send(energy)
        self.account = self.modulator.account
        return energy

    def potential(self, x: Vector) -> float:
        """phi [J] with the present ybar."""
        return springs.between(self.spring, self.modulator.ybar, x)

    def update(self, dt: float, x: Vector, dissipated: float, keep: float = 0.0) -> Modulation:
        """Run PSPM once, `dt` seconds after the last time, at position x [m] with D = `dissipated` [J].

        `keep` is the energy that spring and reservoir together should keep [J]. The result contains the energy to
        send; the ledger already counts it as sent.
        """
        self.choose(dt, x)
        update(self, dt, x, dissipated, keep)
        return self._result()

    def choose(self, dt: float, x: Vector) -> None:
        """Choose y for the next update, `dt` seconds after the last, at x [m]."""
        self.y[:] = self.received if self.source is None else self.source.step(dt, x)

    def rest(self) -> None:
        """Stay at ybar until a sample arrives; samples received before are discarded."""
        at = self.set_position
        self.received, self.aim, self.fresh = list(at), list(at), 0
        self.stages.reset(at)
        if self.source is not None:
            self.source.release(at)

    def release(self, x: Vector, dissipated: float) -> Modulation:
        """Run PSPM once and release the spring at once: ybar = x, and y stays there until a sample arrives.

        This is as passive as any other y. The spring's stored energy goes to the reservoir.
        """
        self.received, self.aim, self.fresh = list(x), list(x), 0
        self.stages.reset(x)
        if self.source is not None:
            self.source.release(x)
        self.y[:] = x
        _run(self, 0.0, x, dissipated, 0.0)
        return self._result()

    def _result(self) -> Modulation:
        """The result of the last update, with all energy to send."""
        modulator = self.modulator
        return Modulation(
            modulator.set_position,
            modulator.energy,
            modulator.deficit,
            self.shuffled,
            modulator.discarded,
            modulator.jump,
        )


@equation
def receive(coupling: SetPositionCoupling, n: int, set_position: Reals, sent_s: float) -> None:
    """Take in a set-position that arrived [m]: `SetPositionCoupling.receive`, without level and source."""
    copy(n, set_position, coupling.received)
    coupling.sent_s = sent_s
    coupling.fresh = coupling.has_sample = 1


@equation
def credit(coupling: SetPositionCoupling, energy: float) -> None:
    """Take in shuffled energy that arrived [J]: `SetPositionCoupling.credit`."""
    coupling.waiting += energy
    coupling.has_sample = 1


@equation
def potential(coupling: SetPositionCoupling, x: Reals) -> float:
    """phi [J] with the present ybar."""
    return springs.between(coupling.modulator.spring, coupling.modulator.ybar, x)


@equation
def update(coupling: SetPositionCoupling, dt: float, x: Reals, dissipated: float, keep: float) -> None:
    """Run PSPM once, with y in `coupling.y`: `SetPositionCoupling.update`."""
    n, y = coupling.modulator.spring.dof, coupling.y
    fresh = coupling.fresh != 0
    coupling.fresh = 0
    smoothing.step(coupling.stages, n, dt, y, fresh, coupling.sent_s)
    if releases(coupling.silence, dt, fresh):
        copy(n, x, y)
    if coupling.silence.elapsed > coupling.silence.after:
        coupling.peer_level = -1.0  # energy sent now would be lost with the link, or discarded by a full reservoir
    copy(n, y, coupling.aim)
    if coupling.max_step != math.inf:
        for i in range(n):
            coupling.moved[i] = x[i] - coupling.place[i]
        limit_step(n, coupling.modulator.ybar, coupling.moved, y, coupling.max_step)
    _run(coupling, dt, x, dissipated, keep)


@equation
def _run(coupling: SetPositionCoupling, dt: float, x: Reals, dissipated: float, keep: float) -> None:
    """Run the modulator with `coupling.y`, and count its results."""
    received = coupling.waiting
    copy(coupling.modulator.spring.dof, x, coupling.place)
    coupling.waiting = 0.0
    coupling.has_sample = 0
    coupling.shuffled = _modulate(coupling, dt, x, dissipated, received, keep)
    modulator = coupling.modulator
    coupling.updates += 1
    coupling.modulated += 1 if modulator.modulated else 0
    ledgers.credit(coupling.ledger, received)
    if coupling.shuffled != 0.0:
        ledgers.send(coupling.ledger, coupling.shuffled)
    coupling.account = modulator.energy - modulator.deficit
    coupling.energy_min = min(coupling.energy_min, modulator.energy)
    coupling.deficit_max = max(coupling.deficit_max, modulator.deficit)
    coupling.discarded += modulator.discarded


def _compiled_modulate(
    coupling: SetPositionCoupling, dt: float, x: Reals, dissipated: float, received: float, keep: float
) -> float:
    if not coupling.passive:
        zoh.hold(coupling.modulator, coupling.y, x)
        return 0.0
    pspm.modulate(coupling.modulator, coupling.y, x, dissipated, received, keep)
    sent = coupling.modulator.sent
    if coupling.peer_level >= 0.0:
        sent += pspm.give(coupling.modulator, dt, coupling.peer_level, keep)
    return sent


@compiled_as(_compiled_modulate)
def _modulate(
    coupling: SetPositionCoupling, dt: float, x: Reals, dissipated: float, received: float, keep: float
) -> float:
    """Tie the spring to a new ybar; returns the energy to send [J]. In Python the modulator may be of any class."""
    modulator = coupling.modulator
    sent = modulator.modulate(tuple(coupling.y), tuple(x), dissipated, received, keep).sent
    if coupling.peer_level >= 0.0:
        sent += modulator.give(dt, coupling.peer_level, keep)
    return sent
