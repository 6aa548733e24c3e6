"""The port through which a bilateral law's force goes to a robot: the law's own, or PSPM's.

A law computes, once a tick, a force ``f - B v`` from its robot's motion, from what the other side sent, and from the
force that was really held. The port renders it as a spring K and a damper B, with the spring tied to

    y = x + f/K

Bare, ybar = y, and the robot gets the law's force unchanged. Behind PSPM, ybar comes as near to y as the reservoir
pays for: y is a set-position like any other, so the port is passive whatever law chose it, and whatever the link does
(Lee, Huang 2009, Theorem 1). A law needs no change for it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

from hapnet.checks import Vector
from hapnet.control.coupling import DeviceCoupling, PositionSample, Update, WorldCoupling
from hapnet.control.held_steps import FollowerServo
from hapnet.control.samples import CouplingSample, vector_of
from hapnet.control.set_position_servo import SampledServo
from hapnet.couplings.link_delays import Delays
from hapnet.couplings.pspm import modulator
from hapnet.couplings.rendering import largest
from hapnet.couplings.set_position import MakeModulator, held_servo, plain
from hapnet.couplings.spec import CouplingSpec, CouplingStart, scalar_stiffness
from hapnet.errors import InvalidParameter
from hapnet.param_values import NOT_NEGATIVE, POSITIVE, parameter
from hapnet.params import Params

SECTION = "bilateral"
"""The section of `Params` that the bilateral laws share."""

PORTS: Mapping[str, MakeModulator] = {"bare": plain, "pspm": modulator}
"""The modulators that choose ybar, by the values of `bilateral.port`."""

T = TypeVar("T", bound="BilateralTuning")


@dataclass(frozen=True)
class BilateralParams:
    """Bilateral laws between a leader and its follower."""

    port: str = parameter(
        "bare", "bare: a robot gets the law's force; pspm: as far as its energy account pays for it", tuple(PORTS)
    )
    position_gain: float = parameter(400.0, "four-channel: Kp, on the difference of the positions [1/s^2]", POSITIVE)
    velocity_gain: float = parameter(0.0, "four-channel: Kd [1/s]; 0: critical, 2 sqrt(Kp)", NOT_NEGATIVE)
    force_gain: float = parameter(1.0, "four-channel: Kf, on the sum of the forces; 0: none", NOT_NEGATIVE)
    friction_known: float = parameter(
        1.0, "four-channel: share of follower.friction_N that the observer takes for known", NOT_NEGATIVE
    )
    cutoff_rad_s: float = parameter(150.0, "four-channel: g of the disturbance observers [rad/s]", POSITIVE)


@dataclass(frozen=True)
class BilateralTuning:
    """The port, and the springs and dampers at both ends, in the leader's units."""

    port: str
    leader_stiffness_N_m: float
    leader_damping_Ns_m: float
    follower_stiffness_N_m: float
    follower_damping_Ns_m: float

    @property
    def leader_lead_s(self) -> float:
        """B/K of the leader [s]."""
        return self.leader_damping_Ns_m / self.leader_stiffness_N_m

    @property
    def follower_lead_s(self) -> float:
        """B/K of the follower [s]."""
        return self.follower_damping_Ns_m / self.follower_stiffness_N_m


class BilateralEnd(ABC):
    """One end of a bilateral law: the `Source` of its port's set-position.

    stiffness : K of the port's spring [N/m].

    Attributes
    ----------
    x, v : the robot's position [m] and velocity [m/s] at this tick. sensed : the force of its surroundings on it, if it
    is measured [N]. peer : the other side's last sample; empty: none yet.
    """

    def __init__(self, stiffness: float) -> None:
        self.stiffness = stiffness
        self.x: Vector = ()
        self.v: Vector = ()
        self.sensed: Vector = ()
        self.peer: Vector = ()

    def look(self, dt: float, x: Vector, v: Vector, held: Vector, sensed: Vector) -> None:
        """Take in the state at a tick, and the force really held for the last `dt` seconds [N]."""
        self.x, self.v, self.sensed = x, v, sensed

    @abstractmethod
    def pull(self) -> Vector:
        """The law's force without its damper [N]; called only with a `peer`."""

    @abstractmethod
    def content(self, level: float | None) -> CouplingSample:
        """The sample that the other side needs, with the level of this side's reservoir (None: it is not sent)."""

    def receive(self, sample: CouplingSample, sent_s: float, age_s: float) -> None:
        self.peer = vector_of(sample)

    def step(self, dt: float, x: Vector) -> Vector:
        """y [m]; before the other side's first sample x, so no force."""
        if not self.peer or not self.x:
            return x
        return tuple([at + f / self.stiffness for at, f in zip(x, self.pull(), strict=True)])

    def reset(self, position: Vector) -> None:
        self.peer = ()

    def release(self, position: Vector) -> None:
        self.peer = ()


