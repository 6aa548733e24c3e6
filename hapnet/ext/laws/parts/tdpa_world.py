"""The world's end of the coupling tdpa, and the observer of both its ends; tdpa.py explains the law."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hapnet.checks import Vector
from hapnet.control import prediction
from hapnet.control.coupling import CouplingSample, vector_of
from hapnet.control.law import WorldEnd
from hapnet.control.prediction import MotionPredictor
from hapnet.control.samples import PortSample
from hapnet.records.record import Floats, OfAxes, Reals, Record, compiled_as, equation
from hapnet.records.vectors import copy, dot, length

_RATE_S = 0.03
"""Time constant of the world's estimate of the device's velocity [s]; a typical world step."""
_MAX_S = 0.1
"""The longest extrapolation of the device's motion after its newest sample [s]."""


@dataclass(frozen=True)
class Tuning:
    """The parameters of both ends.

    debt_limit_J : D. stiffness_N_m, damping_Ns_m : K and B between the world's set-position and its mass.
    speed_limit_m_s : motion beyond it is made up for later.
    """

    stiffness_N_m: float
    damping_Ns_m: float
    velocity_floor_m_s: float
    force_floor_N: float
    damping_cap_Ns_m: float
    speed_limit_m_s: float
    debt_limit_J: float
    recovery_s: float = 0.0
    predicts: bool = False


class PassivityObserver(Record):
    """The account of a port: the energy that went in, and the debt: output beyond the input at the other port.

    Several peers may use a total one after the other, but no joule of it may be used twice. So E_in never restarts at
    zero, and the first total from a new peer grants nothing: later totals are counted from it. All energy granted to
    the old peer came before that first total. (The only exception would be a message older than the old peer's newest
    that was in flight while the new peer started and was paired.) This costs hardly anything: until a world has a
    sample of its device, it commands no displacement and has no force, so neither port has taken in energy yet. Only a
    device that joins a world with a stretched spring may lose some energy. Debt and credit remain when the peer
    changes, because that energy really came out or went in here. A side that ends leaves its debt unpaid, but every
    debt is bounded.

    Attributes
    ----------
    debt : E_out, less the energy that the controller dissipated, less the peers' E_in that was granted here [J].
        put_in : E_in [J]. newest : the peer's E_in [J], if it is `known`.
    """

    debt: float
    put_in: float
    newest: float
    known: int

    @equation
    def observe(self, given: float, dissipated: float) -> None:
        """Count a tick or a step: the energy that came out here, negative if it went in, and the part that the
        controller dissipated [J]."""
        if given > 0.0:
            self.debt += given
        else:
            self.put_in -= given
        self.debt -= dissipated

    @equation
    def receive(self, energy: float) -> None:
        """Take in the peer's E_in [J], in any order."""
        if not self.known:
            self.known, self.newest = 1, energy
        elif energy > self.newest:
            self.debt -= energy - self.newest
            self.newest = energy

    def on_peer_changed(self) -> None:
        """Start again with a new peer, which has its own count."""
        self.known = 0


@compiled_as(PassivityObserver.observe)
def observe(observer: PassivityObserver, given: float, dissipated: float) -> None:
    """Count a tick or a step, also for a subclass: `PassivityObserver.observe`."""
    observer.observe(given, dissipated)


@compiled_as(PassivityObserver.receive)
def grant(observer: PassivityObserver, energy: float) -> None:
    """Take in the peer's E_in [J]: `PassivityObserver.receive`."""
    observer.receive(energy)


