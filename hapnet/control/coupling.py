"""What every coupling is, whatever its law: what a device's servo and a world's steps ask of it.

A coupling has two ends. The device's is asked at each tick which force to hold, the world's how each step of the
virtual mass is made. Either end tells the other samples of its own kind, and may shuffle energy to it. What of an end
is seen by the rest of a side, its account and its set-position, is its `CouplingState`.

Most laws need less: `DeviceLaw` and `WorldLaw` below, which `LawServo` and `LawSteps` make into the two ends. There a
step of the virtual mass M is

    (2M/T + g) vhat = 2M/T v + p + f                    g: drag [Ns/m], p: push [N], f: of the environment [N]

and a law says g and p of each step: so its reaction to the mass may be implicit, and a step may take any time T.
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import mul, sub
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from hapnet.checks import Vector
from hapnet.control.ledger import Ledger

TICK_SLACK_S = 1e-9  # s: a clock of whole nanoseconds may call a period a nanosecond short


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


def vector_of(sample: CouplingSample) -> Vector:
    """The vector of a sample: position, port's value or wave."""
    match sample:
        case Motion(vector, _) | Port(vector, _) | Wave(vector, _):
            return vector
        case _:
            return sample


class Update(NamedTuple):
    """What an update of either end brings: what to tell the other side, and energy to shuffle to it [J]."""

    sample: CouplingSample
    shuffled: float = 0.0


class CouplingState(Protocol):
    """What a side's runtime, record and summary know of a coupling's end."""

    ledger: Ledger
    energy_min: float
    """The least that the reservoir held [J]."""
    deficit_max: float
    discarded: float
    account: float
    """The reservoir's content as the ledger counts it [J]."""

    @property
    def set_position(self) -> Vector:
        """Where its spring is tied [m]; where it has none, where the other side is taken to be.

        Its distance is to the position what the force is to the coupling's stiffness: a deadband takes it for that.
        """

    @property
    def target(self) -> Vector:
        """Where its spring would be tied if the energy were there [m]."""

    @property
    def reservoir(self) -> float: ...
    @property
    def deficit(self) -> float: ...

    def potential(self, x: Vector) -> float:
        """What its spring holds at x [J]."""

    def receive(self, sample: CouplingSample, sent_s: float) -> None:
        """A sample came, sent at `sent_s` on the other side's clock [s]; never twice, nor of an earlier peer."""

    def credit(self, energy: float) -> None:
        """Shuffled energy came [J]; the next update uses it, once."""

    def on_peer_changed(self) -> float:
        """Another peer, whose counts begin anew, takes the first one's place; the energy to shuffle to it [J]."""


class DeviceCoupling(Protocol):
    """A device's end whose force is held from tick to tick; its account is at the actuator's port."""

    force: Vector
    """Held now [N]. Whoever knows better what the actuators really give sets it, before the next tick."""
    trusted_damping: Vector

    @property
    def harvest(self) -> str:
        """ "measured": what a held force dissipates is measured; "range": bounded by (10)."""

    @property
    def coupling(self) -> CouplingState: ...
    @property
    def account(self) -> float:
        """The reservoir's content with the harvest of the running interval [J]."""

    @property
    def quantisation(self) -> float | None:
        """How far the true slack can lie below the measured one, by whole counts of encoders [J]; None: unknown."""

    def figures(self) -> dict[str, Any]:
        """What the summary says of held forces, by the summary's keys; empty if it keeps no such account."""

    def tick(self, dt: float, x: Vector, v: Vector, *, release: bool = False) -> Update | None:
        """A tick `dt` seconds after the last at x [m] and v [m/s]; sets `force`; what to tell, if it is time.

        `release`: the servo was away, no force is rendered until it is on time again.
        """

    def stop(self) -> None:
        """No force from now until the next tick."""


class Step(Protocol):
    """A step of the virtual mass that is over."""

    @property
    def velocity(self) -> Vector: ...
    @property
    def position(self) -> Vector: ...


S = TypeVar("S", bound=Step, covariant=True)


