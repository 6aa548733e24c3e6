"""The ends of couplings with a spring on each side, tied to a set-position that a modulator computes from samples."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, TypeVar, cast

from hapnet import checks
from hapnet.checks import Vector
from hapnet.control.contact_model import ContactModel
from hapnet.control.continuous_servo import ContinuousServo
from hapnet.control.coupling import DeviceCoupling, WorldCoupling
from hapnet.control.held_steps import FollowerServo
from hapnet.control.limits import OnSilence, Silence
from hapnet.control.predicted_device import PredictedDevice
from hapnet.control.pspm import SetPositionModulator
from hapnet.control.reporter import SampleReporter
from hapnet.control.reserve import Holding
from hapnet.control.set_position_coupling import Modulator, SetPositionCoupling, Source
from hapnet.control.set_position_servo import SampledServo
from hapnet.control.set_position_steps import SetPositionSteps
from hapnet.control.smoothing import Pipeline, SmoothingFilter, Stage, VelocityPredictor
from hapnet.control.zoh import ZeroOrderHold
from hapnet.couplings import held_torque, rendering
from hapnet.couplings.rendering import RenderingTuning
from hapnet.couplings.spec import CouplingStart
from hapnet.mechanics.spring import Spring, shared_spring
from hapnet.params import DeviceParams, Params, WorldParams

KEPT_FOR_PEERS = 0.002
"""Share of its ceiling that the world keeps for restarted devices: with an empty account they render no force."""

Side = DeviceParams | WorldParams
MakeModulator = Callable[[Side, Spring, Vector, float, float, Holding | None], Modulator]
"""Arguments: the side's parameters, spring, position [m], energy at the start [J], reserve [J], and held torque."""

RESET_FORCE = "a force below this counts as zero for the reset of the account [N]; 0: no reset"
RESET_S = "time without force after which the account drops its surplus [s]"
"""The help of a law's parameters for `hapnet.ext.laws.parts.virtual_coupling.Reset`."""

S = TypeVar("S", bound=SampledServo)

_WORLDS = ("stiffness", "damping", "ceiling_J", "shuffle", "smoothing_s", "predict_s", "on_silence", "silence_after_s")
_ROBOTS = ("servo_hz", "mass", "resolution_m", "force_limit_N", "step_limit_N", "greatest_speed")
"""The parameters of a follower's servo that come from `world`, and those that come from `follower`."""

BOTH_SIDES = frozenset({"device", "world"})


def plain(
    side: Side, spring: Spring, position: Vector, energy: float, reserve: float, holding: Holding | None
) -> Modulator:
    """The `MakeModulator` of the plain coupling: it holds the received set-position."""
    return ZeroOrderHold(spring, position, energy)


def _coupling(
    start: CouplingStart[Any],
    side: Side,
    spring: Spring,
    modulator: Modulator,
    maximum: float,
    source: Source | None,
    kept: float = 0.0,
) -> SetPositionCoupling:
    stages: list[Stage] = []
    if side.predict_s:
        stages.append(VelocityPredictor(side.predict_s))
    if side.smoothing_s:
        stages.append(SmoothingFilter(side.smoothing_s))
    return SetPositionCoupling(
        modulator,
        stages=Pipeline(stages),
        source=source,
        silence=Silence(cast(OnSilence, side.on_silence), side.silence_after_s),
        max_step=maximum,
        kinetic=start.kinetic,
        kept_for_peers=kept,
        shares=side.shuffle == "needed"
        and start.params.rendering != "paper"
        and isinstance(modulator, SetPositionModulator),
    )


def _max_step(side: Side, spring: Spring) -> float:
    """The largest step of ybar in one update [m] that keeps the step of the spring's force within its limit."""
    if not side.step_limit_N:
        return math.inf
    return side.step_limit_N / spring.ellipsoid.largest


def device_spring(params: Params, dof: int) -> tuple[Spring, Vector]:
    """The device's spring, which saturates below the force limit, and its damper's diagonal [Ns/m]."""
    device = params.device
    spring = shared_spring(device.stiffness, dof, device.spring_limit_N or None)
    return spring, checks.diagonal("device.damping", device.damping, dof)


def _at_device(
    start: CouplingStart[RenderingTuning],
    make: MakeModulator,
    source: Source | None,
    holding: Holding | None = None,
) -> tuple[SetPositionCoupling, Vector]:
    device = start.params.device
    spring, damping = device_spring(start.params, len(start.position))
    reserve = 0.0 if holding is None else holding.reserve
    modulator = make(device, spring, start.position, start.initial_energy, reserve, holding)
    return _coupling(start, device, spring, modulator, _max_step(device, spring), source), damping


def _rates(start: CouplingStart[RenderingTuning]) -> tuple[float, float]:
    """The longest times between two runs of PSPM, and between two sent positions [s]; 0: every tick, every run."""
    period = start.params.device.pspm_period_s
    return (0.0, period) if start.tuning.contact_model else (period, 0.0)


