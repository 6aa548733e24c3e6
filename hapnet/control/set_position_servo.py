"""PSPM and force of a device with a torque that is computed once per tick from encoder counts, and held.

The harvest is measured, or computed by (10), which then needs damping in the device itself. The continuous servo is in
continuous_servo.py.
"""

from __future__ import annotations

import math
from typing import Any, Literal

from hapnet.checks import Vector
from hapnet.control import ledger as ledgers
from hapnet.control.contact_equations import ContactState
from hapnet.control.contact_model import ContactModel
from hapnet.control.continuous_servo import Sender, choose, decide, parts_of, sent
from hapnet.control.coupling import TICK_SLACK_S, ForceParts, Update, ticks_before
from hapnet.control.harvest import MeasuredHarvest, by_range, hold, take
from hapnet.control.reserve import ForceGuard, Holding, HoldTime, admit, needed
from hapnet.control.set_position_coupling import SetPositionCoupling, potential, update
from hapnet.mechanics import spring as springs
from hapnet.mechanics.encoders import rounding
from hapnet.records.record import OfAxes, Reals, Record, equation
from hapnet.records.vectors import added, copy, distance, length

Harvest = Literal["range", "measured"]

RESTS, RUNS, SENDS, ASKS = range(4)
"""The result of a tick: PSPM did not run; it ran; it ran, and a sample is due; the caller must choose y first."""

ITSELF, ASKING, CHOSEN = range(3)
"""y is chosen by the tick itself; by its caller, which must still do it; by its caller, which has done it."""