class TdpaWorld(WorldEnd):
    """The world's end: a set-position that follows the device, and yields to the force as the account requires.

    Each step commands a displacement of y, from the goal of the previous step to the device's expected position at the
    end of this step, by its newest position, that position's age and the velocity. So a lost message loses no
    displacement, alternate steps of 10 and 50 ms cause no jerks, and steps shorter than the device's period continue
    between two messages. Displacement that y yields is lost (the known drift) unless `recovery` commands it again; the
    law as first published has no recovery.

    More than twenty attributes: six parameters, and two positions with their rates, ages and forces, of this end and of
    the device's newest message.

    position : (n,) the mass's position [m]; a device's first position counts as the same place.
    predictor : of the device's motion, from stamped positions; None: its velocity is estimated from arrivals here.

    Attributes
    ----------
    x, vhat : the mass's position [m], and its mean velocity over the last step [m/s]. force : in that step [N];
        ended : the spring's force at its end [N]. commanded : displacement of y in that step [m]; lost : displacement
        that was wanted, but not made [m].
    dt : length of that step [s]. share : s. used, age : the device's newest position [m], and its age [s], from the
        step that first used it; rate : the device's velocity [m/s]. goal : the goal of y in the last step [m].
    arrived, news : a position that no step has used yet [m], and whether there is one.
    """

    observer: PassivityObserver
    predictor: MotionPredictor
    predicts: int
    newest_age: float
    K: float
    B: float
    floor_square: float
    speed_limit: float
    debt_limit: float
    recovery: float
    x: OfAxes
    vhat: OfAxes
    force: OfAxes
    ended: OfAxes
    commanded: OfAxes
    lost: OfAxes
    dt: float
    share: float
    used: OfAxes
    age: float
    rate: OfAxes
    goal: OfAxes
    arrived: OfAxes
    news: int
    following: int
    whole: OfAxes
    ahead: OfAxes

    sends = PortSample

    def __init__(self, tuning: Tuning, position: Vector, predictor: MotionPredictor | None = None) -> None:
        super().__init__(position)
        self.observer = PassivityObserver()
        self.predicts = int(predictor is not None)
        if predictor is not None:
            self.predictor = predictor
            predictor.make_room(self.n)
        self.K, self.B = tuning.stiffness_N_m, tuning.damping_Ns_m
        self.floor_square = tuning.force_floor_N * tuning.force_floor_N
        self.speed_limit, self.debt_limit = tuning.speed_limit_m_s, tuning.debt_limit_J
        self.recovery = tuning.recovery_s
        for name in ("vhat", "commanded", "force", "ended", "lost", "rate", "whole", "ahead"):
            setattr(self, name, [0.0] * self.n)
        for name in ("x", "used", "goal", "arrived"):
            setattr(self, name, list(position))
        self.share = 1.0

    @property
    def drift(self) -> Vector:
        """Displacement commanded but not made by y [m]."""
        return tuple(self.lost)

    @equation
    def take(self, value: Reals, more: Reals, amount: float, total_s: float) -> None:
        """Take in the device's position and E_in."""
        copy(self.n, value, self.arrived)
        self.news = 1
        grant(self.observer, amount)

    def on_peer_changed(self) -> None:
        """Start again with another device, at its own position."""
        self.observer.on_peer_changed()
        self.predictor.reset()
        self.news = self.following = 0
        self.goal[:], self.rate[:] = self.used, [0.0] * self.n

    def stamped(self, sample: CouplingSample, sent_s: float, age_s: float) -> None:
        """Pass a sample to the predictor, as `CouplingState.receive`."""
        self.stamp(vector_of(sample), sent_s, age_s)

    @equation
    def stamp(self, value: Reals, sent_s: float, age_s: float) -> None:
        """Pass a position to the predictor."""
        if self.predicts:
            p = self.predictor
            prediction.note(p, self.n, value, sent_s)
            if p.count and sent_s == p.times[p.start + p.count - 1]:
                self.newest_age = age_s

    @equation
    def begin(self) -> None:
        """Begin a step with the newest position that has arrived."""
        self.age += self.dt
        if not self.news:
            return
        self.news = 0
        if self.following:
            gain = 1.0 / (_RATE_S + self.age)
            for i in range(self.n):
                rate = self.rate[i]
                self.rate[i] = rate + gain * (self.arrived[i] - self.used[i] - rate * self.age)
        else:
            self.following = 1
            copy(self.n, self.arrived, self.goal)
        copy(self.n, self.arrived, self.used)
        self.age = self.newest_age

    @equation
    def drag(self, dt: float) -> float:
        """Compute g = s a and p = s (a v_y + K (y - x))."""
        self.dt = dt
        _command(self, dt)
        a = self.B + 0.5 * self.K * dt
        self.share = _passive_share(self, a)
        for i in range(self.n):
            self.push[i] = self.share * _unyielding(self, i, a, 0.0)
        return self.share * a

    @equation
    def moved(self, dt: float, vhat: Reals, x: Reals, v: Reals) -> None:
        """Observe the completed step."""
        n, a, share = self.n, self.B + 0.5 * self.K * dt, self.share
        give = (1.0 - share) * dt / a  # s beta T
        yielded = self.ahead
        for i in range(n):
            whole = _unyielding(self, i, a, vhat[i])
            self.force[i], yielded[i] = share * whole, give * whole
        observe(self.observer, dot(n, self.force, self.commanded), dot(n, self.force, yielded))
        half = 0.5 * self.K  # to send the spring's force at the step's end, not its mean: half a step less delay
        for i in range(n):
            made = self.commanded[i] - yielded[i]
            self.y[i] = self.y[i] + made
            self.lost[i] = self.lost[i] + yielded[i]
            self.ended[i] = self.force[i] + half * (made - vhat[i] * dt)
        copy(n, x, self.x)
        copy(n, vhat, self.vhat)

    @equation
    def set_outgoing(self) -> None:
        """Write the force and E_in into `outgoing`."""
        copy(self.n, self.ended, self.outgoing.value)
        self.outgoing.amount = self.observer.put_in


