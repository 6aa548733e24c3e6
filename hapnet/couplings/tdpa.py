"""Two-port time-domain passivity (J.-H. Ryu, J. Artigas, C. Preusche, Mechatronics 20, 2010), with a slow world.

The published law drifts with every contact, so the default adds drift compensation, as later work on this law does. A
recovery of 0 turns it off.

The device sends its position. The world sends the force of a spring and damper between the virtual mass and a
set-position y that moves as the device does. With reaction f at the device's velocity v, and f_c at the set-position's
velocity v_y, the power into the two-port is P = f.v at the device and P = -f_c.v_y at the world. An observer at each
port sums P by its sign, and each side sends its E_in with its samples:

    P > 0: E_in += T P,    else E_out -= T P

Energy that comes out at one port must have gone in at the other. Otherwise the port's controller damps or yields:

    device: E_out^d <= E_in^w,    f <- f + alpha v,        alpha = (E_out^d - E_in^w) / (T v^2)
    world:  E_out^w <= E_in^d,    v_y <- v_y - beta f_c,   beta = (E_out^w - E_in^d) / (T f_c^2)

E_in only grows, so the largest value that arrived is a safe bound, whatever the link loses or reorders. The energy that
the controllers really dissipated is subtracted from E_out; what floors and caps kept them from dissipating stays as a
debt. P is the power of all axes together, with one alpha and one beta, so the account is the same in any coordinates.

Derived here, for steps of any length: within a step beta acts at once. With a = B + K T/2, and y - x at its start,

    f_c = s f_1,    f_1 = a (v_y - vhat) + K (y - x),    s = 1/(1 + a beta)

This is a damper 1/beta in series with the coupling, passive for any T. It dissipates s (1 - s) f_1^2 T/a, the most at
s = 1/2: a larger beta dissipates no more, so this is its cap. Floors and caps must not let a debt grow: the device's f
and the world's v_y fade as it grows, and are zero at its limit D. So no port ever owes more than D plus the work of one
held force, and the energy put in at both ports together never falls below minus the sum of the two debts.

The controllers stand last at both ports and count what really comes out. So the world may command any displacement
(Ryu, Artigas, Preusche 2010): with `tdpa.predict` one that leads to where the device will be, delay included. The
energy of that motion arrives a delay later, so the controller yields more in contact: it becomes freer, and softer. By
default the law only continues the newest position by its own estimate of the velocity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from math import hypot, sqrt
from operator import add, neg, sub

import numpy as np

from hapnet.checks import Vector
from hapnet.control.coupling import CouplingSample, LawSteps, Port, WorldCoupling, vector_of
from hapnet.control.prediction import MotionPredictor
from hapnet.couplings import feel
from hapnet.couplings.ends import held_law
from hapnet.couplings.link_delays import Delays
from hapnet.couplings.spec import RENDERED_DAMPING, Between, CouplingSpec, CouplingStart, scalar_stiffness
from hapnet.param_values import NOT_NEGATIVE, POSITIVE, Range, parameter
from hapnet.params import Params
from hapnet.records.vectors import inner
from hapnet.wire import messages

_RATE_S = 0.03
"""Time constant of the world's estimate of the device's velocity [s]; a typical world step."""
_LONGEST_S = 0.1
"""The device's motion is extrapolated for no longer than this after its newest sample [s]."""


@dataclass(frozen=True)
class TdpaParams:
    """Two-port time-domain passivity (Ryu, Artigas, Preusche 2010), with drift compensation."""

    stiffness: float = parameter(
        0.0, "stiffness of the virtual coupling at the world [N/m]; 0: device.stiffness", NOT_NEGATIVE
    )
    damping: float = parameter(0.0, "damping of that coupling [Ns/m]; 0: by a rule", NOT_NEGATIVE)
    velocity_floor: float = parameter(
        0.002, "the device's controller cannot damp below this speed [m/s]", Range(0.0, at_most=1.0)
    )
    force_floor: float = parameter(0.05, "the world's controller cannot yield below this force [N]", POSITIVE)
    damping_cap: float = parameter(0.0, "the most damping at the device [Ns/m]; 0: by a rule", NOT_NEGATIVE)
    speed_limit: float = parameter(0.25, "greatest speed of the world's set-position [m/s]", Range(0.0, at_most=100.0))
    debt_limit_J: float = parameter(0.02, "a side that owes this much energy gives out no more [J]", POSITIVE)
    predict: bool = parameter(False, "the world predicts the device by the delay, unless the feel is paper")
    recovery_s: float = parameter(
        0.02,
        "time constant of the drift compensation, as far as there is energy [s]; 0: none, as first published",
        NOT_NEGATIVE,
    )


