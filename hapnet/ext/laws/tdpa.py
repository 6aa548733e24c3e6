"""Two-port time-domain passivity (J.-H. Ryu, J. Artigas, C. Preusche, Mechatronics 20, 2010), with a slow world.

The published law drifts with every contact, so the default adds drift compensation, as in later work on this law. A
recovery of 0 turns it off.

The device sends its position. The world sends the force of a spring and damper between the virtual mass and a
set-position y that moves as the device does. With reaction f at the device's velocity v, and f_c at the set-position's
velocity v_y, the power into the two-port is P = f.v at the device and P = -f_c.v_y at the world. An observer at each
port sums P by its sign, and each side sends its E_in with its samples:

    P > 0: E_in += T P,    else E_out -= T P

Energy that comes out at a port must have gone in at the other. Otherwise the port's controller damps or yields:

    device: E_out^d <= E_in^w,    f <- f + alpha v,        alpha = (E_out^d - E_in^w) / (T v^2)
    world:  E_out^w <= E_in^d,    v_y <- v_y - beta f_c,   beta = (E_out^w - E_in^d) / (T f_c^2)

E_in only grows, so the largest value that arrived is a safe bound, whatever the link loses or reorders. The energy that
the controllers really dissipated is subtracted from E_out; energy that floors and caps kept them from dissipating stays
as a debt. P is the power of all axes together, with a common alpha and beta, so the account is the same in any
coordinates.

Derived here, for steps of any length: within a step beta acts at once. With a = B + K T/2, and y - x at its start,

    f_c = s f_1,    f_1 = a (v_y - vhat) + K (y - x),    s = 1/(1 + a beta)

This is a damper 1/beta in series with the coupling, passive for any T. It dissipates s (1 - s) f_1^2 T/a, the most at
s = 1/2: a larger beta dissipates no more, so s >= 1/2. Floors and caps must not let a debt grow: the device's f and the
world's v_y fade as the debt grows, and are zero at its limit D. So no port ever owes more than D plus a tick's work
under zero-order hold, and the energy put in at both ports together never falls below minus the sum of the two debts.

The controllers are the last stage at both ports, and count the energy that really comes out. So the world may command
any displacement (Ryu, Artigas, Preusche 2010): with `tdpa.predict`, a displacement to the predicted position of the
device, delay included. The energy of that motion arrives a delay later, so the controller yields more in contact: free
motion becomes freer, and contact softer. By default the law only extrapolates the newest position by its own estimate
of the velocity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hapnet.checks import Vector
from hapnet.control.coupling import LawSteps, WorldCoupling
from hapnet.control.law import DeviceEnd
from hapnet.control.samples import PortSample
from hapnet.couplings import rendering
from hapnet.couplings.ends import held_law
from hapnet.couplings.link_delays import Delays
from hapnet.couplings.spec import RENDERED_DAMPING, Between, CouplingSpec, CouplingStart, scalar_stiffness
from hapnet.ext.laws.parts.tdpa_world import PassivityObserver, TdpaWorld, Tuning, grant, observe
from hapnet.param_values import NOT_NEGATIVE, POSITIVE, Range, parameter
from hapnet.params import Params
from hapnet.records.record import Floats, OfAxes, Reals, equation
from hapnet.records.vectors import copy, dot
from hapnet.wire import messages


@dataclass(frozen=True)
class TdpaParams:
    """Two-port time-domain passivity (Ryu, Artigas, Preusche 2010), with drift compensation."""

    stiffness: float = parameter(
        0.0, "stiffness of the virtual coupling at the world [N/m]; 0: device.stiffness", NOT_NEGATIVE
    )
    damping: float = parameter(0.0, "damping of this coupling [Ns/m]; 0: by a rule", NOT_NEGATIVE)
    velocity_floor: float = parameter(
        0.002, "the device's controller cannot damp below this speed [m/s]", Range(0.0, at_most=1.0)
    )
    force_floor: float = parameter(0.05, "the world's controller cannot yield below this force [N]", POSITIVE)
    damping_cap: float = parameter(0.0, "the most damping at the device [Ns/m]; 0: by a rule", NOT_NEGATIVE)
    speed_limit: float = parameter(0.25, "maximum speed of the world's set-position [m/s]", Range(0.0, at_most=100.0))
    debt_limit_J: float = parameter(0.02, "a side that owes this much energy gives out no more [J]", POSITIVE)
    predict: bool = parameter(False, "the world predicts the device by the delay, unless rendering is paper")
    recovery_s: float = parameter(
        0.02,
        "time constant of the drift compensation, as far as there is energy [s]; 0: none, as first published",
        NOT_NEGATIVE,
    )


class TdpaDevice(DeviceEnd):
    """The device's end: it renders the world's reaction, plus the damping that the account requires.

    Its set-position is x - f/K: a spring K tied there would have the world's reaction. The world sends no position.

    Parameters
    ----------
    position : (n,) the device's position [m].

    Attributes
    ----------
    x : position at the last tick [m]. reaction : of the world [N]. damper : the controller's part of the force [N].
    """

    observer: PassivityObserver
    x: OfAxes
    reaction: OfAxes
    damper: OfAxes
    path: OfAxes
    compliance: float
    floor_square: float
    cap: float
    debt_limit: float

    sends = PortSample

    def __init__(self, tuning: Tuning, position: Vector) -> None:
        super().__init__(position)
        self.observer = PassivityObserver()
        self.x = list(position)
        self.reaction, self.damper, self.path = ([0.0] * self.n for _ in range(3))
        self.compliance = 1.0 / tuning.stiffness_N_m
        self.floor_square = tuning.velocity_floor_m_s * tuning.velocity_floor_m_s
        self.cap, self.debt_limit = tuning.damping_cap_Ns_m, tuning.debt_limit_J

    @equation
    def take(self, value: Reals, more: Reals, amount: float, total_s: float) -> None:
        """Take in the world's force and E_in."""
        for i in range(self.n):
            self.reaction[i] = -value[i]
        grant(self.observer, amount)
        _tie(self)

    def on_peer_changed(self) -> None:
        """Start again: a new peer's force and E_in are unknown."""
        self.observer.on_peer_changed()
        self.reaction[:] = [0.0] * self.n
        _tie(self)

    @equation
    def render(self, dt: float, x: Reals, v: Reals, held: Reals, out: Floats) -> None:
        """Compute the force -(f + alpha v)."""
        _settle(self, x, held)
        debt = self.observer.debt
        if debt <= 0.0:
            copy(self.n, self.reaction, out)
            return
        share = max(0.0, 1.0 - debt / self.debt_limit)
        square = dot(self.n, v, v)
        if square < self.floor_square:
            for i in range(self.n):
                out[i] = share * self.reaction[i]
            return
        alpha = min(self.cap, debt / (dt * square))
        for i in range(self.n):
            self.damper[i] = -alpha * v[i]
            out[i] = share * self.reaction[i] - alpha * v[i]

    @equation
    def set_outgoing(self, x: Reals, v: Reals) -> None:
        """Write the position and E_in into `outgoing`."""
        copy(self.n, x, self.outgoing.value)
        self.outgoing.amount = self.observer.put_in

    def release(self, dt: float, x: Vector, held: Vector) -> None:
        """Observe the force held until now."""
        _settle(self, x, held)


