"""The device's side of the coupling, for the two kinds of servo.

Continuous: (2) acts within the tick, which only a simulated device can do. This is the paper's device. It harvests by
(10); where the actuators' limit acted, (10) is no lower bound, and it harvests what the damper really dissipated.
Sampled: the torque is computed once a tick from the encoders' counts and held, as on hardware. The harvest is measured,
or computed by (10), which then needs damping in the device itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from operator import mul, sub
from typing import Any, Final, Literal

from hapnet.checks import Vector
from hapnet.control.contact_model import ContactModel
from hapnet.control.coupling import ForceParts, Position, Update
from hapnet.control.harvest import MeasuredHarvest, dissipated_by_range
from hapnet.control.reserve import ForceGuard, Holding, HoldTime
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.control.ticks import TICK_SLACK_S, ticks_before
from hapnet.mechanics.encoders import rounding

Harvest = Literal["range", "measured"]
HARVESTS: tuple[Harvest, ...] = ("range", "measured")

Passage = Callable[[], tuple[Vector, Vector, float | None]]
"""Returns the extremes of the position since the last call [m], both ends included, and the energy that the damper
dissipated since then [J] if the actuators' limit kept it from acting in full; None if it acted in full."""


class ContinuousServo:
    """PSPM for a device whose coupling acts continuously between ticks.

    Parameters
    ----------
    coupling : this side's set-position coupling.
    damping : B's diagonal [Ns/m].
    period : longest time between two runs of PSPM [s]; it also runs on the first tick after a sample.
    sending : time between two samples sent [s]; 0: each run of PSPM sends one.
    model : the coupling's source, if it is a local contact model, for `parts`.
    """

    def __init__(
        self,
        coupling: SetPositionCoupling,
        *,
        damping: Vector,
        period: float,
        sending: float = 0.0,
        model: ContactModel | None = None,
    ) -> None:
        self.coupling = coupling
        self._model = model
        self.damping = damping
        self._sender = _Sender(sending)
        self.due: Final = period - TICK_SLACK_S
        """PSPM runs in the tick at which so much time has passed since it last ran [s]."""
        self.elapsed: float = 0.0
        """The time since PSPM last ran [s]. The servo has no other state but its coupling's, so a batch may set it."""

    def tick(
        self, dt: float, x: Vector, passage: Passage, work: float, kinetic: float, *, release: bool = False
    ) -> Update | None:
        """A tick `dt` seconds after the last. Returns what to send, if PSPM ran.

        `release` lets the spring go (ybar = x).
        The ledger is at the human's port: `work` is the energy that the hand put in during the tick [J], `kinetic` the
        device's kinetic energy now [J].
        """
        self.rest(dt, x, work, kinetic)
        coupling, elapsed = self.coupling, self.elapsed
        if elapsed < self.due and not coupling.has_sample and not release:
            return None
        low, high, dissipated = passage()
        if dissipated is None:
            dissipated = dissipated_by_range(self.damping, low, high, elapsed)
        result = coupling.release(x, dissipated) if release else coupling.update(elapsed, x, dissipated)
        self.elapsed = 0.0
        coupling.ledger.observe(kinetic + coupling.potential(x), coupling.account)
        return self._sender.update(elapsed, x, result.sent, coupling.level)

    def resting(self, dt: float) -> int:
        """Number of coming ticks, `dt` seconds apart, without PSPM if no sample arrives: each needs only `rest`."""
        return 0 if self.coupling.has_sample else ticks_before(self.due, self.elapsed, dt)

    def rest(self, dt: float, x: Vector, work: float, kinetic: float) -> None:
        """Keep the account, as every tick does first. The arguments are those of `tick`."""
        self.elapsed += dt
        coupling = self.coupling
        ledger = coupling.ledger
        ledger.put_in(work)
        stored = kinetic + coupling.spring.between(coupling.modulator.set_position, x)
        ledger.observe(stored, coupling.account)

    def parts(self, x: Vector, force: Vector) -> ForceParts:
        """What the device's force at x is made of [N]; what the spring does not give is the damper's."""
        spring = self.coupling.spring.force(self.coupling.set_position, x)
        return _parts(self.coupling, self._model, x, spring, tuple(map(sub, force, spring)))