@dataclass(frozen=True)
class Tuning:
    """The parameters of both ends, each chosen.

    debt_limit_J : D. stiffness_N_m, damping_Ns_m : K and B between the world's set-position and its mass. What exceeds
    speed_limit_m_s follows later.
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


class PassivityObserver:
    """The account of one port: the energy that went in, and its debt, output beyond what went in at the other port.

    Several peers may use a total one after the other, but no joule of it may be used twice. So E_in never starts at
    zero again, and the first total from a new peer grants nothing: later totals are counted from it. All that the old
    peer was granted came before that first total. (The only exception would be a message older than the old peer's
    newest that was in flight while the new peer started and shook hands.) This costs hardly anything: until a world has
    a sample of its device, it commands no displacement and makes no force, so neither port has taken in energy yet.
    Only a device that joins a world whose spring is tense may lose some. Debt and credit stay when the peer changes,
    because that energy really came out or went in here. A side that ends leaves its debt unpaid, and every debt is
    bounded.
    """

    def __init__(self) -> None:
        self.debt: float = 0.0
        """E_out, less what the controller dissipated, less the peers' E_in that was granted here [J]."""
        self.put_in: float = 0.0
        """E_in [J]."""
        self._newest: float | None = None

    def observe(self, given: float, dissipated: float) -> None:
        """Count a tick or a step: the energy that came out here, negative if it went in, and what the controller
        dissipated of it [J]."""
        if given > 0.0:
            self.debt += given
        else:
            self.put_in -= given
        self.debt -= dissipated

    def receive(self, energy: float) -> None:
        """The peer's E_in [J], in any order."""
        if self._newest is None:
            self._newest = energy
        elif energy > self._newest:
            self.debt -= energy - self._newest
            self._newest = energy

    def on_peer_changed(self) -> None:
        """A new peer, with its own count, has replaced the old one."""
        self._newest = None


class TdpaDevice:
    """The device's end: it renders the world's reaction, plus the damping that the account demands.

    position : (n,) the device's position [m].
    """

    def __init__(self, tuning: Tuning, position: Vector) -> None:
        self.observer: PassivityObserver = PassivityObserver()
        self._x = position
        self._compliance = 1.0 / tuning.stiffness_N_m
        self._force = self._damper = self._none = (0.0,) * len(position)
        self._floor_square = tuning.velocity_floor_m_s * tuning.velocity_floor_m_s
        self._cap = tuning.damping_cap_Ns_m
        self._debt_limit = tuning.debt_limit_J

    @property
    def set_position(self) -> Vector:
        """x - f/K [m]: a spring K tied there would make the world's reaction. The world sends no position."""
        return tuple([x + self._compliance * f for x, f in zip(self._x, self._force, strict=True)])

    def receive(self, sample: CouplingSample) -> None:
        assert isinstance(sample, Port)
        self._force = tuple(map(neg, sample.value))
        self.observer.receive(sample.energy)

    def on_peer_changed(self) -> None:
        self.observer.on_peer_changed()
        self._force = self._none

    def force(self, dt: float, x: Vector, v: Vector, held: Vector) -> Vector:
        """See `DeviceLaw.force`: -(f + alpha v)."""
        self._settle(x, held)
        self._damper = self._none
        debt = self.observer.debt
        if debt <= 0.0:
            return self._force
        share = max(0.0, 1.0 - debt / self._debt_limit)
        square = inner(v, v)
        if square < self._floor_square:
            return tuple([share * f for f in self._force])
        alpha = min(self._cap, debt / (dt * square))
        self._damper = tuple([-alpha * u for u in v])
        return tuple([share * f - alpha * u for f, u in zip(self._force, v, strict=True)])

    def next_sample(self, x: Vector, v: Vector) -> CouplingSample:
        return Port(x, self.observer.put_in)

    def release(self, dt: float, x: Vector, held: Vector) -> None:
        self._settle(x, held)
        self._damper = self._none

    def _settle(self, x: Vector, held: Vector) -> None:
        """Observe the force held since the last tick, exactly: its whole work, and the damper's share separately."""
        way = tuple(map(sub, x, self._x))
        self._x = x
        damped = -inner(self._damper, way)
        self.observer.observe(inner(held, way) + damped, damped)