@equation
def _settle(law: TdpaDevice, x: Reals, held: Reals) -> None:
    """Observe the force held since the last tick exactly: its whole work, and separately the damper's part."""
    n = law.n
    for i in range(n):
        law.path[i] = x[i] - law.x[i]
        law.x[i] = x[i]
    damped = -dot(n, law.damper, law.path)
    observe(law.observer, dot(n, held, law.path) + damped, damped)
    for i in range(n):
        law.damper[i] = 0.0
    _tie(law)


@equation
def _tie(law: TdpaDevice) -> None:
    for i in range(law.n):
        law.y[i] = law.x[i] + law.compliance * law.reaction[i]


def tune(params: Params, link: Delays) -> Tuning:
    """Choose critical damping for the heaviest axis of the virtual mass, at most the damping that a device renders.

    alpha is limited in the same way, and to m/T, which stops the device within a tick: a stronger held damper would
    reverse its velocity. The link's delays do not matter.
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
        predicts=chosen.predict and params.rendering != "paper",
    )


def _device(start: CouplingStart[Tuning]) -> TdpaDevice:
    return TdpaDevice(start.tuning, start.position)


def _world(start: CouplingStart[Tuning]) -> WorldCoupling:
    predictor = rendering.predictor(start.params) if start.tuning.predicts else None
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
    compiled=(TdpaDevice, TdpaWorld),
    springs=lambda params, tuning: (tuning.stiffness_N_m,),
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
