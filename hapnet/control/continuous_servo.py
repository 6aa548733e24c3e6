"""PSPM for a device with a coupling (2) that acts continuously, also between ticks.

Only a simulated device can do this; it is the paper's device. It harvests by (10). If the actuators' limit acted, (10)
is not a lower bound, and it harvests the energy that the damper really dissipated.
"""

from __future__ import annotations

from collections.abc import Callable
from operator import sub

from hapnet.checks import Vector
from hapnet.control import contact_equations, ledger as ledgers
from hapnet.control.contact_equations import ContactState, share
from hapnet.control.contact_model import ContactModel
from hapnet.control.coupling import TICK_SLACK_S, ForceParts, PositionSample, Update, ticks_before
from hapnet.control.harvest import dissipated_by_range
from hapnet.control.set_position_coupling import SetPositionCoupling, potential, update
from hapnet.records.record import Reals, Record, compiled_as, equation
from hapnet.records.vectors import copy

Passage = Callable[[], tuple[Vector, Vector, float | None]]
"""Returns the extremes of the position since the last call [m], both ends included, and the energy that the damper
dissipated since then [J] if the actuators' limit kept it from acting in full; None if it acted in full."""


class ContinuousServo(Record):
    """PSPM for a device with a coupling that acts continuously between ticks.

    coupling : this side's set-position coupling.
    damping : B's diagonal [Ns/m].
    period : maximum time between two runs of PSPM [s]; it also runs on the first tick after a sample.
    sending : time between two samples sent [s]; 0: each run of PSPM sends one.
    model : the coupling's source, if it is a local contact model, for `parts`.

    Attributes
    ----------
    due : the longest time between two runs of PSPM [s]. elapsed : time since the last run [s]. The servo has no other
        state besides its coupling's and its sender's, so a batch may set it.
    """

    due: float
    elapsed: float
    sender: Sender

    def __init__(
        self,
        coupling: SetPositionCoupling,
        *,
        damping: Vector,
        period: float,
        sending: float = 0.0,
        model: ContactModel | None = None,
    ) -> None:
        super().__init__()
        self.coupling = coupling
        self._model = model
        self.damping = damping
        self.sender, self.due = Sender(sending), period - TICK_SLACK_S

    def tick(
        self, dt: float, x: Vector, passage: Passage, work: float, kinetic: float, *, release: bool = False
    ) -> Update | None:
        """Do a tick `dt` seconds after the last. Returns what to send, if PSPM ran.

        `release` releases the spring (ybar = x).
        The ledger is at the human's port: `work` is the energy that the hand put in during the tick [J], `kinetic` the
        device's kinetic energy now [J].
        """
        coupling = self.coupling
        if not (runs(self, coupling, dt, x, work, kinetic) or release):
            return None
        low, high, dissipated = passage()
        if dissipated is None:
            dissipated = dissipated_by_range(self.damping, low, high, self.elapsed)
        if release:
            coupling.release(x, dissipated)
            end(self, coupling, x, kinetic)
        else:
            run(self, coupling, self._model, x, dissipated, kinetic)
        return sent(self.sender, coupling, x)

    def skippable_ticks(self, dt: float) -> int:
        """Number of coming ticks, `dt` seconds apart, without PSPM if no sample arrives: each needs only `rest`."""
        return 0 if self.coupling.has_sample else ticks_before(self.due, self.elapsed, dt)

    def rest(self, dt: float, x: Vector, work: float, kinetic: float) -> None:
        """Keep the account, as every tick does first. The arguments are those of `tick`."""
        rest(self, self.coupling, dt, x, work, kinetic)

    def parts(self, x: Vector, force: Vector) -> ForceParts:
        """The parts of the device's force at x [N]; the force without the spring's part is the damper's."""
        spring = self.coupling.spring.force(self.coupling.set_position, x)
        return parts_of(self.coupling, self._model, x, spring, tuple(map(sub, force, spring)))


def parts_of(
    coupling: SetPositionCoupling, model: ContactModel | None, x: Vector, spring: Vector, damper: Vector
) -> ForceParts:
    """The parts of a force, given those of spring and damper."""
    of_planes, added = [0.0] * len(x), [0.0] * len(x)
    if model is not None:
        share(model, coupling.spring, x, coupling.set_position, of_planes, added)
    return ForceParts(spring, damper, tuple(of_planes), tuple(added))


class Sender(Record):
    """Decides which runs of PSPM send a sample; every run sends its energy.

    period : time between two samples [s]; 0: each run sends one.

    Attributes
    ----------
    sends : whether the last run sends one.
    """

    due: float
    elapsed: float
    sends: int

    def __init__(self, period: float) -> None:
        super().__init__()
        self.due = period - TICK_SLACK_S


@equation
def decide(sender: Sender, dt: float) -> None:
    """Decide, `dt` seconds after the last run of PSPM."""
    sender.elapsed += dt
    sender.sends = 0
    if sender.elapsed >= sender.due:
        sender.elapsed = 0.0
        sender.sends = 1


def sent(sender: Sender, coupling: SetPositionCoupling, x: Vector) -> Update | None:
    """The update that the last run of PSPM sends."""
    shuffled = coupling.shuffled
    if sender.sends:
        level = coupling.level
        return Update(x if level is None else PositionSample(x, level), shuffled)
    return Update(None, shuffled) if shuffled else None


@equation
def rest(
    servo: ContinuousServo, coupling: SetPositionCoupling, dt: float, x: Reals, work: float, kinetic: float
) -> None:
    """Keep the account, as every tick does first: `ContinuousServo.rest`."""
    servo.elapsed += dt
    ledgers.put_in(coupling.ledger, work)
    ledgers.observe(coupling.ledger, kinetic + potential(coupling, x), coupling.account)


@equation
def runs(
    servo: ContinuousServo, coupling: SetPositionCoupling, dt: float, x: Reals, work: float, kinetic: float
) -> bool:
    """Begin a tick, `dt` seconds after the last, and return whether PSPM runs in it."""
    rest(servo, coupling, dt, x, work, kinetic)
    servo.sender.sends = 0
    coupling.shuffled = 0.0
    return coupling.has_sample != 0 or servo.elapsed >= servo.due


@equation
def run(
    servo: ContinuousServo, coupling: SetPositionCoupling, model: ContactState | None, x: Reals, dissipated: float,
    kinetic: float,
) -> None:  # fmt: skip
    """Run PSPM, with D = `dissipated` [J]."""
    choose(coupling, model, coupling.modulator.spring.dof, servo.elapsed, x)
    update(coupling, servo.elapsed, x, dissipated, 0.0)
    end(servo, coupling, x, kinetic)


@equation
def end(servo: ContinuousServo, coupling: SetPositionCoupling, x: Reals, kinetic: float) -> None:
    """Update the account after a run of PSPM, and decide whether to send a sample."""
    decide(servo.sender, servo.elapsed)
    servo.elapsed = 0.0
    ledgers.observe(coupling.ledger, kinetic + potential(coupling, x), coupling.account)


def _compiled_choose(coupling: SetPositionCoupling, model: ContactState, n: int, dt: float, x: Reals) -> None:
    if model.in_use:
        contact_equations.step(model, n, dt, x, coupling.y)
    else:
        copy(n, coupling.received, coupling.y)


@compiled_as(_compiled_choose)
def choose(coupling: SetPositionCoupling, model: ContactState | None, n: int, dt: float, x: Reals) -> None:
    """Choose y for the next run, `dt` seconds after the last. In Python the coupling's source may be any object."""
    coupling.choose(dt, tuple(x))
