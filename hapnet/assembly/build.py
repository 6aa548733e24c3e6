"""Builds the objects of a run from parameters: only this module turns names on a command line into parts."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from hapnet.assembly import springs
from hapnet.assembly.choices import choosing, refuse
from hapnet.assembly.follower import Follower, follower_of
from hapnet.assembly.leading import clutch_of, let_lead
from hapnet.assembly.links import link_profile, link_timeline
from hapnet.assembly.operators import missing_of_the_hand, operator
from hapnet.assembly.own_parts import named_failures, named_section, require_parts
from hapnet.assembly.resolve import held_warnings, misfits, resolve
from hapnet.assembly.simulated_device import device_warnings, simulated_device
from hapnet.checks import Vector
from hapnet.control.continuous_servo import ContinuousServo
from hapnet.control.coupling import DeviceCoupling, DeviceLaw, Ends, LawServo, LawSteps, WorldCoupling, WorldLaw
from hapnet.control.held_steps import FollowerServo, HeldSteps, reflected
from hapnet.control.set_position_servo import Harvest
from hapnet.couplings.link_delays import delays
from hapnet.couplings.registry import deadband
from hapnet.couplings.rendering import share_without_planes
from hapnet.couplings.set_position import servo_of
from hapnet.couplings.spec import CouplingSpec, CouplingStart
from hapnet.couplings.stiffness import Felt, felt
from hapnet.errors import InvalidParameter
from hapnet.loading import extension
from hapnet.mechanics.contacts import Mass
from hapnet.params import DeviceParams, Params, WorldParams, as_params, is_simulated
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.live_hand import live_hand_of
from hapnet.plant.operator import Operator
from hapnet.plant.worlds.protocol import World
from hapnet.plant.worlds.registry import scene_parameters
from hapnet.recording.samples import MetricSample
from hapnet.records.machine_code import no_compiler
from hapnet.side.continuous_device import ContinuousDeviceSide
from hapnet.side.device import Clock, DeviceSide, Drive, Write
from hapnet.side.endpoint import NANO, DeviceControl, WorldControl
from hapnet.side.sampled_device import SampledDeviceSide
from hapnet.side.world import WorldSide
from hapnet.units import METRES, one_text
from hapnet.wire.identity import RESERVOIR, ROBOT, SHARED, UNITS
from hapnet.wire.messages import Role
from hapnet.wire.secret import Secret
from hapnet.wire.session import Session, SessionSettings
from netem import LinkProfile, Timeline

End = TypeVar("End")


@dataclass(frozen=True)
class Setup:
    """The checked parameters of a run, and the values and parts derived from them."""

    params: Params
    scene: World
    servo: str
    harvest: Harvest
    coupling: CouplingSpec[Any]
    tuning: Any
    """The coupling's tuning, which its own rule derives from the link."""
    up: LinkProfile
    down: LinkProfile
    up_timeline: Timeline | None = None
    down_timeline: Timeline | None = None
    warnings: tuple[str, ...] = field(default=())
    missing: tuple[str, ...] = field(default=())
    """One line if a part of the recording that the hand follows is missing."""
    hand: Operator | None = None
    """The simulated hand, instead of the one that the parameters name."""
    ends: Ends = field(default_factory=Ends)
    """Makes the coupling's ends faster."""

    @property
    def dof(self) -> int:
        return self.scene.dof

    @property
    def units(self) -> str:
        """The units of the axes, as in `hapnet.units`."""
        return one_text(self.scene.units, self.dof)

    @property
    def follower(self) -> Follower:
        """The follower in the virtual mass's place."""
        return follower_of(self.params)

    @property
    def tuned(self) -> dict[str, Any]:
        """The tuning by its fields' names, as recordings and summaries contain it."""
        return dataclasses.asdict(self.tuning)

    @property
    def felt(self) -> Felt:
        """The felt stiffness of the stiffest wall or solid; if unknown, of `world.wall.stiffness`, if that is read."""
        known = self.scene.stiffnesses
        if known is None and "stiffness" in scene_parameters(self.params.scene):
            known = (self.params.world.wall.stiffness,)
        stiffest = max(known or (), default=None)
        params = choosing(self.params, *self.follower.seen)
        return felt(self.coupling.springs(params, self.tuning), stiffest, springs.limit(self.params))