def _continuous(start: CouplingStart[RenderingTuning], make: MakeModulator) -> ContinuousServo:
    model = rendering.at_device(start)
    coupling, damping = _at_device(start, make, model)
    period, sending = _rates(start)
    return ContinuousServo(coupling, damping=damping, period=period, sending=sending, model=model)


def _sampled(start: CouplingStart[RenderingTuning], make: MakeModulator) -> DeviceCoupling:
    model = rendering.at_device(start)
    return held_servo(start, make, model, model)


def held_servo(
    start: CouplingStart[RenderingTuning],
    make: MakeModulator,
    source: Source | None,
    model: ContactModel | None,
    kind: Callable[..., S] = SampledServo,  # type: ignore[assignment]
    rates: tuple[float, float] | None = None,
) -> S:
    """A servo that holds its force.

    source : computes y (the contact model, if there is one). rates : the longest times between two runs of PSPM, and
    between two sent samples [s]; 0: every tick, every run; None: by the rendering.
    """
    device, dof = start.params.device, len(start.position)
    guard, holding = held_torque.guard(device, start.harvest, dof)
    coupling, damping = _at_device(start, make, source, holding)
    period, sending = rates or _rates(start)
    return kind(
        coupling=coupling,
        damping=damping,
        period=period,
        sending=sending,
        model=model,
        position=start.position,
        harvest=start.harvest,
        trusted_damping=(device.trusted_damping,) * dof,
        guard=guard,
        holding=holding,
        resolution=device.resolution_m,
    )


def _world(start: CouplingStart[RenderingTuning], make: MakeModulator) -> WorldCoupling:
    """The world's end; unless the rendering is the paper's, it also sends the surfaces around its proxy."""
    if not start.tuning.contact_model:
        return SetPositionSteps(_at_world(start, make, None))
    source = rendering.at_world(start)
    return SetPositionSteps(
        _at_world(start, make, source),
        SampleReporter(start.position, source, *rendering.reach(start)),
        rendering.in_contact(start),
    )


def servo_of(params: Params) -> DeviceParams:
    """The follower's servo as a device's section: its limits and rate, with the spring and the reservoir of `world`."""
    robot, world, leader = params.follower, params.world, params.device
    return replace(
        DeviceParams(),
        **{name: getattr(world, name) for name in _WORLDS},
        **{name: getattr(robot, name) for name in _ROBOTS},
        pspm_period_s=leader.pspm_period_s,
        watchdog_s=max(leader.watchdog_s, 2.0 / robot.servo_hz) if leader.watchdog_s else 0.0,
    )


def _follower(start: CouplingStart[RenderingTuning], make: MakeModulator) -> FollowerServo:
    """The servo of a robot in the virtual mass's place; the parameters' `device` describes the robot (`servo_of`)."""
    params, source, reporter = start.params, None, None
    if start.tuning.contact_model:
        lag = rendering.largest(params.world.damping) + params.follower.own_damping
        source = rendering.at_world(replace(start, params=params.set({"world.damping": lag})))
        reporter = SampleReporter(start.position, source, *rendering.reach(start))
    return held_servo(replace(start, harvest="measured"), make, source, None, partial(FollowerServo, reporter))


def plain_world(start: CouplingStart[Any]) -> WorldCoupling:
    """The world's end of the plain coupling, for laws at the device only: it sends its proxy's position.

    With ``rendering = "hapnet"`` it also sends the surfaces around the proxy. If the tuning `predicts`, y is the
    device's predicted position: such a law claims nothing for this port, so any y is allowed.
    """
    if start.params.rendering == "hapnet":
        return _world(replace(start, tuning=rendering.tuned(start.params)), plain)
    return SetPositionSteps(_at_world(start, plain, rendering.at_world(start) if start.tuning.predicts else None))


def _at_world(start: CouplingStart[Any], make: MakeModulator, source: PredictedDevice | None) -> SetPositionCoupling:
    world = start.params.world
    spring = shared_spring(world.stiffness, len(start.position))
    kept = world.ceiling_J * KEPT_FOR_PEERS
    modulator = make(world, spring, start.position, start.initial_energy, kept, None)
    return _coupling(start, world, spring, modulator, _max_step(world, spring), source, kept)


class SetPositionEnds(NamedTuple):
    """The functions of a `CouplingSpec` that make the ends of a coupling with two springs."""

    device: Callable[[CouplingStart[RenderingTuning]], DeviceCoupling]
    continuous: Callable[[CouplingStart[RenderingTuning]], ContinuousServo]
    world: Callable[[CouplingStart[RenderingTuning]], WorldCoupling]
    follower: Callable[[CouplingStart[RenderingTuning]], FollowerServo]


def ends(make: MakeModulator) -> SetPositionEnds:
    """The ends with this modulator on each side, all with the same stages and limits."""
    return SetPositionEnds(
        partial(_sampled, make=make),
        partial(_continuous, make=make),
        partial(_world, make=make),
        partial(_follower, make=make),
    )