def _parts(
    coupling: SetPositionCoupling, model: ContactModel | None, x: Vector, spring: Vector, damper: Vector
) -> ForceParts:
    """The parts of a force; where the spring is saturated, its own parts shrink with it."""
    if model is None:
        nothing = (0.0,) * len(x)
        return ForceParts(spring, damper, nothing, nothing)
    stiffness = coupling.spring
    scale = stiffness.saturation(tuple(map(sub, x, coupling.set_position)))
    rows = stiffness.K.tolist()
    of_planes, added = (
        tuple([scale * sum(map(mul, row, share)) for row in rows])
        for share in (model.planes_share, model.damping_share)
    )
    return ForceParts(spring, damper, of_planes, added)


class _Sender:
    """Decides which runs of PSPM send a sample, if not every one does; all of them send their energy."""

    __slots__ = ("_due", "_elapsed")

    def __init__(self, period: float) -> None:
        self._due = period - TICK_SLACK_S
        self._elapsed = 0.0

    def update(self, dt: float, x: Vector, shuffled: float, level: float | None) -> Update | None:
        """What to send, `dt` seconds after the last run of PSPM. level : of the reservoir; None: it is not told."""
        self._elapsed += dt
        if self._elapsed >= self._due:
            self._elapsed = 0.0
            return Update(x if level is None else Position(x, level), shuffled)
        return Update(None, shuffled) if shuffled else None