@equation
def _command(law: TdpaWorld, dt: float) -> None:
    """Choose y's displacement, v_y T, within the limits of speed and debt."""
    n, ahead, commanded = law.n, law.ahead, law.commanded
    part = dt / (law.recovery + dt) if law.recovery != 0.0 else 0.0
    _reach(law, dt, ahead)
    for i in range(n):
        ahead[i] = ahead[i] - law.goal[i]
        commanded[i] = ahead[i] + part * law.lost[i]
    far, maximum = length(n, commanded), law.speed_limit * dt
    cut = 1.0 if far <= maximum else maximum / far
    debt = law.observer.debt
    share = cut if debt <= 0.0 else cut * max(0.0, 1.0 - debt / law.debt_limit)
    kept = 1.0 - cut * part
    for i in range(n):
        law.goal[i] = law.goal[i] + cut * ahead[i]
        law.lost[i] = kept * law.lost[i] + (cut - share) * commanded[i]
        commanded[i] = share * commanded[i]


@equation
def _reach(law: TdpaWorld, dt: float, out: Floats) -> None:
    """Compute the device's expected position at the end of a step of `dt` seconds [m]."""
    if law.predicts and law.following:
        prediction.predict(law.predictor, law.n, law.age + dt, out)
        return
    age = min(law.age + dt, _MAX_S)
    for i in range(law.n):
        out[i] = law.used[i] + law.rate[i] * age


@equation
def _unyielding(law: TdpaWorld, i: int, a: float, vhat: float) -> float:
    """f_1 of the step on axis i, if the mass moves with the velocity vhat there [N]."""
    return a * (law.commanded[i] / law.dt - vhat) + law.K * (law.y[i] - law.x[i])


@equation
def _passive_share(law: TdpaWorld, a: float) -> float:
    """The s that leaves no debt if the mass moves as in the last step; its real motion is observed afterwards.

    The larger root of s f_1.v_y T - s (1 - s) f_1^2 T/a = -debt, limited to 1/2 to 1.
    """
    n, expected = law.n, law.whole
    if dot(n, law.force, law.force) < law.floor_square:
        return 1.0
    for i in range(n):
        expected[i] = _unyielding(law, i, a, law.vhat[i])
    given = max(0.0, dot(n, expected, law.commanded))
    debt = law.observer.debt
    most = dot(n, expected, expected) * law.dt / a
    if given <= -debt or most == 0.0:
        return 1.0
    rest = most - given
    share = (rest + math.sqrt(max(0.0, rest * rest - 4.0 * most * debt))) / (2.0 * most)
    return max(0.5, share)