class SampledServo(Record):
    """PSPM and force of a device with a torque that is held from tick to tick; its ledger is at the actuator's port.

    More than twenty attributes: limits, account and the path since the last tick decide what a held force costs.

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

    Attributes
    ----------
    held : the force that is held now [N]. commanded : the last force that the guard admitted [N].
    position, velocity : at the last tick [m], [m/s]. low, high : the position's extremes since PSPM last ran [m].
    measured : the harvest since PSPM last ran. ranged : whether the harvest is (10). potential : phi at that time [J].
    elapsed : time since PSPM last ran [s]. due : the time between two runs of PSPM [s].
    guarded : number of ticks in which the guard changed the force; clipped : whether it did since PSPM last ran.
    speed_max : maximum speed measured over a tick [m/s]; `rounding` is subtracted from the travel.
    before, torque_path, boundary : for `quantisation`: the force that was held before, the sum of its changes [N], and
        its maximum distance from the spring's force [N].
    shown : the position for which `commanded` was computed [m].
    longest : the longest time for which a force may be held [s], infinite without `holding`; later ticks are late.
    speed : the device's maximum speed, as declared [m/s].
    overrun_leak : energy that held torques output beyond the account while the servo was later than allowed [J].
    overrun_risk : the most energy that the device may have output beyond the account and taken back in between [J].
    follows, followed, before_J, least_J : whether a late tick's path is followed (then it has no risk), for how long so
        far [s], and P at its beginning and its smallest value since [J].
    wanted, pull, caused : temporary memory for forces.
    """

    n: int
    guard: ForceGuard
    measured: MeasuredHarvest
    sender: Sender
    due: float
    elapsed: float
    resolution: float
    rounding: float
    damping: OfAxes
    held: OfAxes
    commanded: OfAxes
    before: OfAxes
    velocity: OfAxes
    position: OfAxes
    low: OfAxes
    high: OfAxes
    ranged: int
    clipped: int
    potential: float
    torque_path: float
    boundary: float
    speed_max: float
    guarded: int
    longest: float
    speed: float
    overrun_leak: float
    overrun_risk: float
    follows: int
    followed: float
    before_J: float
    least_J: float
    shown: OfAxes
    wanted: OfAxes
    pull: OfAxes
    caused: OfAxes

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
        super().__init__()
        self.coupling = coupling
        self.n = n = len(position)
        self.due = period - TICK_SLACK_S
        self.sender = Sender(sending)
        self.model = model
        self.harvest = harvest
        self.ranged = int(harvest == "range")
        self.resolution, self.rounding = resolution, rounding(resolution, n)
        self.damping = list(damping)
        self.trusted_damping: Vector = trusted_damping or (0.0,) * n
        self.holding = holding
        self.force_ends_s: float = math.inf
        """Time without a command after which the device itself ends the force [s]; infinite: it does not."""
        self.guard = guard or ForceGuard()
        self.longest = math.inf if holding is None else holding.time * (1.0 + 1e-9) + 1e-9  # whole nanoseconds
        self.speed = 0.0 if holding is None else holding.speed
        self._hold_time = HoldTime(self.longest, math.inf if holding is None else holding.most)
        self.measured = MeasuredHarvest(self.trusted_damping, resolution)
        self.position, self.low, self.high, self.shown = [list(position) for _ in range(4)]
        for name in ("held", "commanded", "before", "velocity", "wanted", "pull", "caused"):
            setattr(self, name, [0.0] * n)
        self.potential = coupling.potential(position)
        self.limit_gifts()

    def limit_gifts(self) -> None:
        """From now on the coupling sends a new peer at most the energy that the held force can spare."""
        if self.guard.has_account:
            self.coupling.spare = self._spare

    @property
    def force(self) -> Vector:
        """The force held now [N]. A driver that measures the force really applied sets it before the next tick."""
        return tuple(self.held)

    @force.setter
    def force(self, force: Vector) -> None:
        self.held[:] = force

    @property
    def quantisation(self) -> float:
        """The largest error of the slack because positions are whole counts [J]: true slack below measured slack.

        On each axis the true position is within r/2 of the count. Summing the torque's work by parts, the difference is
        at most r/2 times the sum of all changes of the held torque, plus a term for the spring's curvature at the end.
        """
        r = self.resolution
        if r == 0.0:
            return 0.0
        path = self.torque_path + added([abs(one - other) for one, other in zip(self.held, self.before, strict=True)])
        boundary = max(self.boundary, unsprung(self, self.coupling))
        return float(r / 2.0 * (path + boundary) + r * r / 8.0 * self.coupling.spring.curvature_bound())

    @property
    def parts(self) -> ForceParts:
        """The parts of the force of the last tick."""
        x = tuple(self.position)
        spring = self.coupling.spring.force(self.coupling.set_position, x)
        damper = tuple([-b * v for b, v in zip(self.damping, self.velocity, strict=True)])
        return parts_of(self.coupling, self.model, x, spring, damper)

    def figures(self) -> dict[str, Any]:
        """The figures of the zero-order hold, by the summary's keys; empty if `holding` is unknown."""
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
        return account(self, self.coupling)

    def _spare(self) -> float:
        """Energy that the reservoir can spare while the present force stays held [J]."""
        return stored(self, self.coupling) - self.guard.needed(tuple(self.commanded))

    def tick(self, dt: float, x: Vector, v: Vector, *, release: bool = False) -> Update | None:
        """Do a tick `dt` seconds after the last at measured position x [m] and velocity v [m/s].

        Sets `force`; `release` sets it to zero (ybar = x). Returns what to send, if PSPM ran. The harvest up to a
        release is always measured, because (10) does not cover a torque held for so long.
        """
        coupling = self.coupling
        self.expect(dt)
        if release:
            hold_on(self, coupling, dt, x)
            coupling.release(x, take(self.measured, coupling.potential(x) - self.potential))
            end_held(self, coupling, x)
            self.stop()
        elif tick(self, coupling, self.model, dt, x, v, ITSELF) != SENDS:
            return None
        return sent(self.sender, coupling, x)

    def skippable_ticks(self, dt: float) -> int:
        """As `DeviceCoupling.skippable_ticks`: PSPM does not run in these ticks."""
        return 0 if self.coupling.has_sample else ticks_before(self.due, self.elapsed, dt)

    def follow(self, dt: float, x: Vector) -> None:
        """Account for further `dt` seconds in which a late servo held the force and the device moved to x [m]; for a
        device whose path is known. The `dt` of the next `tick` is nevertheless the time since the last tick."""
        follow(self, self.coupling, dt, x)

    def expect(self, dt: float) -> None:
        """Limit the force, `dt` seconds after the last tick: the account must pay for another overrun like the last."""
        if dt <= self.longest and self._hold_time.expected <= self.longest:
            return
        self._hold_time.tick(dt, min(dt, self.force_ends_s))
        late, holding = self._hold_time.expected > self.longest, self.holding
        self.guard.cover(holding.far_in(self._hold_time.expected) if late and holding is not None else 0.0)

    def stop(self) -> None:
        """Render no force from now until the next tick. The energy account stays correct."""
        if self.resolution:
            blur(self, self.coupling)
        for i in range(self.n):
            self.held[i] = self.commanded[i] = self.velocity[i] = 0.0
            self.shown[i] = self.position[i]