class SampledServo:
    """PSPM and force of a device whose torque is held from tick to tick; its ledger is at the actuator's port.

    More than twenty attributes: what a held force may cost follows from the limits, the path since the last tick and
    the account together, and each tick changes all of them.

    Parameters
    ----------
    coupling, damping, period, sending, model : as in `ContinuousServo`.
    harvest : "measured" (default) or "range".
    trusted_damping : lower bound of the device's own damping on each axis, harvested too with "measured" [Ns/m].
    guard : limits the force, with "measured" also to what the account can cover; the spring should saturate a little
        below the guard's limit.
    holding : the values that the guard was computed from; None: unknown.
    resolution : of the encoders [m].
    position : the first measured position [m].
    """

    def __init__(
        self,
        coupling: SetPositionCoupling,
        *,
        damping: Vector,
        period: float,
        sending: float = 0.0,
        model: ContactModel | None = None,
        position: Vector,
        harvest: Harvest = "measured",
        trusted_damping: Vector | None = None,
        guard: ForceGuard | None = None,
        holding: Holding | None = None,
        resolution: float = 0.0,
    ) -> None:
        self.coupling = coupling
        self.damping = damping
        self._due = period - TICK_SLACK_S
        self._sender = _Sender(sending)
        self._model = model
        self.harvest = harvest
        self.resolution = resolution
        self.force: Vector = (0.0,) * len(position)
        """The force held now [N]. A driver that knows the force really applied sets it before the next tick."""
        self.trusted_damping: Vector = trusted_damping or self.force
        self.holding = holding
        self.speed_max: float = 0.0
        """Greatest speed measured over one tick [m/s]; one encoder count is taken off the travel."""
        self.overrun_leak: float = 0.0
        """Energy that held torques output beyond the account while the servo was late for too long [J]."""
        self.overrun_risk: float = 0.0
        """The most that may have been output beyond the account meanwhile and taken back unseen [J]; 0 where the way
        is known, see `follow`."""
        self.force_ends_s: float = math.inf
        """The device ends the force by itself when no command has come for so long [s]; infinite: it does not."""
        self.guarded: int = 0
        """Number of ticks whose force the guard changed."""
        self._guard = guard or ForceGuard()
        self._longest_hold = math.inf if holding is None else holding.time * (1.0 + 1e-9) + 1e-9  # whole nanoseconds
        self._hold_time = HoldTime(self._longest_hold, math.inf if holding is None else holding.most)
        self._followed: tuple[float, float, float] | None = None  # for how long, P then, and the least P since
        self._measured = MeasuredHarvest(self.trusted_damping, resolution)
        self._position = position
        self._low = self._high = position
        self._elapsed = 0.0
        self._clipped = False
        self._commanded = self._before = self._velocity = self.force
        self._potential = coupling.potential(position)
        self._torque_path = 0.0
        self._boundary = 0.0
        if self._guard.has_account:
            coupling.spare = self._spare

    @property
    def quantisation(self) -> float:
        """How far the true slack can lie below the measured one, because positions are whole counts [J].

        On each axis the true position is within r/2 of the count. Summing the torque's work by parts, the difference is
        at most r/2 times the sum of all changes of the held torque, plus a term for the spring's curvature at the end.
        """
        r = self.resolution
        if r == 0.0:
            return 0.0
        path = self._torque_path + sum(map(abs, map(sub, self.force, self._before)))
        boundary = max(self._boundary, self._unsprung())
        blur: float = r / 2.0 * (path + boundary) + r * r / 8.0 * self.coupling.spring.curvature_bound()
        return blur

    @property
    def parts(self) -> ForceParts:
        """What the force of the last tick is made of."""
        x = self._position
        spring = self.coupling.spring.force(self.coupling.set_position, x)
        damper = tuple([-b * v for b, v in zip(self.damping, self._velocity, strict=True)])
        return _parts(self.coupling, self._model, x, spring, damper)

    def figures(self) -> dict[str, Any]:
        """What is known about the held forces, by the summary's keys; empty if `holding` is unknown."""
        if self.holding is None:
            return {}
        return {
            "reserve_J": self.holding.reserve,
            "reserve_needed_J": self.holding.needed,
            "overrun_leak_J": self.overrun_leak,
            "overrun_risk_J": self.overrun_risk,
            "speed_max_mps": self.speed_max,
            "speed_limit_mps": self.holding.speed,
            "guarded_ticks": self.guarded,
        }

    @property
    def account(self) -> float:
        """The reservoir's content plus the harvest of the current interval [J], as the ledger counts it."""
        return self.coupling.account + self._pending

    @property
    def _pending(self) -> float:
        """Harvest of the current interval, not yet in the reservoir [J]."""
        if self.harvest == "range":
            return 0.0
        pending: float = self._measured.work - (self.coupling.potential(self._position) - self._potential)
        return pending

    @property
    def _stored(self) -> float:
        """P: energy in spring and reservoir now, with the harvest of the current interval [J]."""
        stored: float = self.coupling.account + self._measured.work + self._potential
        return stored

    def _spare(self) -> float:
        """Energy that the reservoir can spare while the present force stays held [J]."""
        return self._stored - self._guard.needed(self._commanded)

    def tick(self, dt: float, x: Vector, v: Vector, *, release: bool = False) -> Update | None:
        """A tick `dt` seconds after the last at measured position x [m] and velocity v [m/s].

        Sets `force`; `release` sets it to zero (ybar = x). Returns what to send, if PSPM ran. The harvest up to a
        release is always measured, because (10) does not account for a torque held for so long.
        """
        coupling, ledger = self.coupling, self.coupling.ledger
        if dt > self._longest_hold or self._hold_time.expected > self._longest_hold:
            self._expect(dt)
        if self.resolution:
            self._blur()
        if dt > self._longest_hold or self._followed is not None:
            self._overrun(dt, x)
        else:
            self._move(dt, x)
        self._elapsed += dt
        update = None
        if coupling.has_sample or self._elapsed >= self._due or release:
            if release:
                result = coupling.release(x, self._measured_now(x))
            else:
                keep = self._guard.needed_after(self._commanded)
                result = coupling.update(self._elapsed, x, self._dissipated(x), keep)
            update = self._sender.update(self._elapsed, x, result.sent, coupling.level)
            self._potential = coupling.potential(x)
            self._elapsed = 0.0
            self._low = self._high = x
            ledger.observe(self._potential, coupling.account)
        if release:
            self.stop()
        else:
            self._render(x, v)
        return update

    def resting(self, dt: float) -> int:
        """As `DeviceCoupling.resting`: PSPM does not run in these ticks."""
        return 0 if self.coupling.has_sample else ticks_before(self._due, self._elapsed, dt)

    def follow(self, dt: float, x: Vector) -> None:
        """The device has come to x [m] in further `dt` seconds, under the force that is held, while the servo is late.

        For a device whose way is known. The next `tick` gets the time since the last tick all the same.
        """
        since, before, least = self._followed or (0.0, self._stored, math.inf)
        self._move(dt, x)
        self._followed = since + dt, before, min(least, self._stored)

    def _move(self, dt: float, x: Vector) -> None:
        """Account for `dt` seconds in which the force was held and the device came to x [m]."""
        coupling, measured = self.coupling, self._measured
        travel = math.dist(x, self._position)
        if dt > 0.0 and travel > self.speed_max * dt:
            self.speed_max = max(self.speed_max, (travel - rounding(self.resolution, len(x))) / dt)
        coupling.ledger.put_in(measured.hold(self.force, self._position, x, dt))
        self._position = x
        potential, account = coupling.potential(x), coupling.account
        if self.harvest == "measured":
            account += measured.work - (potential - self._potential)
        else:
            self._low = tuple(map(min, self._low, x))
            self._high = tuple(map(max, self._high, x))
        coupling.ledger.observe(potential, account)

    def _overrun(self, dt: float, x: Vector) -> None:
        """As `_move`, after `dt` seconds of which `follow` told a part; counts what was output beyond the account."""
        followed, before, least = self._followed or (0.0, self._stored, math.inf)
        self._move(dt - followed, x)
        if dt > self._longest_hold and self.holding is not None:
            self.overrun_leak += max(0.0, -min(least, self._stored) - max(0.0, -before))
            if self._followed is None:
                far = self.holding.speed * dt + rounding(self.resolution, len(x))
                self.overrun_risk = max(self.overrun_risk, math.hypot(*self.force) * far - max(0.0, before))
        self._followed = None

    def _expect(self, dt: float) -> None:
        """Limit the force to what the account can pay for through another absence like those before."""
        self._hold_time.tick(dt, min(dt, self.force_ends_s))
        late = self.holding is not None and self._hold_time.expected > self._longest_hold
        self._guard.cover(self.holding.far_in(self._hold_time.expected) if late and self.holding is not None else 0.0)

    def _measured_now(self, x: Vector) -> float:
        return self._measured.take(self.coupling.potential(x) - self._potential)

    def _dissipated(self, x: Vector) -> float:
        if self.harvest == "measured":
            return self._measured_now(x)
        self._measured.take(0.0)
        if self._clipped:  # the damper did not act in full
            self._clipped = False
            return 0.0
        return dissipated_by_range(self.damping, self._low, self._high, self._elapsed, self.resolution)

    def _render(self, x: Vector, v: Vector) -> None:
        self._velocity = v
        spring = self.coupling.spring.force(self.coupling.set_position, x)
        wanted = tuple(map(sub, spring, map(mul, self.damping, v)))
        energy = math.inf
        if self._guard.has_account:
            energy = self.coupling.account + self._measured.work + self._potential
        force = self._guard.admit(wanted, self._commanded, v, energy)
        if force is not wanted:
            self._clipped = True
            self.guarded += 1
        self.force = self._commanded = force

    def _blur(self) -> None:
        """Add up the changes of the held force: they bound how far encoders blur its work, see `quantisation`."""
        self._torque_path += sum(map(abs, map(sub, self.force, self._before)))
        self._boundary = max(self._boundary, self._unsprung())
        self._before = self.force

    def _unsprung(self) -> float:
        """Distance between the held force and the spring's, summed over the axes [N]."""
        spring = self.coupling.spring.force(self.coupling.set_position, self._position)
        distance: float = sum(map(abs, map(sub, self.force, spring)))
        return distance

    def stop(self) -> None:
        """Render no force from now until the next tick. The energy account stays correct."""
        if self.resolution:
            self._blur()
        self.force = self._commanded = self._velocity = (0.0,) * len(self.force)