def prepare(params: Params | Mapping[str, object], default_servo: str = "sampled") -> Setup:
    """Check the parameters against each other, and resolve "auto"; for the servo that is `default_servo`.

    params : a `Params`, or changes to the defaults by dotted names.

    Raises InvalidParameter: names the parameter that does not fit.
    """
    given = as_params(params)
    with named_failures(given):
        used = resolve(given, default_servo)
        refuse(misfits(used))
        params, scene, spec = used.params, used.scene, used.coupling
        warnings = [*device_warnings(params), *scene.warnings, *held_warnings(used)]
        warnings.extend(follower_of(params).warnings(params, spec, scene.dof))
        up, down = link_profile("link.up", params.link.up), link_profile("link.down", params.link.down)
        tuning = spec.tune(choosing(params, *follower_of(params).seen), delays(up, down, params.link.path_s))
        warnings.extend(spec.warn(params, tuning))
        if scene.has_effects and not spec.staged(params):
            warnings.append(
                f"{params.coupling} with rendering {params.rendering} has no contact model: effects are not felt"
            )
        timelines = (link_timeline("up", params), link_timeline("down", params))
        lacking = missing_of_the_hand(params, scene)
        both = (tuple(warnings), lacking)
        return Setup(params, scene, used.servo, used.harvest, spec, tuning, up, down, *timelines, *both)


def device_session(setup: Setup, incarnation: int, name: str = "device", secret: Secret | None = None) -> Session:
    """The device's protocol state, for one start of the process."""
    return _session(setup, "device", name, incarnation, secret)


def world_session(setup: Setup, incarnation: int, name: str = "world", secret: Secret | None = None) -> Session:
    """The world's protocol state, for one start of the process."""
    return _session(setup, "world", name, incarnation, secret)


def device_side(
    setup: Setup,
    endpoint: DeviceControl,
    clock: Clock,
    write: Write,
    write_motion: Callable[[MetricSample], None] | None = None,
) -> DeviceSide:
    """The device (simulated in its hand, or the user's own) with its servo, for an endpoint or its control half.

    clock, write, write_motion : as in `Drive`; only a simulated device can write its motion alone.
    """
    endpoint.deadband = deadband(setup.params, "device")
    if not is_simulated(setup.params.hardware):
        from hapnet.assembly.user_side import user_device_side  # here, since a simulated device does not need it

        return user_device_side(setup, endpoint, clock, write)
    params = setup.params
    hand = setup.hand or operator(params, setup.scene)
    simulated = setup.ends.simulated(simulated_device(params, setup.scene, hand))
    if simulated.dof != setup.dof:
        raise InvalidParameter("operator", params.operator, f"a hand with {setup.dof} axes, as the scene has")
    driven = dataclasses.replace(drive(setup, clock, write), write_motion=write_motion)
    if setup.servo == "continuous":
        make = _continuous(setup)
        with named_section("device"):
            make(simulated.position, 0.0, False)  # so that an error shows now and not at pairing
        side: DeviceSide = ContinuousDeviceSide(endpoint, simulated, make, driven)
    else:
        hold = held(setup)
        with named_section("device"):
            hold(simulated.position, False)
        side = led = SampledDeviceSide(endpoint, simulated, hold, driven)
        led.clutch = clutch_of(setup.params, setup.units, simulated)
        let_lead(setup.params, setup.units, led)
    side.live_hand = live_hand_of(hand)
    return side


def compiled_ends() -> Ends:
    """Return the maker of compiled ends; where nothing can be compiled, it returns the ends unchanged."""
    if no_compiler() is not None:
        return Ends()
    ends: Ends = extension("compiled ends").CompiledEnds()
    return ends


def drive(setup: Setup, clock: Clock, write: Write) -> Drive:
    """Return the `Drive` of a side with the servo that `device` chooses."""
    device = setup.params.device
    return Drive(
        period_ns=round(1.0 / device.servo_hz / NANO),
        clock=clock,
        write=write,
        record_every=max(1, round(device.servo_hz / setup.params.record_hz)),
        watchdog_ns=round(device.watchdog_s / NANO) or None,
    )


def virtual_mass(setup: Setup) -> Mass:
    """The virtual mass at the scene's start, among its contacts. Raises InvalidParameter."""
    world, scene = setup.params.world, setup.scene
    with named_section("world"):
        mass: Mass | None = scene.proxy(world.mass, world.damping, world.stiffness)
        if mass is None:
            mass = PassiveIntegrator(world.mass, world.damping, world.stiffness, scene.start)
    mass.set_contacts(scene.contacts)
    return mass


