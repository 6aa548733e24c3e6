"""A tick of the device's side and a step of the world's: `hapnet.side.device`, `hapnet.side.world`."""

from __future__ import annotations

from hapnet.control import ledger as ledgers
from hapnet.control.ledger import Ledger
from hapnet.control.set_position_coupling import MOST_REACH_M
from hapnet.kernel import contact_model, coupled_device, environment_account, integrator, prediction, walls
from hapnet.kernel import device as devices
from hapnet.kernel import set_position_coupling as couplings
from hapnet.kernel import set_position_servo as servos
from hapnet.kernel.added_damping import AddedDamping, FilteredVelocity
from hapnet.kernel.contact_model import ContactModel, Planes
from hapnet.kernel.coupled_device import TickModel
from hapnet.kernel.device import Device, Hand
from hapnet.kernel.endpoint import Wire, finish
from hapnet.kernel.environment_account import EnvironmentAccount
from hapnet.kernel.integrator import PassiveIntegrator
from hapnet.kernel.limited_coupling import LimitedCoupling
from hapnet.kernel.link import Message
from hapnet.kernel.prediction import PredictedDevice
from hapnet.kernel.reserve import ForceGuard
from hapnet.kernel.set_position_coupling import Coupling
from hapnet.kernel.set_position_servo import SampledServo
from hapnet.kernel.smoothing import Stages
from hapnet.kernel.walls import Contacts
from hapnet.mechanics.spring import Spring
from hapnet.records.equation import equation
from hapnet.records.record import Floats, Record
from hapnet.records.vectors import copy
from hapnet.wire.path import age_of_content_s, age_s

_NANO = 1e-9
_MOST_REACH_M = MOST_REACH_M


class Counts(Record):
    """What the two sides count: ticks and steps."""

    device_last_ns: int
    ticks: int
    world_last_ns: int
    steps: int
    stepped_s: float
    longest_step_s: float
    step_s: float
    reach_m: float
    reach_mps: float


class DeviceSide(Record):
    """Everything of the device's side.

    plant : the device; model_of_tick, limited : of a coupling that acts within the tick. true_ledger, hand : the
    accounts with the true positions, and of the hand.
    """

    plant: Device
    model_of_tick: TickModel
    limited: LimitedCoupling
    servo: SampledServo
    coupling: Coupling
    spring: Spring
    ledger: Ledger
    stages: Stages
    guard: ForceGuard
    true_ledger: Ledger
    hand: Ledger
    model: ContactModel
    planes: Planes
    told: Planes
    velocity: FilteredVelocity
    added: AddedDamping
    added_velocity: FilteredVelocity


class WorldSide(Record):
    """Everything of the world's side; `around` : the planes that it tells."""

    mass: PassiveIntegrator
    contacts: Contacts
    coupling: Coupling
    spring: Spring
    ledger: Ledger
    stages: Stages
    predicted: PredictedDevice
    around: Planes
    environment: EnvironmentAccount


@equation
def tick(side: DeviceSide, wire: Wire, counts: Counts, hand: Hand, now_ns: int, message: Message) -> bool:
    """`DeviceSide.tick`: is there a position to send? It is then in `message`."""
    dt = max((now_ns - counts.device_last_ns) * _NANO, side.plant.period)
    if side.model_of_tick.in_use:
        _tick_within(side, wire, hand, dt, now_ns)
    else:
        _tick_held(side, wire, hand, dt, now_ns)
    counts.device_last_ns = now_ns
    counts.ticks += 1
    if not side.servo.sends:
        return False
    copy(side.plant.n, side.plant.read_position, message.position)
    message.planes, message.reach_m, message.level = 0, -1.0, side.coupling.level
    finish(wire, message, now_ns)
    return True