@equation
def move(servo: SampledServo, coupling: SetPositionCoupling, dt: float, x: Reals) -> None:
    """Account for `dt` seconds in which the force was held and the device moved to x [m]."""
    n, harvest = servo.n, servo.measured
    travel = distance(n, x, servo.position)
    if dt > 0.0 and travel > servo.speed_max * dt:
        servo.speed_max = max(servo.speed_max, (travel - servo.rounding) / dt)
    ledgers.put_in(coupling.ledger, hold(harvest, servo.held, servo.position, x, dt))
    copy(n, x, servo.position)
    if servo.ranged:
        for i in range(n):
            servo.low[i], servo.high[i] = min(servo.low[i], x[i]), max(servo.high[i], x[i])
    ledgers.observe(coupling.ledger, potential(coupling, x), account(servo, coupling))


@equation
def follow(servo: SampledServo, coupling: SetPositionCoupling, dt: float, x: Reals) -> None:
    """Account for further `dt` seconds of a late tick: `SampledServo.follow`."""
    if not servo.follows:
        servo.follows, servo.followed, servo.before_J, servo.least_J = 1, 0.0, stored(servo, coupling), math.inf
    move(servo, coupling, dt, x)
    servo.followed += dt
    servo.least_J = min(servo.least_J, stored(servo, coupling))


@equation
def come(servo: SampledServo, coupling: SetPositionCoupling, dt: float, x: Reals) -> None:
    """As `move`, for a tick that may be late: for the part of `dt` seconds that was not followed. Counts the output
    beyond the account."""
    if dt <= servo.longest and not servo.follows:
        move(servo, coupling, dt, x)
        return
    before, least = (servo.before_J, servo.least_J) if servo.follows else (stored(servo, coupling), math.inf)
    move(servo, coupling, dt - (servo.followed if servo.follows else 0.0), x)
    if dt > servo.longest:
        servo.overrun_leak += max(0.0, -min(least, stored(servo, coupling)) - max(0.0, -before))
        if not servo.follows:
            far = servo.speed * dt + servo.rounding
            servo.overrun_risk = max(servo.overrun_risk, length(servo.n, servo.held) * far - max(0.0, before))
    servo.follows = 0


@equation
def hold_on(servo: SampledServo, coupling: SetPositionCoupling, dt: float, x: Reals) -> bool:
    """Begin a tick, `dt` seconds after the last, and return whether PSPM runs in it."""
    servo.sender.sends = 0
    coupling.shuffled = 0.0
    if servo.resolution != 0.0:
        blur(servo, coupling)
    come(servo, coupling, dt, x)
    servo.elapsed += dt
    return coupling.has_sample != 0 or servo.elapsed >= servo.due


