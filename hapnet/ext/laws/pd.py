"""PD control of both sides over a delay (Lee, Spong, IEEE T-RO 22(2), 2006), between the device and the virtual mass.

Each side uses its own motion and the other side's motion at the time it was sent; R is the round trip:

    tau = -K_v (v - v_peer) - (K_d + P_e) v - K_p (x - x_peer)         passive if K_d >= K_p R / 2

Proof (the law is the paper's, this argument is derived here): beside the stored energy K_p/2 (x_1 - x_2)^2, each side
may inject the power K_p v times the other side's displacement since its sample was sent. If no sample is older than D_1
and D_2, this adds up to at most K_p (D_1 + D_2)/2 times each side's integral of v^2, and K_d dissipates that much. So
for the spring the delay may vary below its bound; for K_v it must be constant. After a lost sample the last sample is
older than the bound, and nothing is claimed.

R includes the time that samples are held. The device sends a sample every few ticks. The world sends a sample each step
of length T, and uses a single sample for a whole step. Its velocity over a step is a single number, so both together
cost it T on average. They cost the device T as well, if its motion is slow compared with a step (2 T at worst).

The world's end is implicit in the step's mean velocity, and exactly passive while x_peer is held. The device's force is
held. To be passive for any motion the device needs more own damping than K_p T/2 + K_d + P_e + K_v, with T the servo's
period (Colgate, Schenkel 1997). With less it is passive for motions that are slow compared with a tick.

If the ends start at different positions, the spring starts with the energy K_p/2 (x_1 - x_2)^2.

No predictor precedes this law. The proof (Lee, Spong 2006) needs the other side's real position of a bounded time ago:
K_d pays for that side's motion since then. A prediction over h seconds adds the power K_p v h v_peer, for which K_d
must grow by up to K_p h/2. As the device cannot render more damping, the rule would have to lower the stiffness
(derived here).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from hapnet.checks import Vector
from hapnet.control.deadband import MAX_S
from hapnet.control.law import DeviceEnd, End, WorldEnd
from hapnet.control.samples import MotionSample
from hapnet.couplings.ends import held_law, stepped_law
from hapnet.couplings.link_delays import Delays
from hapnet.couplings.spec import (
    RENDERED_DAMPING,
    Between,
    CouplingSpec,
    CouplingStart,
    scalar_stiffness,
)
from hapnet.param_values import NOT_NEGATIVE, parameter
from hapnet.params import Params, known_damping
from hapnet.records.record import Floats, OfAxes, Reals, equation
from hapnet.records.vectors import copy
from hapnet.wire import messages
from netem import LinkProfile


class Gains(NamedTuple):
    """The gains, the same at both ends."""

    stiffness: float  #: K_p [N/m]
    damping: float  #: K_d [Ns/m], which compensates the delay
    coordination: float = 0.0  #: K_v [Ns/m]
    extra: float = 0.0  #: P_e [Ns/m]

    @property
    def drag(self) -> float:
        """The sum of all gains on a side's own velocity [Ns/m]."""
        return self.damping + self.extra + self.coordination


def round_trip(link: float, period: float, step: float, tick: float) -> float:
    """R [s]: the link's round trip plus the device's sending period, the world's maximum step and the servo's tick."""
    return link + period + step + tick


def tuned(stiffness: float, round_trip: float, most: float) -> Gains:
    """Gains with K_p = `stiffness` [N/m], or less if K_d = K_p R/2 would exceed `most` [Ns/m]."""
    K_p = min(stiffness, 2.0 * most / round_trip)
    return Gains(K_p, K_p * round_trip / 2.0)