class TdpaWorld:
    """The world's end: a set-position that moves as the device does, and yields to the force as the account demands.

    Each step commands a displacement: from where the previous step should have brought y to where the device will be at
    the end of this step, by its newest position, that position's age and its velocity. So a lost message loses no
    displacement, alternate steps of 10 and 50 ms cause no jerks, and steps shorter than the device's period continue
    between two messages. What y yields is lost (the known drift) unless `recovery` commands it again; the law as first
    published has no recovery.

    More than twenty attributes: six parameters, and two positions with their rates, ages and forces, of this end and of
    the device's newest message.

    Parameters
    ----------
    position : (n,) the mass's position [m]; a device's first position counts as the same place.
    predictor : of the device's motion, from stamped positions; None: its velocity is taken from what comes here.
    """

    def __init__(self, tuning: Tuning, position: Vector, predictor: MotionPredictor | None = None) -> None:
        self._predictor = predictor
        self._newest_age = 0.0
        self.observer: PassivityObserver = PassivityObserver()
        self._K, self._B = tuning.stiffness_N_m, tuning.damping_Ns_m
        self._floor_square = tuning.force_floor_N * tuning.force_floor_N
        self._speed_limit = tuning.speed_limit_m_s
        self._debt_limit = tuning.debt_limit_J
        self._recovery = tuning.recovery_s
        self._x = self._y = position
        self._none = self._vhat = self._way = self._force = self._end_force = self._drift = (0.0,) * len(position)
        self._dt = self._age = 0.0  # step length; age of the newest position, from the step that first used it
        self._share = 1.0
        self._arrived: Vector | None = None
        self._following = False
        self._used = self._goal = position  # the device's newest position; where the last step should have brought y
        self._rate = self._none

    @property
    def set_position(self) -> Vector:
        """y [m]."""
        return self._y

    @property
    def drift(self) -> Vector:
        """Displacement commanded but not made by y [m]."""
        return self._drift

    def receive(self, sample: CouplingSample) -> None:
        assert isinstance(sample, Port)
        self._arrived = sample.value
        self.observer.receive(sample.energy)

    def on_peer_changed(self) -> None:
        self.observer.on_peer_changed()
        if self._predictor is not None:
            self._predictor.reset()
        self._arrived, self._following = None, False
        self._goal, self._rate = self._used, self._none

    def stamped(self, sample: CouplingSample, sent_s: float, age_s: float) -> None:
        """A sample for the predictor, as `CouplingState.receive`."""
        if self._predictor is not None:
            self._predictor.receive(vector_of(sample), sent_s)
            if sent_s == self._predictor.newest_s:
                self._newest_age = age_s

    def begin(self) -> None:
        self._age += self._dt
        arrived, self._arrived = self._arrived, None
        if arrived is None:
            return
        if self._following:
            age = self._age
            gain = 1.0 / (_RATE_S + age)
            ways = zip(self._rate, arrived, self._used, strict=True)
            self._rate = tuple([rate + gain * (now - before - rate * age) for rate, now, before in ways])
        else:
            self._following = True
            self._goal = arrived
        self._used, self._age = arrived, self._newest_age

    def impedance(self, dt: float) -> tuple[float, Vector]:
        """See `WorldLaw.impedance`: g = s a, p = s (a v_y + K (y - x))."""
        self._dt = dt
        self._command(dt)
        a = self._B + 0.5 * self._K * dt
        share = self._share = self._passive_share(a)
        return share * a, tuple([share * f for f in self._unyielding(a, self._none)])

    def moved(self, dt: float, vhat: Vector, x: Vector, v: Vector) -> None:
        """See `WorldLaw.moved`: observe the completed step."""
        a, share = self._B + 0.5 * self._K * dt, self._share
        whole = self._unyielding(a, vhat)
        self._force = force = tuple([share * f for f in whole])
        give = (1.0 - share) * dt / a  # s beta T
        yielded = tuple([give * f for f in whole])
        self.observer.observe(inner(force, self._way), inner(force, yielded))
        moved = tuple(map(sub, self._way, yielded))
        self._y = tuple(map(add, self._y, moved))
        self._drift = tuple(map(add, self._drift, yielded))
        self._x, self._vhat = x, vhat
        half = 0.5 * self._K  # sends the spring's force at the step's end, not its mean: half a step less delay
        self._end_force = tuple([f + half * (w - u * dt) for f, w, u in zip(force, moved, vhat, strict=True)])

    def next_sample(self) -> CouplingSample:
        return Port(self._end_force, self.observer.put_in)

    def _command(self, dt: float) -> None:
        """Choose y's displacement, v_y T, within the limits of speed and debt."""
        goal, drift = self._goal, self._drift
        part = dt / (self._recovery + dt) if self._recovery else 0.0
        ahead = tuple(map(sub, self._reached(dt), goal))
        way = [w + part * lost for w, lost in zip(ahead, drift, strict=True)]
        far, longest = hypot(*way), self._speed_limit * dt
        cut = 1.0 if far <= longest else longest / far
        debt = self.observer.debt
        share = cut if debt <= 0.0 else cut * max(0.0, 1.0 - debt / self._debt_limit)
        self._goal = tuple([before + cut * w for before, w in zip(goal, ahead, strict=True)])
        self._way = tuple([share * w for w in way])
        kept = 1.0 - cut * part
        self._drift = tuple([kept * lost + (cut - share) * w for lost, w in zip(drift, way, strict=True)])

    def _reached(self, dt: float) -> Vector:
        """Where the device will be at the end of a step of `dt` seconds [m]."""
        if self._predictor is not None and self._following:
            return self._predictor.at(self._age + dt)[0]
        age = min(self._age + dt, _LONGEST_S)
        return tuple([at + rate * age for at, rate in zip(self._used, self._rate, strict=True)])

    def _unyielding(self, a: float, vhat: Vector) -> list[float]:
        """f_1 of the step, if the mass moves with vhat [N]."""
        K, dt = self._K, self._dt
        rows = zip(self._way, vhat, self._y, self._x, strict=True)
        return [a * (way / dt - u) + K * (y - x) for way, u, y, x in rows]

    def _passive_share(self, a: float) -> float:
        """s that leaves no debt if the mass moves as in the last step; how it really moves is observed afterwards.

        The larger root of s f_1.v_y T - s (1 - s) f_1^2 T/a = -debt, limited to 1/2 to 1.
        """
        if inner(self._force, self._force) < self._floor_square:
            return 1.0
        expected = self._unyielding(a, self._vhat)
        given = max(0.0, inner(expected, self._way))
        debt = self.observer.debt
        most = inner(expected, expected) * self._dt / a
        if given <= -debt or most == 0.0:
            return 1.0
        rest = most - given
        share: float = (rest + sqrt(max(0.0, rest * rest - 4.0 * most * debt))) / (2.0 * most)
        return max(0.5, share)