def world_side(setup: Setup, endpoint: WorldControl, rng: np.random.Generator, write: Write) -> WorldSide:
    """The virtual mass in its scene, for an endpoint or its control half."""
    endpoint.deadband, endpoint.arms = deadband(setup.params, "world"), setup.follower.arms(setup.params)
    world = setup.params.world
    mass = virtual_mass(setup)

    def make_coupling(position: Vector, kinetic: float, empty: bool = False) -> WorldCoupling:
        if setup.follower.is_held(setup.params, setup.coupling):
            period_s = 1.0 / setup.params.follower.servo_hz
            watchdog_s = servo_of(setup.params).watchdog_s or math.inf
            return HeldSteps(follower_servo(setup, position, empty), period_s, watchdog_s)
        end = _end(setup, setup.coupling.world, WorldCoupling, _start(setup, world, position, empty, kinetic))
        return end if setup.scene.robot else setup.ends.steps(end, mass, setup.scene.contacts)

    trial = make_coupling(mass.position, 0.0)  # so that an error shows now and not at pairing
    mass = setup.ends.mass(trial, mass)
    endpoint.reindexing = setup.follower.reindexing(setup.params, setup.coupling, setup.scene)
    write = setup.follower.writes_on_link(setup.params, write, endpoint.reindexing)
    side = WorldSide(endpoint, mass, setup.scene, make_coupling, rng=rng, write=write, name=setup.params.scene)
    side.releases = setup.params.follower.on_stop == "release"
    return side


def follower_servo(setup: Setup, position: Vector, empty: bool) -> FollowerServo:
    """The servo of the robot that follows, at rest at `position` [m] in the leader's units."""
    params, make = choosing(setup.params, *setup.follower.seen), setup.coupling.follower
    assert make is not None, "refused by prepare"
    energy = 0.0 if empty else params.world.ceiling_J
    at_robot = dataclasses.replace(params, device=servo_of(params))
    servo = _end(setup, make, DeviceCoupling, CouplingStart(at_robot, setup.tuning, position, energy, 0.0, "measured"))
    if params.follower.feedback == "force":
        share = 1.0 if servo.reporter is None else share_without_planes(params)
        servo.feedback = reflected(tuple([share * one for one in setup.follower.leaders_stiffness(params, setup.dof)]))
    return servo


def _start(
    setup: Setup, side: DeviceParams | WorldParams, position: Vector, empty: bool, kinetic: float = 0.0
) -> CouplingStart[Any]:
    """Return the start of an end of the coupling; `empty`: the side has restarted, so it begins without energy."""
    energy = 0.0 if empty else side.ceiling_J
    return CouplingStart(
        choosing(setup.params, *setup.follower.on_link), setup.tuning, position, energy, kinetic, setup.harvest
    )


def _end(setup: Setup, make: Callable[[CouplingStart[Any]], End], kind: type, start: CouplingStart[Any]) -> End:
    """Make one end of the coupling. HapnetError: it lacks a part, or a user's own end cannot be made."""
    with named_failures(setup.params):
        end = make(start)
    require_parts(f"the coupling {setup.params.coupling}", end, kind)
    if isinstance(end, LawServo | LawSteps):
        law = DeviceLaw if isinstance(end, LawServo) else WorldLaw
        require_parts(f"the coupling {setup.params.coupling}", end.law, law)
    return end


def _continuous(setup: Setup) -> Callable[[Vector, float, bool], ContinuousServo]:
    make_servo, device = setup.coupling.continuous, setup.params.device
    assert make_servo is not None, "refused by prepare"

    def make(position: Vector, kinetic: float, empty: bool = False) -> ContinuousServo:
        return make_servo(_start(setup, device, position, empty, kinetic))

    return make


def held(setup: Setup) -> Callable[[Vector, bool], DeviceCoupling]:
    """Return a maker of the device's end with a sampled servo: at a position [m], `empty`: without energy."""
    device = setup.params.device

    def make(position: Vector, empty: bool = False) -> DeviceCoupling:
        start = _start(setup, device, position, empty)
        return setup.ends.servo(_end(setup, setup.coupling.device, DeviceCoupling, start))

    return make


def _session(setup: Setup, role: Role, name: str, incarnation: int, secret: Secret | None) -> Session:
    wire = setup.params.wire
    side = setup.params.device if role == "device" else setup.params.world
    return Session(
        role=role,
        dof=setup.dof,
        name=name,
        incarnation=incarnation,
        about={
            "scene": setup.params.scene,
            "coupling": setup.params.coupling,
            RESERVOIR: side.ceiling_J,
            **({} if setup.units == METRES else {UNITS: setup.units}),
            **({ROBOT: True} if role == "world" and setup.scene.robot else {}),
            **({SHARED + "contact_model": True} if setup.coupling.staged(setup.params) else {}),
            **{SHARED + name: getattr(setup.tuning, name) for name in setup.coupling.shared},
        },
        settings=SessionSettings(
            accept_stale=wire.accept_stale,
            admission_W=wire.admission_W,
            admission_burst_J=wire.admission_burst_J,
            hello_period_ns=round(wire.hello_period_s / NANO),
            spacing_ns=round(wire.energy_spacing_s / NANO),
            silence_ns=round(side.silence_after_s / NANO),
            expects=setup.coupling.sends("world" if role == "device" else "device", setup.params),
            sends_sums=secret is not None,
        ),
        secret=secret,
    )
