"""Energy bounding (Kim, Ryu 2004): the force is limited to the energy that the device's own damping can dissipate.

This is its least conservative form. If the device's damping is at least b, the energy that the hand has put in by the
end of a tick of length T is at least

    E_n = E_{n-1} + b dx^2 / T - F_{n-1} dx        dx = x_n - x_{n-1},  F: the force on the device under zero-order hold

because over any motion from 0 to dx in the time T a damper dissipates at least b dx^2 / T. Whatever dx is in the next
tick, E_{n+1} >= E_n - F_n^2 T / 4b, the minimum of b dx^2 / T - F_n dx over dx. So E never falls below zero if

    |F_n| <= sqrt(4 E_n b / T)

This also holds within the tick, where T is smaller. It assumes nothing about the network or the hand, but the device
must really have the damping b.

If an axis has no force for `eba.reset_s`, its E restarts at zero: otherwise energy put in long ago would pay for a
force now. The authors' form for several axes does so after a tick without any force; but a coupling's spring, unlike a
wall, always has some force, so a force that people hardly notice (0.05 N) counts as none.

Starting from zero, a push at the speed v allows 2 b v more force each tick (derived here: F_n^2 = (F_{n-1} + 2 b v)^2).
So a spring up to K = 2 b / T, the bound of Colgate and Schenkel (1997), is rendered fully, a stiffer spring as this K.

Ticks of unequal length (derived here): in E_n, T is the time that has passed, or an upper bound of it. In the limit, T
is the time to come, the servo's period. A tick that is late, after T', may leave E_n below zero, by at most
F^2 (T' - T) / 4b. The force is then zero until the device's damping has made up for it, so this never accumulates.

Encoders with resolution r (derived here): the true position lies within r/2 of the count x. So the true |dx| is at
least max(0, |counted dx| - r), and only this is harvested; otherwise chatter of one count would be harvested without
end. Summed by parts, the work sum F dx is known from counts to within r/2 times (|F| now plus all changes of F so far),
and this is subtracted from E_n.

The bound holds for any requested force (Kim, Ryu 2004). So the world may predict the device, as explained in popc.py,
within `eba.predict_s`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from hapnet.checks import Vector
from hapnet.control.coupling import DeviceLaw
from hapnet.couplings.ends import held_law
from hapnet.couplings.link_delays import Delays
from hapnet.couplings.rendering import PREDICT_S, predicts
from hapnet.couplings.set_position import RESET_FORCE, RESET_S, device_spring, plain_world
from hapnet.couplings.spec import RENDERED_DAMPING, Between, CouplingSpec, CouplingStart, two_springs
from hapnet.errors import InvalidParameter
from hapnet.ext.laws.parts.virtual_coupling import NEVER, Reset, VirtualCoupling, couple, forget, pass_to
from hapnet.mechanics.spring import Spring
from hapnet.param_values import NOT_NEGATIVE, parameter
from hapnet.params import Params, is_simulated, known_damping
from hapnet.records.record import Floats, OfAxes, Reals, equation


class EnergyBounding(VirtualCoupling):
    """A held virtual coupling with a force that is bounded, axis by axis.

    Parameters
    ----------
    spring, damping, position : of the coupling.
    own_damping : b [Ns/m], a lower bound of the device's own damping on every axis.
    period : T [s], of the servo. resolution : r [m], of the encoders. reset : of E.

    Attributes
    ----------
    before : the force held at the last tick [N].
    """

    own: float
    gain: float
    resolution: float
    before: OfAxes

    def __init__(
        self,
        spring: Spring,
        damping: Vector,
        position: Vector,
        *,
        own_damping: float,
        period: float,
        resolution: float = 0.0,
        reset: Reset = NEVER,
    ) -> None:
        super().__init__(spring, damping, position, reset)
        self.before = [0.0] * self.n
        self.own = own_damping
        self.gain = 4.0 * own_damping / period
        self.resolution = resolution

    @property
    def energy(self) -> Vector:
        """E, a lower bound of the energy that the hand put in on each axis, less the energy it got back [J]."""
        return tuple(self.energies)

    @equation
    def render(self, dt: float, x: Reals, v: Reals, held: Reals, out: Floats) -> None:
        """The force to hold [N]."""
        _account(self, dt, x, held)
        couple(self, x, v, out)
        for i in range(self.n):
            out[i] = _bounded(self, out[i], self.energies[i], held[i])

    def release(self, dt: float, x: Vector, held: Vector) -> None:
        """Count the work of the force held until now. The spring is tied to x until a sample arrives."""
        _account(self, dt, x, held)
        self.untie(x)


@equation
def _account(law: EnergyBounding, dt: float, x: Reals, held: Reals) -> None:
    harvest = law.own / dt if dt > 0.0 else 0.0
    pass_to(law, x)
    for i in range(law.n):
        dx, F = law.moved[i], held[i]
        path = max(0.0, abs(dx) - law.resolution)
        changed = 0.5 * law.resolution * abs(F - law.before[i])
        law.energies[i] = law.energies[i] + harvest * path * path - F * dx - changed
        law.before[i] = F
    forget(law, dt, held)


@equation
def _bounded(law: EnergyBounding, force: float, E: float, held: float) -> float:
    sure = E - 0.5 * law.resolution * abs(held)
    if sure <= 0.0:
        return 0.0
    most = math.sqrt(law.gain * sure)
    return max(-most, min(force, most))


@dataclass(frozen=True)
class EbaParams:
    """Energy bounding (Kim, Ryu 2004)."""

    damping: float = parameter(
        0.0,
        "lower bound of the device's own damping [Ns/m]; 0: device.own_damping (real device: device.trusted_damping)",
        NOT_NEGATIVE,
    )
    predict_s: float = parameter(0.06, PREDICT_S, NOT_NEGATIVE)
    reset_force_N: float = parameter(0.05, RESET_FORCE, NOT_NEGATIVE)
    reset_s: float = parameter(0.1, RESET_S, NOT_NEGATIVE)


@dataclass(frozen=True)
class Tuning:
    damping_Ns_m: float
    predicts: bool = False


def tune(params: Params, link: Delays) -> Tuning:
    own = params.of(EbaParams)
    damping = own.damping or known_damping(params)
    if damping == 0.0:
        allowed = "above 0 with the coupling eba, which renders no force without damping (or set eba.damping)"
        name = "own_damping" if is_simulated(params.hardware) else "trusted_damping"
        raise InvalidParameter(f"device.{name}", 0.0, allowed)
    return Tuning(damping, predicts(params, link, own.predict_s))


def _device(start: CouplingStart[Tuning]) -> DeviceLaw:
    device, own = start.params.device, start.params.of(EbaParams)
    return EnergyBounding(
        *device_spring(start.params, len(start.position)),
        start.position,
        own_damping=start.tuning.damping_Ns_m,
        period=1.0 / device.servo_hz,
        resolution=device.resolution_m,
        reset=Reset(own.reset_force_N, own.reset_s),
    )


LAW = CouplingSpec(
    name="eba",
    title="energy bounding",
    source="Kim, Ryu 2004",
    claim="passive at the hand's port, if the device really has the damping that is assumed",
    device=held_law(_device),
    world=plain_world,
    tuning=Tuning,
    tune=tune,
    parameters=EbaParams,
    set_positions=frozenset({"world"}),
    scaled=True,
    springs=two_springs,
    compiled=(EnergyBounding, None),
    searched={"device.damping": Between(0.05, RENDERED_DAMPING, log=True), "eba.predict_s": Between(0.0, 0.3)},
)
