"""Couplings other than set-position modulation, behind one small interface: what a law does at each end.

At the device a law says which force to hold, tick by tick. At the world a step of the virtual mass M is

    (2M/T + g) vhat = 2M/T v + p + f                    g: drag [Ns/m], p: push [N], f: of the environment [N]

and a law says g and p of each step: so its reaction to the mass may be implicit, and a step may take any time T. What
either end tells the other is a datum of the law's own kind, which travels in a message of its own.
"""

from __future__ import annotations

from operator import mul, sub
from typing import NamedTuple, Protocol

from hapnet.checks import Vector
from hapnet.control.ledger import Ledger
from hapnet.control.set_position_servo import TICK_SLACK_S


class Motion(NamedTuple):
    """A position [m] and its velocity [m/s]."""

    position: Vector
    velocity: Vector


class Port(NamedTuple):
    """What one port shows, a position [m] or a force [N], and all the energy that ever went in there [J]."""

    value: Vector
    energy: float


class Wave(NamedTuple):
    """A wave variable [sqrt(W)], the mean over a time [s]."""

    value: Vector
    span: float


CouplingSample = Vector | Motion | Port | Wave
"""What one side tells the other: a bare vector is a position [m]."""


class Law(Protocol):
    """What both ends have. A law starts at rest at the position that it is made with."""

    @property
    def set_position(self) -> Vector:
        """Where its spring is tied [m]; where it has none, where the other side is taken to be.

        Its distance is to the position what the force is to the coupling's stiffness: a deadband takes it for that.
        """

    def receive(self, datum: CouplingSample) -> None:
        """One datum came from the other side; it is never called twice for one, nor for those of an earlier peer."""

    def on_peer_changed(self) -> None:
        """Another peer, whose counts begin anew, takes the first one's place."""


class DeviceLaw(Law, Protocol):
    """The device's end."""

    def force(self, dt: float, x: Vector, v: Vector, held: Vector) -> Vector:
        """The force on the device [N] to hold from now on.

        Parameters
        ----------
        dt : since the last tick [s]. x, v : measured position [m] and velocity [m/s].
        held : the force that was really held since the last tick [N].
        """

    def next_sample(self, x: Vector, v: Vector) -> CouplingSample:
        """What to tell the world now; called every few ticks, after `force`."""

    def release(self, dt: float, x: Vector, held: Vector) -> None:
        """In place of `force`: the servo was away, no force is rendered until it is on time again."""


class WorldLaw(Law, Protocol):
    """The world's end."""

    def begin(self) -> None:
        """A step begins now: it acts with what has arrived by now."""

    def impedance(self, dt: float) -> tuple[float, Vector]:
        """Drag g [Ns/m] and push p [N] of the step that has taken `dt` seconds."""

    def moved(self, dt: float, vhat: Vector, x: Vector, v: Vector) -> None:
        """The mass has made that step with the mean velocity vhat; it is at x [m] with v [m/s]."""

    def next_sample(self) -> CouplingSample:
        """What to tell the device now, after each step."""


class CouplingAccount:
    """A law's account, and what a recording shows of it: to the rest of a side what `Coupling` is with PSPM.

    Parameters
    ----------
    law : this end's. bound : this side's share of d^2 [J], the same as PSPM's reservoir starts with.
    """

    def __init__(self, law: Law, bound: float) -> None:
        self.law = law
        self.ledger = Ledger(0.0, bound)
        self.account = self.reservoir = self.energy_min = bound
        self.deficit = self.deficit_max = self.discarded = 0.0

    @property
    def set_position(self) -> Vector:
        return self.law.set_position

    @property
    def target(self) -> Vector:
        return self.law.set_position

    def potential(self, x: Vector) -> float:
        """Nothing: a law's springs are its own affair [J]."""
        return 0.0

    def credit(self, energy: float) -> None:
        """Shuffled energy has no use here; nobody sends any [J]."""

    def on_peer_changed(self) -> float:
        """Another peer; what it gets of a reservoir: nothing [J]."""
        self.law.on_peer_changed()
        return 0.0

    def receive(self, datum: CouplingSample, sent_s: float) -> None:
        """A datum arrived."""
        self.law.receive(datum)


class WorldCouplingAccount(CouplingAccount):
    """The world's."""

    def __init__(self, law: WorldLaw, bound: float) -> None:
        super().__init__(law, bound)
        self.law: WorldLaw = law

    def update(self, dt: float, x: Vector, dissipated: float) -> CouplingSample:
        """The onset of a step: what arrived by now acts in it; what to tell the device."""
        self.law.begin()
        return self.law.next_sample()


class LawServo:
    """A law's servo: to the device's side what `SampledServo` is with PSPM. Its account is at the actuator's port.

    Parameters
    ----------
    law : the device's end.
    period : a datum is sent this often [s].
    position : the first measured position [m].
    bound : this side's share of d^2 [J].
    force_limit : longest force the actuator may be asked for [N]; the law is told what was really held.
    """

    harvest = "measured"
    quantisation: float | None = None
    """Unknown: how far encoders blur a law's account."""

    def __init__(self, law: DeviceLaw, *, period: float, position: Vector, bound: float, force_limit: float) -> None:
        self.law = law
        self.coupling = CouplingAccount(law, bound)
        self.trusted_damping = self.force = (0.0,) * len(position)
        self._due = period - TICK_SLACK_S
        self._elapsed = 0.0
        self._position = position
        self._force_limit = force_limit

    @property
    def account(self) -> float:
        """The reservoir's content, which never changes [J]."""
        return self.coupling.account

    def tick(self, dt: float, x: Vector, v: Vector, *, release: bool = False) -> CouplingSample | None:
        """A tick `dt` seconds after the last at x [m] and v [m/s]; sets `force`; the datum to send, if one is due."""
        ledger, held = self.coupling.ledger, self.force
        ledger.put_in(-sum(map(mul, held, map(sub, x, self._position))))
        self._position = x
        ledger.observe(0.0, self.account)
        if release:
            self.law.release(dt, x, held)
            self.stop()
        elif dt > 0.0:  # a law may ask for power
            self.force = _limited(self.law.force(dt, x, v, held), self._force_limit)
        self._elapsed += dt
        if self._elapsed < self._due:
            return None
        self._elapsed = 0.0
        return self.law.next_sample(x, v)

    def stop(self) -> None:
        """No force from now until the next tick."""
        self.force = (0.0,) * len(self.force)


def _limited(force: Vector, longest: float) -> Vector:
    square = sum(map(mul, force, force))
    if square <= longest * longest:
        return force
    share: float = longest / square**0.5
    return tuple([share * component for component in force])
