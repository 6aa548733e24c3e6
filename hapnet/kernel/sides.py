"""A tick of the device's side and a step of the world's: `hapnet.side.device`, `hapnet.side.world`."""

from __future__ import annotations

from typing import Annotated

from hapnet.control import ledger as ledgers
from hapnet.control.ledger import Ledger
from hapnet.control.set_position_coupling import MOST_REACH_M
from hapnet.kernel import contact_model, prediction
from hapnet.kernel import set_position_coupling as couplings
from hapnet.kernel import set_position_servo as servos
from hapnet.kernel.added_damping import AddedDamping, FilteredVelocity
from hapnet.kernel.contact_model import ContactModel, Planes
from hapnet.kernel.endpoint import Wire, finish
from hapnet.kernel.link import Message
from hapnet.kernel.prediction import PredictedDevice
from hapnet.kernel.reserve import ForceGuard
from hapnet.kernel.set_position_coupling import Coupling
from hapnet.kernel.set_position_servo import SampledServo
from hapnet.kernel.smoothing import Stages
from hapnet.mechanics.spring import Spring
from hapnet.plant import device as devices
from hapnet.plant import integrator
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.tick import tick as make_tick
from hapnet.plant.worlds import account, walls
from hapnet.plant.worlds.account import EnvironmentAccount
from hapnet.plant.worlds.walls import Contacts
from hapnet.records.equation import equation
from hapnet.records.record import AXES, FloatRows, Floats, Record
from hapnet.records.vectors import copy

_NANO = 1e-9
_MOST_REACH_M = MOST_REACH_M


TICKS = 1024
"""So many ticks of the hand's path are known at once."""


class Hand(Record):
    """The hand's reference: where it is, and at the end of each of the next ticks [m]. at : where on the path it is;
    known : how many ticks the path has."""

    at: int
    known: int
    path: Annotated[FloatRows, (TICKS + 1, AXES)]


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

    plant : the device. true_ledger, hand : the accounts with the true positions, and of the hand.
    """

    plant: SimulatedDevice
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
    if side.plant.state.coupled:
        _tick_within(side, wire, hand, dt, now_ns)
    else:
        _tick_held(side, wire, hand, dt, now_ns)
    counts.device_last_ns = now_ns
    counts.ticks += 1
    if not side.servo.sends:
        return False
    copy(side.plant.dof, side.plant.read_position, message.position)
    message.planes, message.reach_m, message.level = 0, -1.0, side.coupling.level
    finish(wire.endpoint, message, now_ns)
    return True


@equation
def _tick_held(side: DeviceSide, wire: Wire, hand: Hand, dt: float, now_ns: int) -> None:
    """`SampledDeviceSide._control`."""
    device, servo, n = side.plant, side.servo, side.plant.dof
    copy(n, device.state.position, servo.spring_force)  # where it was before
    ledgers.put_in(side.hand, _advance(device, hand))
    true_work = servos.hold(
        servo.trusts != 0, servo.trusted, n, servo.force, servo.spring_force, device.state.position, dt, 0.0
    )
    devices.read(device)
    _take(side, wire, now_ns)
    updates = servos.due(servo, side.coupling, dt)
    x, v = device.read_position, device.read_velocity
    if updates:
        _choose(side, servo.elapsed + dt, x)
    servos.tick(servo, side.coupling, side.spring, side.ledger, side.stages, side.guard, dt, x, v, updates)
    devices.hold(device, servo.force)
    copy(n, device.state.torque, servo.force)
    _observe_truth(side, true_work)


@equation
def _tick_within(side: DeviceSide, wire: Wire, hand: Hand, dt: float, now_ns: int) -> None:
    """`ContinuousDeviceSide._control`, with `ContinuousServo.tick`."""
    device, servo, coupling, ledger = side.plant, side.servo, side.coupling, side.ledger
    work = _advance(device, hand)
    copy(device.dof, device.state.position, device.read_position)
    x, kinetic = device.read_position, devices.kinetic_at(device, device.state.velocity)
    _take(side, wire, now_ns)
    servo.elapsed += dt
    ledgers.put_in(ledger, work)
    ledgers.observe(ledger, kinetic + couplings.potential(coupling, side.spring, x), coupling.account)
    servo.sends = 0
    coupling.shuffled = 0.0
    if servo.elapsed < servo.due and not coupling.has_sample:
        return
    dissipated = _dissipated(device, servo.elapsed)
    _choose(side, servo.elapsed, x)
    couplings.update(coupling, side.spring, ledger, side.stages, servo.elapsed, x, dissipated, 0.0)
    copy(device.dof, coupling.set_position, device.state.set_position)
    ledgers.observe(ledger, kinetic + couplings.potential(coupling, side.spring, x), coupling.account)
    servo.sending_elapsed += servo.elapsed
    servo.elapsed = 0.0
    if servo.sending_elapsed >= servo.sending_due:
        servo.sending_elapsed = 0.0
        servo.sends = 1


@equation
def _advance(device: SimulatedDevice, hand: Hand) -> float:
    """`SimulatedDevice.advance`, to the next point of the hand's path."""
    work = make_tick(device.model, device.state, hand.path, hand.at)
    hand.at += 1
    device.ticks += 1
    device.time = device.ticks * device.period
    return work