@equation
def _tick_held(side: DeviceSide, wire: Wire, hand: Hand, dt: float, now_ns: int) -> None:
    """`SampledDeviceSide._control`."""
    device, servo, n = side.plant, side.servo, side.plant.n
    copy(n, device.position, servo.spring_force)  # where it was before
    ledgers.put_in(side.hand, devices.advance(device, hand))
    true_work = servos.hold(
        servo.trusts != 0, servo.trusted, n, servo.force, servo.spring_force, device.position, dt, 0.0
    )
    devices.read(device)
    _take(side, wire, now_ns)
    updates = servos.due(servo, side.coupling, dt)
    x, v = device.read_position, device.read_velocity
    if updates:
        _choose(side, servo.elapsed + dt, x)
    servos.tick(servo, side.coupling, side.spring, side.ledger, side.stages, side.guard, dt, x, v, updates)
    devices.apply(device, servo.force)
    _observe_truth(side, true_work)


@equation
def _tick_within(side: DeviceSide, wire: Wire, hand: Hand, dt: float, now_ns: int) -> None:
    """`ContinuousDeviceSide._control`, with `ContinuousServo.tick`."""
    device, model, servo, coupling, ledger = side.plant, side.model_of_tick, side.servo, side.coupling, side.ledger
    work = coupled_device.advance(device, model, side.limited, hand, coupling.set_position)
    copy(device.n, device.position, device.read_position)
    x, kinetic = device.read_position, devices.kinetic(device)
    _take(side, wire, now_ns)
    servo.elapsed += dt
    ledgers.put_in(ledger, work)
    ledgers.observe(ledger, kinetic + couplings.potential(coupling, side.spring, x), coupling.account)
    servo.sends = 0
    coupling.shuffled = 0.0
    if servo.elapsed < servo.due and not coupling.has_sample:
        return
    dissipated = coupled_device.dissipated(device, model, servo.elapsed)
    _choose(side, servo.elapsed, x)
    couplings.update(coupling, side.spring, ledger, side.stages, servo.elapsed, x, dissipated, 0.0)
    ledgers.observe(ledger, kinetic + couplings.potential(coupling, side.spring, x), coupling.account)
    servo.sending_elapsed += servo.elapsed
    servo.elapsed = 0.0
    if servo.sending_elapsed >= servo.sending_due:
        servo.sending_elapsed = 0.0
        servo.sends = 1


@equation
def _take(side: DeviceSide, wire: Wire, now_ns: int) -> None:
    """`ControlHalf.take` at the device."""
    endpoint, coupling, n = wire.endpoint, side.coupling, side.plant.n
    for k in range(endpoint.waiting):
        at = (endpoint.first + k) % endpoint.backlog
        sample = wire.samples[at]
        _note(coupling, wire, at, n)
        if side.model.in_use:
            _tell(side, sample, n, age_of_content_s(endpoint.used, now_ns, sample.aimed_ns * _NANO))
    endpoint.first = endpoint.waiting = 0
    _credit(coupling, wire)


@equation
def _note(coupling: Coupling, wire: Wire, at: int, n: int) -> None:
    """The coupling receives the sample at this place of the backlog."""
    sample = wire.samples[at]
    copy(n, sample.position, coupling.received)
    coupling.sent_s = sample.stamp_ns * _NANO
    coupling.fresh = coupling.has_sample = 1
    if coupling.shares:
        coupling.peer_level = sample.level
    used = wire.endpoint.used
    used.sent_ns, used.came_ns, used.took_ns = sample.stamp_ns, wire.came_ns[at], wire.took_ns[at]


@equation
def _tell(side: DeviceSide, sample: Message, n: int, age_s: float) -> None:
    """`ContactModel.receive`."""
    model, told = side.model, side.told
    model.pending = 1
    copy(n, sample.position, model.told_position)
    copy(n, sample.force, model.told_force)
    model.told_sent_s, model.told_age_s = side.coupling.sent_s, age_s
    model.told_reach_m, model.told_level = sample.reach_m, sample.level
    told.count = sample.planes
    for k in range(sample.planes):
        copy(n, sample.normal[k], told.normal[k])
        told.offset[k], told.stiffness[k] = sample.offset[k], sample.stiffness[k]
        told.velocity[k] = sample.velocity[k]


@equation
def _credit(coupling: Coupling, wire: Wire) -> None:
    """The credits that wait go to the coupling."""
    for k in range(wire.endpoint.credits):
        coupling.credit += wire.credits_nJ[k] * _NANO
        coupling.has_sample = 1
    wire.endpoint.credits = 0