class _Gained(End):
    """The common part of both ends.

    Parameters
    ----------
    gains : of the law. position : x(0) of this side [m]; the other side is assumed to rest there too.

    Attributes
    ----------
    stiffness, coordination, own : K_p [N/m], K_v, and the sum of all gains on a side's own velocity [Ns/m].
    velocity : of the other side [m/s]; its position is `y`.
    """

    stiffness: float
    coordination: float
    own: float
    velocity: OfAxes

    sends = MotionSample

    def __init__(self, gains: Gains, position: Vector) -> None:
        super().__init__(position)
        self.stiffness, self.coordination, self.own = gains.stiffness, gains.coordination, gains.drag
        self.velocity = [0.0] * self.n

    @equation
    def take(self, value: Reals, more: Reals, amount: float, total_s: float) -> None:
        """Take in the other side's motion."""
        copy(self.n, value, self.y)
        copy(self.n, more, self.velocity)

    def on_peer_changed(self) -> None:
        """Start again: until its first sample, a new peer is assumed to rest at the old peer's last position."""
        self.velocity[:] = [0.0] * len(self.velocity)


class DevicePD(_Gained, DeviceEnd):
    """The device's end."""

    @equation
    def render(self, dt: float, x: Reals, v: Reals, held: Reals, out: Floats) -> None:
        """The force to hold [N]."""
        for i in range(self.n):
            out[i] = self.coordination * self.velocity[i] - self.own * v[i] - self.stiffness * (x[i] - self.y[i])

    @equation
    def set_outgoing(self, x: Reals, v: Reals) -> None:
        """Write the device's motion into `outgoing`."""
        copy(self.n, x, self.outgoing.value)
        copy(self.n, v, self.outgoing.more)

    def release(self, dt: float, x: Vector, held: Vector) -> None:
        """Tie the spring to x until a sample arrives."""
        self.y[:], self.velocity[:] = x, [0.0] * self.n


class WorldPD(_Gained, WorldEnd):
    """The world's end.

    x, vhat : the mass's position [m], and its mean velocity over the last step [m/s]: v may alternate about the mean.
    at, speed : the other side's position [m] and velocity [m/s] in the running step.
    """

    x: OfAxes
    vhat: OfAxes
    at: OfAxes
    speed: OfAxes

    def __init__(self, gains: Gains, position: Vector) -> None:
        super().__init__(gains, position)
        self.x, self.at = list(position), list(position)
        self.vhat, self.speed = [0.0] * self.n, [0.0] * self.n

    @equation
    def begin(self) -> None:
        """Begin a step with the newest motion that has arrived."""
        copy(self.n, self.y, self.at)
        copy(self.n, self.velocity, self.speed)

    @equation
    def drag(self, dt: float) -> float:
        """Compute the drag K_v + K_d + P_e + K_p T/2 [Ns/m], and the push K_v v_peer - K_p (x - x_peer) [N]."""
        for i in range(self.n):
            self.push[i] = self.coordination * self.speed[i] - self.stiffness * (self.x[i] - self.at[i])
        return self.own + 0.5 * self.stiffness * dt

    @equation
    def moved(self, dt: float, vhat: Reals, x: Reals, v: Reals) -> None:
        """Complete the step."""
        copy(self.n, x, self.x)
        copy(self.n, vhat, self.vhat)

    @equation
    def set_outgoing(self) -> None:
        """Write the mass's motion into `outgoing`."""
        copy(self.n, self.x, self.outgoing.value)
        copy(self.n, self.vhat, self.outgoing.more)


@dataclass(frozen=True)
class PdParams:
    """PD over a constant delay (Lee, Spong 2006)."""

    stiffness: float = parameter(0.0, "K_p [N/m]; 0: device.stiffness. K_d by the rule limits it", NOT_NEGATIVE)
    damping: float = parameter(
        0.0, "K_d, which dissipates the energy from the delay [Ns/m]; 0: by a rule", NOT_NEGATIVE
    )
    coordination: float = parameter(0.0, "K_v, on the difference of the velocities [Ns/m]", NOT_NEGATIVE)
    extra_damping: float = parameter(0.0, "P_e, on each side's own velocity [Ns/m]", NOT_NEGATIVE)