@equation
def tick(
    servo: SampledServo, coupling: SetPositionCoupling, model: ContactState | None, dt: float, x: Reals, v: Reals,
    who: int,
) -> int:  # fmt: skip
    """Do a tick without a release: `SampledServo.tick`. who : chooses y; after `ASKS`, call again with `CHOSEN`."""
    result = RESTS
    if who == CHOSEN or hold_on(servo, coupling, dt, x):
        if who == ASKING:
            return ASKS
        if who == ITSELF:
            choose(coupling, model, servo.n, servo.elapsed, x)
        keep = needed(servo.guard, length(servo.n, servo.commanded) - servo.guard.step)
        update(coupling, servo.elapsed, x, _dissipated(servo, coupling, x), keep)
        end_held(servo, coupling, x)
        result = SENDS if servo.sender.sends or coupling.shuffled != 0.0 else RUNS
    render(servo, coupling, x, v)
    return result


@equation
def account(servo: SampledServo, coupling: SetPositionCoupling) -> float:
    """The reservoir's content plus the harvest of the current interval [J]: `SampledServo.account`."""
    if servo.ranged:
        return coupling.account
    return coupling.account + (servo.measured.work - (potential(coupling, servo.position) - servo.potential))


@equation
def stored(servo: SampledServo, coupling: SetPositionCoupling) -> float:
    """P: energy in spring and reservoir now, with the harvest of the current interval [J]."""
    return coupling.account + servo.measured.work + servo.potential


@equation
def _dissipated(servo: SampledServo, coupling: SetPositionCoupling, x: Reals) -> float:
    """D since PSPM last ran [J]."""
    measured = take(servo.measured, potential(coupling, x) - servo.potential)
    if not servo.ranged:
        return measured
    if servo.clipped:  # the damper did not act in full
        servo.clipped = 0
        return 0.0
    return by_range(servo.n, servo.damping, servo.low, servo.high, servo.elapsed, servo.resolution)


@equation
def end_held(servo: SampledServo, coupling: SetPositionCoupling, x: Reals) -> None:
    """Begin the next interval after a run of PSPM."""
    decide(servo.sender, servo.elapsed)
    servo.potential = potential(coupling, x)
    servo.elapsed = 0.0
    copy(servo.n, x, servo.low)
    copy(servo.n, x, servo.high)
    ledgers.observe(coupling.ledger, servo.potential, coupling.account)


@equation
def render(servo: SampledServo, coupling: SetPositionCoupling, x: Reals, v: Reals) -> None:
    """Hold the force of spring and damper from now on, as limited by the guard."""
    n, guard, wanted, caused = servo.n, servo.guard, servo.wanted, servo.caused
    copy(n, v, servo.velocity)
    springs.force(coupling.modulator.spring, x, coupling.modulator.ybar, servo.pull)
    springs.force(coupling.modulator.spring, servo.shown, coupling.modulator.ybar, caused)
    for i in range(n):
        wanted[i] = servo.pull[i] - servo.damping[i] * v[i]
        caused[i] = servo.pull[i] - caused[i]
    copy(n, x, servo.shown)
    energy = stored(servo, coupling) if guard.has_account else math.inf
    if admit(guard, n, wanted, servo.commanded, caused, v, energy):
        servo.clipped = 1
        servo.guarded += 1
    copy(n, wanted, servo.held)
    copy(n, wanted, servo.commanded)


@equation
def blur(servo: SampledServo, coupling: SetPositionCoupling) -> None:
    """Add up the changes of the force: they bound the error of its work by encoder counts, see `quantisation`."""
    path = 0.0
    for i in range(servo.n):
        path += abs(servo.held[i] - servo.before[i])
    servo.torque_path += path
    servo.boundary = max(servo.boundary, unsprung(servo, coupling))
    copy(servo.n, servo.held, servo.before)


@equation
def unsprung(servo: SampledServo, coupling: SetPositionCoupling) -> float:
    """Distance between the force that is held and the spring's, summed over the axes [N]."""
    springs.force(coupling.modulator.spring, servo.position, coupling.modulator.ybar, servo.pull)
    total = 0.0
    for i in range(servo.n):
        total += abs(servo.held[i] - servo.pull[i])
    return total