@equation
def _choose(side: DeviceSide, dt: float, x: Floats) -> None:
    """Choose y, before the stages."""
    coupling, n = side.coupling, side.plant.n
    if side.model.in_use:
        contact_model.step(
            side.model, side.planes, side.told, side.velocity, side.added, side.added_velocity, n, dt, x, coupling.y
        )
    else:
        copy(n, coupling.received, coupling.y)


@equation
def _observe_truth(side: DeviceSide, work: float) -> None:
    """`SampledDeviceSide._observe_truth` with the measured harvest."""
    ledger = side.true_ledger
    ledgers.put_in(ledger, work)
    ledger.credited, ledger.sent = side.ledger.credited, side.ledger.sent
    stored = couplings.potential(side.coupling, side.spring, side.plant.position)
    ledgers.observe(ledger, stored, servos.account(side.servo, side.coupling, side.spring))


@equation
def step(side: WorldSide, wire: Wire, counts: Counts, now_ns: int, message: Message) -> None:
    """`WorldSide.step`: the message is in `message`."""
    mass, coupling, ledger, n = side.mass, side.coupling, side.ledger, side.mass.n
    dt = (now_ns - counts.world_last_ns) * _NANO
    counts.world_last_ns = now_ns
    integrator.step(mass, side.contacts, dt, coupling.set_position)
    _receive(side, wire, now_ns)
    ledgers.put_in(ledger, mass.work)
    kinetic = integrator.kinetic(mass)
    ledgers.observe(ledger, kinetic + couplings.potential(coupling, side.spring, mass.x), coupling.account)
    copy(n, mass.x, message.position)
    message.planes = message.aimed_ns = 0
    message.reach_m = -1.0
    if side.predicted.in_use:
        if wire.endpoint.proxies:
            reach_m = counts.reach_m + counts.reach_mps * prediction.turn_s(side.predicted)
            _say(side, min(_MOST_REACH_M, reach_m), dt, message)
        prediction.step(side.predicted, side.around, n, dt, coupling.y)
    else:
        copy(n, coupling.received, coupling.y)
    couplings.update(coupling, side.spring, ledger, side.stages, dt, mass.x, mass.dissipated, 0.0)
    ledgers.observe(ledger, kinetic + couplings.potential(coupling, side.spring, mass.x), coupling.account)
    message.level = coupling.level
    finish(wire, message, now_ns)
    if side.predicted.overflow:
        wire.endpoint.impossible = 1
    counts.steps += 1
    counts.stepped_s += dt
    counts.longest_step_s = max(counts.longest_step_s, dt)
    counts.step_s = dt
    environment_account.observe(side.environment, side.contacts, ledger.work, n, mass.x)


@equation
def _receive(side: WorldSide, wire: Wire, now_ns: int) -> None:
    """`ControlHalf.take` at the world."""
    endpoint, coupling, n = wire.endpoint, side.coupling, side.mass.n
    for k in range(endpoint.waiting):
        at = (endpoint.first + k) % endpoint.backlog
        sample = wire.samples[at]
        _note(coupling, wire, at, n)
        if side.predicted.in_use:
            prediction.receive(side.predicted, n, sample.position, coupling.sent_s, age_s(endpoint.used, now_ns))
    endpoint.first = endpoint.waiting = 0
    _credit(coupling, wire)


@equation
def _say(side: WorldSide, reach_m: float, dt: float, message: Message) -> None:
    """`SetPositionSteps.update`: what the world knows of the place."""
    around, n = side.around, side.mass.n
    message.aimed_ns = max(0, round(prediction.stands_for(side.predicted, dt) / _NANO))
    copy(n, side.mass.force, message.force)
    walls.tell(side.contacts, n, side.mass.x, reach_m, around)
    message.reach_m = reach_m
    message.planes = around.count
    for k in range(around.count):
        copy(n, around.normal[k], message.normal[k])
        message.offset[k], message.stiffness[k] = around.offset[k], around.stiffness[k]
        message.velocity[k] = around.velocity[k]