class Mass(Protocol[S]):
    """The virtual mass, as the world's end of a coupling moves it: see hapnet/plant/integrator.py."""

    @property
    def velocity(self) -> Vector: ...
    def step(self, dt: float, set_position: Vector, contacts: Any) -> S:
        """A step with the mass's own spring and damper, tied to `set_position`."""

    def push(self, dt: float, drag: float, push: Vector, contacts: Any) -> S:
        """A step with the drag [Ns/m] and the push [N] of a law."""


class WorldCoupling(Protocol):
    """The world's end."""

    @property
    def coupling(self) -> CouplingState: ...
    def advance(self, mass: Mass[S], dt: float, contacts: Any) -> S:
        """The step that took `dt` seconds [s]: moves the mass."""

    def update(self, dt: float, x: Vector, dissipated: float) -> Update:
        """The onset of the next step, x(k) [m] and D(k-1) [J]: what has arrived by now acts in it."""


class Law(Protocol):
    """What both ends of a law have. It starts at rest at the position that it is made with."""

    @property
    def set_position(self) -> Vector:
        """As `CouplingState.set_position`."""

    def receive(self, sample: CouplingSample) -> None:
        """As `CouplingState.receive`."""

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


L = TypeVar("L", bound=Law)


class LawState(Generic[L]):
    """A law's `CouplingState`: it has no reservoir, but the same share of d^2 as PSPM, so that counts compare.

    Parameters
    ----------
    law : this end's. initial_energy : this side's share of d^2 [J].
    """

    def __init__(self, law: L, initial_energy: float) -> None:
        self.law = law
        self.ledger = Ledger(0.0, initial_energy)
        self.account = self.reservoir = self.energy_min = initial_energy
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

    def receive(self, sample: CouplingSample, sent_s: float) -> None:
        self.law.receive(sample)

    def credit(self, energy: float) -> None:
        """Shuffled energy has no use here; nobody sends any [J]."""

    def on_peer_changed(self) -> float:
        """Tells the law; there is no reservoir to share [J]."""
        self.law.on_peer_changed()
        return 0.0


class LawSteps:
    """The world's end of a law: a `WorldCoupling`.

    Parameters
    ----------
    law : the world's. initial_energy : this side's share of d^2 [J].
    """

    def __init__(self, law: WorldLaw, initial_energy: float) -> None:
        self.law = law
        self.coupling = LawState(law, initial_energy)

    def advance(self, mass: Mass[S], dt: float, contacts: Sequence[Any]) -> S:
        drag, push = self.law.impedance(dt)
        done = mass.push(dt, drag, push, contacts)
        self.law.moved(dt, done.velocity, done.position, mass.velocity)
        return done

    def update(self, dt: float, x: Vector, dissipated: float) -> Update:
        """The onset of a step; what to tell the device of the last one."""
        self.law.begin()
        return Update(self.law.next_sample())


class LawServo:
    """The device's end of a law: a `DeviceCoupling`.

    Parameters
    ----------
    law : the device's.
    period : a sample is sent this often [s].
    position : the first measured position [m].
    initial_energy : this side's share of d^2 [J].
    force_limit : longest force the actuator may be asked for [N]; the law is told what was really held.
    """

    harvest = "measured"
    quantisation: float | None = None
    """Unknown: how far encoders blur a law's account."""

    def __init__(
        self, law: DeviceLaw, *, period: float, position: Vector, initial_energy: float, force_limit: float
    ) -> None:
        self.law = law
        self.coupling = LawState(law, initial_energy)
        self.trusted_damping = self.force = (0.0,) * len(position)
        self._due = period - TICK_SLACK_S
        self._elapsed = 0.0
        self._position = position
        self._force_limit = force_limit

    @property
    def account(self) -> float:
        """The reservoir's content, which never changes [J]."""
        return self.coupling.account

    def figures(self) -> dict[str, Any]:
        return {}

    def tick(self, dt: float, x: Vector, v: Vector, *, release: bool = False) -> Update | None:
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
        return Update(self.law.next_sample(x, v))

    def stop(self) -> None:
        self.force = (0.0,) * len(self.force)


def _limited(force: Vector, longest: float) -> Vector:
    square = sum(map(mul, force, force))
    if square <= longest * longest:
        return force
    share: float = longest / square**0.5
    return tuple([share * component for component in force])
