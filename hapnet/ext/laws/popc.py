"""Passivity observer and controller at one port, the device's (Hannaford, Ryu, IEEE T-RA 18(1), 2002).

The observer sums the energy put in at the actuator's port, axis by axis. If the sum is negative, the controller
dissipates the difference:

    W_n = W_{n-1} - F_{n-1} (x_n - x_{n-1})        F: the force on the device, the controller's included
    alpha_n = -W_n / (T v_n^2)   if W_n < 0,       F_n = f_n - alpha_n v_n

The paper's observer takes f_n v_n T as the energy of a tick. Under zero-order hold the force does the work F_{n-1} dx,
which is known exactly a tick later; it includes the energy that the hold leaks and that the controller really
dissipated. So W is exact, and energy that could not be dissipated stays in W until it is.

A damper dissipates only while the device moves, and a held damper only up to a limit: alpha is at most `damping_cap`,
and zero below `velocity_floor`. Let L_n >= 0 be the part of -W_n that these limits left. If the device continues at
v_n, the next tick has

    W_{n+1} = -L_n - f_n v_n T                     (derived here; L_n = -W_n where alpha_n = 0 and W_n < 0)

So the port never outputs more than L_n plus a tick's work of the coupling's own force.

If an axis has no force for `popc.reset_s`, its surplus is dropped: otherwise energy put in long ago would come out
again undamped. The paper resets its observer in this way, in free space (Hannaford, Ryu 2002; their patent
WO 02/23286: "when it has been too positive for too long"). The two numbers are ours: people hardly notice 0.05 N.

The observer and the controller act at the device's port, after any source of the force (Hannaford, Ryu 2002: "any"
virtual environment). So the world may predict the device: the claim is for the hand's port alone. It predicts if age
and lag together are within `popc.predict_s`, by default no longer than the time span of the fitted positions. In
measurements, longer predictions made both ports together far from passive.
"""

from __future__ import annotations

from dataclasses import dataclass

from hapnet.checks import Vector
from hapnet.control.coupling import DeviceLaw
from hapnet.couplings.ends import held_law
from hapnet.couplings.link_delays import Delays
from hapnet.couplings.rendering import PREDICT_S, predicts
from hapnet.couplings.set_position import RESET_FORCE, RESET_S, device_spring, plain_world
from hapnet.couplings.spec import RENDERED_DAMPING, Between, CouplingSpec, CouplingStart, two_springs
from hapnet.ext.laws.parts.virtual_coupling import NEVER, Reset, VirtualCoupling, couple, forget, pass_to
from hapnet.mechanics.spring import Spring
from hapnet.param_values import NOT_NEGATIVE, Range, parameter
from hapnet.params import Params
from hapnet.records.record import Floats, Reals, equation


def damping_cap(mass: float, period: float, rendered: float) -> float:
    """The largest damping to hold for `period` [s] on a device of `mass` [kg], in Ns/m.

    On a free mass the force -alpha v under zero-order hold dissipates alpha v^2 T (1 - alpha T / 2m): the most with
    alpha = m/T, which stops the mass by the tick's end, and nothing from 2m/T on (derived here). The result is at most
    `rendered`, the damping that the device is known to render stably.
    """
    return min(rendered, mass / period)


class PassivityController(VirtualCoupling):
    """A held virtual coupling with one observer and one controller on each axis.

    spring, damping, position : of the coupling.
    velocity_floor : no damping below this speed [m/s]. damping_cap : largest alpha [Ns/m]. reset : of the observer.
    """

    floor: float
    cap: float

    def __init__(
        self,
        spring: Spring,
        damping: Vector,
        position: Vector,
        *,
        velocity_floor: float,
        damping_cap: float,
        reset: Reset = NEVER,
    ) -> None:
        super().__init__(spring, damping, position, reset)
        self.floor, self.cap = velocity_floor, damping_cap

    @property
    def energy(self) -> Vector:
        """W, the energy put in at the port on each axis [J]."""
        return tuple(self.energies)

    @equation
    def render(self, dt: float, x: Reals, v: Reals, held: Reals, out: Floats) -> None:
        """The force to hold [N]."""
        _observe(self, dt, x, held)
        couple(self, x, v, out)
        owes = False
        for i in range(self.n):
            owes = owes or bool(self.energies[i] < 0.0)
        if owes:
            for i in range(self.n):
                out[i] = out[i] - _alpha(self, self.energies[i], v[i], dt) * v[i]

    def release(self, dt: float, x: Vector, held: Vector) -> None:
        """Continue to observe. The spring is tied to x until a sample arrives."""
        _observe(self, dt, x, held)
        self.untie(x)


@equation
def _observe(law: PassivityController, dt: float, x: Reals, held: Reals) -> None:
    pass_to(law, x)
    for i in range(law.n):
        law.energies[i] = law.energies[i] - held[i] * law.moved[i]
    forget(law, dt, held)


@equation
def _alpha(law: PassivityController, W: float, v: float, dt: float) -> float:
    if W >= 0.0 or abs(v) < law.floor:
        return 0.0
    unit = v * v * dt  # energy that 1 Ns/m dissipates by the next tick [J]
    return law.cap if law.cap * unit <= -W else -W / unit


@dataclass(frozen=True)
class PopcParams:
    """Passivity observer and controller at the device's port (Hannaford, Ryu 2002)."""

    velocity_floor: float = parameter(
        0.002, "the controller cannot damp below this speed [m/s]", Range(0.0, at_most=1.0)
    )
    damping_cap: float = parameter(0.0, "the most damping that it may inject [Ns/m]; 0: by a rule", NOT_NEGATIVE)
    predict_s: float = parameter(0.06, PREDICT_S, NOT_NEGATIVE)
    reset_force_N: float = parameter(0.05, RESET_FORCE, NOT_NEGATIVE)
    reset_s: float = parameter(0.1, RESET_S, NOT_NEGATIVE)


@dataclass(frozen=True)
class Tuning:
    damping_cap_Ns_m: float
    velocity_floor_m_s: float
    predicts: bool = False


def tune(params: Params, link: Delays) -> Tuning:
    device, own = params.device, params.of(PopcParams)
    by_rule = damping_cap(device.mass, 1.0 / device.servo_hz, RENDERED_DAMPING)
    return Tuning(own.damping_cap or by_rule, own.velocity_floor, predicts(params, link, own.predict_s))


def _device(start: CouplingStart[Tuning]) -> DeviceLaw:
    own = start.params.of(PopcParams)
    return PassivityController(
        *device_spring(start.params, len(start.position)),
        start.position,
        velocity_floor=start.tuning.velocity_floor_m_s,
        damping_cap=start.tuning.damping_cap_Ns_m,
        reset=Reset(own.reset_force_N, own.reset_s),
    )


LAW = CouplingSpec(
    name="popc",
    title="passivity observer and controller",
    source="Hannaford, Ryu 2002",
    claim="passive at the hand's port, except for the energy that the controller's limits leave",
    device=held_law(_device),
    world=plain_world,
    tuning=Tuning,
    tune=tune,
    parameters=PopcParams,
    set_positions=frozenset({"world"}),
    scaled=True,
    springs=two_springs,
    compiled=(PassivityController, None),
    searched={
        "device.damping": Between(0.05, RENDERED_DAMPING, log=True),
        "popc.velocity_floor": Between(0.0005, 0.01, log=True),
        "popc.damping_cap": Between(0.5, RENDERED_DAMPING, log=True),
        "popc.predict_s": Between(0.0, 0.3),
    },
)