@dataclass(frozen=True)
class Tuning:
    stiffness_N_m: float
    damping_Ns_m: float
    coordination_Ns_m: float
    extra_damping_Ns_m: float

    @property
    def gains(self) -> Gains:
        return Gains(self.stiffness_N_m, self.damping_Ns_m, self.coordination_Ns_m, self.extra_damping_Ns_m)


def tune(params: Params, link: Delays) -> Tuning:
    """Choose K_p so that the device can render the K_d that the rule requires. With a K_d set by the user, keep K_p."""
    device, own = params.device, params.of(PdParams)
    K = own.stiffness or scalar_stiffness(params)
    held_back = 2.0 * MAX_S if params.wire.deadband else 0.0
    trip = round_trip(
        link.round_trip_bound_s + held_back, device.pspm_period_s, params.world.step_max_s, 1.0 / device.servo_hz
    )
    K_p, K_d, *_ = Gains(K, own.damping) if own.damping else tuned(K, trip, RENDERED_DAMPING)
    return Tuning(K_p, K_d, own.coordination, own.extra_damping)


def warn(params: Params, tuning: Tuning) -> tuple[str, ...]:
    gains, own = tuning.gains, known_damping(params)
    need = gains.stiffness / params.device.servo_hz / 2.0 + gains.drag
    if own > need:
        return ()
    return (
        f"the coupling pd holds its force for a tick: with {own:g} Ns/m of damping in the device itself "
        f"it is not passive for motions as fast as a tick; above {need:.3g} Ns/m it would be",
    )


def covers(params: Params, tuning: Tuning, virtual: bool) -> bool:
    """True with known constant delays, gains by the rule, and own damping that covers the hold's leak.

    False with the stages: the proof needs the other side's real position.
    """
    link = params.link
    profiles = [LinkProfile.named(words) for words in (link.up, link.down)]
    known = all(profile == LinkProfile(delay_ns=profile.delay_ns) for profile in profiles)
    own = params.of(PdParams)
    by_rule = not own.damping and not own.coordination
    still = not (link.up_timeline or link.down_timeline)
    return virtual and known and still and by_rule and params.rendering != "hapnet" and not warn(params, tuning)


def _device(start: CouplingStart[Tuning]) -> DevicePD:
    return DevicePD(start.tuning.gains, start.position)


def _world(start: CouplingStart[Tuning]) -> WorldPD:
    return WorldPD(start.tuning.gains, start.position)


def _at_rest(set_position: Vector) -> MotionSample:
    """Return the other side's motion for the law, from a set-position of the stages: K_v then acts as damping."""
    return MotionSample(set_position, (0.0,) * len(set_position))


def _springs(start: CouplingStart[Tuning]) -> Params:
    """Parameters with K_p and the drag as springs and dampers of both sides."""
    K_p, drag = start.tuning.stiffness_N_m, start.tuning.gains.drag
    return start.params.set({f"{side}.{name}": value for side in ("device", "world")
                             for name, value in (("stiffness", K_p), ("damping", drag))})  # fmt: skip


LAW = CouplingSpec(
    name="pd",
    title="PD over a constant delay",
    source="Lee, Spong 2006",
    claim="passive at both ports, if K_d is at least K_p times half the round trip and nothing is lost",
    device=held_law(_device, takes=_at_rest, springs=_springs),
    world=stepped_law(_world, takes=_at_rest, springs=_springs),
    tuning=Tuning,
    tune=tune,
    parameters=PdParams,
    shared=("stiffness_N_m", "damping_Ns_m", "coordination_Ns_m"),
    device_sends=messages.Motion,
    world_sends=messages.Motion,
    covers=covers,
    warn=warn,
    compiled=(DevicePD, WorldPD),
    springs=lambda params, tuning: (tuning.stiffness_N_m,),
    searched={
        "pd.stiffness": Between(5.0, 1000.0, log=True),
        "pd.coordination": Between(0.0, 2.0),
        "pd.extra_damping": Between(0.0, 2.0),
    },
)