def tune(params: Params, link: Delays) -> Tuning:
    """Choose the damping that damps the heaviest axis of the virtual mass critically, as far as the device renders it.

    alpha is at most what the device renders, and at most m/T, which stops the device within a tick: a stronger held
    damper would reverse it. The link's delays do not matter.
    """
    chosen, device = params.of(TdpaParams), params.device
    K = chosen.stiffness or scalar_stiffness(params)
    mass = np.asarray(params.world.mass)
    heaviest = float(np.linalg.norm(mass, 2) if mass.ndim == 2 else mass.max())
    return Tuning(
        stiffness_N_m=K,
        damping_Ns_m=chosen.damping or min(2.0 * math.sqrt(K * heaviest), RENDERED_DAMPING),
        velocity_floor_m_s=chosen.velocity_floor,
        force_floor_N=chosen.force_floor,
        damping_cap_Ns_m=chosen.damping_cap or min(RENDERED_DAMPING, device.mass * device.servo_hz),
        speed_limit_m_s=chosen.speed_limit,
        debt_limit_J=chosen.debt_limit_J,
        recovery_s=chosen.recovery_s,
        predicts=chosen.predict and params.feel != "paper",
    )


def _device(start: CouplingStart[Tuning]) -> TdpaDevice:
    return TdpaDevice(start.tuning, start.position)


def _world(start: CouplingStart[Tuning]) -> WorldCoupling:
    predictor = feel.predictor(start.params) if start.tuning.predicts else None
    law = TdpaWorld(start.tuning, start.position, predictor)
    return LawSteps(law, start.initial_energy, law.stamped)


LAW = CouplingSpec(
    name="tdpa",
    title="two-port time-domain passivity",
    source="Ryu, Artigas, Preusche 2010, with drift compensation",
    claim="passive at both ports, whatever the link does, except for a bounded debt; without compensation it drifts",
    device=held_law(_device),
    world=_world,
    tuning=Tuning,
    tune=tune,
    parameters=TdpaParams,
    device_sends=messages.Port,
    world_sends=messages.Port,
    covers=lambda params, tuning, virtual: True,
    allowance_J=lambda tuning: 2.0 * tuning.debt_limit_J,
    searched={
        "tdpa.stiffness": Between(50.0, 1000.0, log=True),
        "tdpa.damping": Between(0.5, 20.0, log=True),
        "tdpa.velocity_floor": Between(0.0005, 0.01, log=True),
        "tdpa.force_floor": Between(0.01, 0.2, log=True),
        "tdpa.damping_cap": Between(0.5, RENDERED_DAMPING, log=True),
        "tdpa.speed_limit": Between(0.15, 1.0, log=True),
        "tdpa.recovery_s": Between(0.005, 0.2, log=True),
        "tdpa.predict": (False, True),
    },
)