class LeaderServo(SampledServo):
    """The leader's servo. law : chooses y. The other arguments are those of `SampledServo`."""

    def __init__(self, law: BilateralEnd, **servo: Any) -> None:
        super().__init__(**servo)
        self.law = law

    def tick(self, dt: float, x: Vector, v: Vector, *, release: bool = False) -> Update | None:
        self.law.look(dt, x, v, self.force, (0.0,) * self.n)
        return _answer(self, self.law, super().tick(dt, x, v, release=release))


class LawFollower(FollowerServo):
    """The follower's servo. law : chooses y. The other arguments are those of `FollowerServo`."""

    def __init__(self, law: BilateralEnd, **servo: Any) -> None:
        super().__init__(None, **servo)
        self.law = law

    def tick(self, dt: float, x: Vector, v: Vector, *, release: bool = False) -> Update | None:
        self.law.look(dt, x, v, self.force, self.sensed)
        return _answer(self, self.law, super().tick(dt, x, v, release=release))


def _answer(servo: SampledServo, law: BilateralEnd, done: Update | None) -> Update | None:
    """Replace the position that the servo sends by what the law sends."""
    if done is None or done.sample is None:
        return done
    return Update(law.content(servo.coupling.level), done.shuffled)


def led(x: Vector, lead_s: float, v: Vector, level: float | None) -> CouplingSample:
    """Return the sample of the place x + lead_s v [m]: a spring to it also renders its damper on v."""
    place = tuple([at + lead_s * speed for at, speed in zip(x, v, strict=True)])
    return place if level is None else PositionSample(place, level)


def tune(params: Params, link: Delays) -> BilateralTuning:
    """The springs and dampers that are set; the link's delays do not matter. Raises InvalidParameter."""
    K_world = params.world.stiffness
    if not isinstance(K_world, float):
        raise InvalidParameter("world.stiffness", K_world, f"a number with the coupling {params.coupling}")
    return BilateralTuning(
        params.of(BilateralParams).port,
        scalar_stiffness(params),
        largest(params.device.damping),
        K_world,
        largest(params.world.damping),
    )


def covers(params: Params, tuning: BilateralTuning, virtual: bool) -> bool:
    """True behind PSPM, with the measured harvest."""
    return PORTS[tuning.port] is modulator and params.device.harvest != "range"


def leader(make: Callable[[CouplingStart[T]], BilateralEnd]) -> Callable[[CouplingStart[T]], DeviceCoupling]:
    """Makes the leader's end of a `CouplingSpec`, from a function that makes the law's."""

    def made(start: CouplingStart[T]) -> DeviceCoupling:
        return _servo(start, make(start), start.tuning.leader_damping_Ns_m, LeaderServo)

    return made


def follower(make: Callable[[CouplingStart[T]], BilateralEnd]) -> Callable[[CouplingStart[T]], FollowerServo]:
    """Makes the follower's servo of a `CouplingSpec`, from a function that makes the law's end."""

    def made(start: CouplingStart[T]) -> FollowerServo:
        held = replace(start, harvest="measured")
        return _servo(held, make(start), start.tuning.follower_damping_Ns_m, LawFollower)

    return made


def between_robots(
    name: str,
    title: str,
    source: str,
    ends: tuple[Callable[[CouplingStart[T]], BilateralEnd], Callable[[CouplingStart[T]], BilateralEnd]],
    tuning: type[T],
    tune: Callable[[Params, Delays], T],
    **more: Any,
) -> CouplingSpec[T]:
    """The `CouplingSpec` of a bilateral law. ends : make its leader's and its follower's. more : further entries."""
    return CouplingSpec(
        name=name,
        title=title,
        source=source,
        claim="passive only behind PSPM's port (bilateral.port=pspm)",
        device=leader(ends[0]),
        follower=follower(ends[1]),
        world=no_world,
        tuning=tuning,
        tune=tune,
        parameters=BilateralParams,
        section=SECTION,
        set_positions=frozenset({"device", "world"}),
        joint=False,
        between_robots=True,
        covers=covers,
        **more,
    )


S = TypeVar("S", bound=SampledServo)


def _servo(start: CouplingStart[Any], law: BilateralEnd, damping: float, kind: Callable[..., S]) -> S:
    params = start.params.set({"device.stiffness": law.stiffness, "device.damping": damping})
    port = PORTS[start.tuning.port]
    sending = params.device.pspm_period_s
    return held_servo(replace(start, params=params), port, law, None, partial(kind, law), (0.0, sending))


def no_world(start: CouplingStart[Any]) -> WorldCoupling:
    """Raise InvalidParameter: a virtual mass is no robot."""
    raise InvalidParameter("coupling", start.params.coupling, "pspm or zoh, or with a robot: --follower simulated")