@equation
def _dissipated(device: SimulatedDevice, interval: float) -> float:
    """What the coupling's damper dissipated since the last call, or its bound (10), as after `passage`."""
    state, by_range, lost = device.state, 0.0, 0.0
    for i in range(device.dof):
        travel = state.high[i] - state.low[i] - 0.0
        if travel > 0.0:
            by_range += device.model.b[i] * travel * travel
        lost += state.dissipated[i]
    limited = state.limited != 0
    devices.begin_passage(state, device.dof)
    return lost if limited else by_range / interval


@equation
def _take(side: DeviceSide, wire: Wire, now_ns: int) -> None:
    """`ControlHalf.take` at the device."""
    endpoint, coupling, n = wire.endpoint, side.coupling, side.plant.dof
    for k in range(endpoint.waiting):
        at = (endpoint.first + k) % endpoint.backlog
        sample = wire.samples[at]
        _note(coupling, wire, at, n)
        if side.model.in_use:
            _tell(side, sample, n, _age_s(sample, wire.came_ns[at], wire.took_ns[at], now_ns))
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
    endpoint = wire.endpoint
    endpoint.used_ns, endpoint.used_came_ns, endpoint.took_ns = sample.stamp_ns, wire.came_ns[at], wire.took_ns[at]


@equation
def _age_s(sample: Message, came_ns: int, took_ns: int, now_ns: int) -> float:
    """How old a sample is [s]: that of a proxy which has aimed is known exactly."""
    if sample.aimed_ns:
        return now_ns * _NANO - sample.aimed_ns * _NANO
    return (now_ns - came_ns + took_ns) * _NANO


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
    coupling, n = side.coupling, side.plant.dof
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
    stored = couplings.potential(side.coupling, side.spring, side.plant.state.position)
    ledgers.observe(ledger, stored, servos.account(side.servo, side.coupling, side.spring))


@equation
def step(side: WorldSide, wire: Wire, counts: Counts, now_ns: int, message: Message) -> None:
    """`WorldSide.step`: the message is in `message`."""
    mass, coupling, ledger, n = side.mass, side.coupling, side.ledger, side.mass.n
    dt = (now_ns - counts.world_last_ns) * _NANO
    counts.world_last_ns = now_ns
    _move(mass, side.contacts, dt, coupling.set_position)
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
    finish(wire.endpoint, message, now_ns)
    if side.predicted.overflow:
        wire.endpoint.impossible = 1
    counts.steps += 1
    counts.stepped_s += dt
    counts.longest_step_s = max(counts.longest_step_s, dt)
    counts.step_s = dt
    stored_J = walls.stored(side.contacts, mass.x)
    account.settle(side.environment, ledger.work, stored_J, side.contacts.supplied_J)


@equation
def _move(mass: PassiveIntegrator, contacts: Contacts, dt: float, ybar: Floats) -> None:
    """`PassiveIntegrator.step`, with `Contacts.solve`."""
    n = mass.n
    if mass.factored_dt != dt or mass.factored_drag != integrator.OWN:
        integrator.factor(mass, dt, integrator.OWN)
    integrator.drive(mass, dt, ybar)
    integrator.solve(mass, mass.c, mass.vhat)
    copy(n, mass.vhat, mass.c)
    for i in range(n):
        mass.force[i] = 0.0
    for k in range(contacts.lines):
        if walls.meets(contacts, k, dt, mass.x, mass.c):
            integrator.solve(mass, contacts.axes[k].normal, contacts.response)
            walls.push(contacts, k, dt, mass.x, mass.c, mass.force, mass.vhat)
    integrator.finish(mass, dt)
    mass.penetration = walls.penetration(contacts, mass.x)


@equation
def _receive(side: WorldSide, wire: Wire, now_ns: int) -> None:
    """`ControlHalf.take` at the world."""
    endpoint, coupling, n = wire.endpoint, side.coupling, side.mass.n
    for k in range(endpoint.waiting):
        at = (endpoint.first + k) % endpoint.backlog
        sample = wire.samples[at]
        _note(coupling, wire, at, n)
        if side.predicted.in_use:
            age_s = (now_ns - wire.came_ns[at] + wire.took_ns[at]) * _NANO
            prediction.receive(side.predicted, n, sample.position, coupling.sent_s, age_s)
    endpoint.first = endpoint.waiting = 0
    _credit(coupling, wire)


@equation
def _say(side: WorldSide, reach_m: float, dt: float, message: Message) -> None:
    """`SetPositionSteps.update`: what the world knows of the place."""
    around, contacts, n = side.around, side.contacts, side.mass.n
    message.aimed_ns = max(0, round(prediction.stands_for(side.predicted, dt) / _NANO))
    copy(n, side.mass.force, message.force)
    around.count = message.planes = walls.nearest(contacts, side.mass.x, reach_m)
    for k in range(around.count):
        at = contacts.near[k]
        copy(n, contacts.normals[at], around.normal[k])
        around.offset[k], around.stiffness[k], around.velocity[k] = contacts.offsets[at], contacts.stiffnesses[at], 0.0
    message.reach_m = reach_m
    for k in range(around.count):
        copy(n, around.normal[k], message.normal[k])
        message.offset[k], message.stiffness[k] = around.offset[k], around.stiffness[k]
        message.velocity[k] = around.velocity[k]
