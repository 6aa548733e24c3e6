"""A compiled tick of the device's side and step of the world's side: `hapnet.side.device`, `hapnet.side.world`."""

from __future__ import annotations

from typing import Any

from hapnet.control import (
    carrying,
    continuous_servo as continuous,
    predicted_device,
    set_position_coupling as couplings,
    set_position_servo as servos,
)
from hapnet.control.contact_equations import ContactState
from hapnet.control.contact_plane import ContactPlane, understand
from hapnet.control.continuous_servo import ContinuousServo
from hapnet.control.coupling import counted
from hapnet.control.harvest import by_range
from hapnet.control.predicted_device import Around, PredictedDevice
from hapnet.control.reporter import MOST_REACH_M
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.ext.compiled import link as links
from hapnet.ext.compiled.endpoint import PROXY, PortRecord, Wire, finish
from hapnet.ext.compiled.link import MessageSlot
from hapnet.plant import device as devices, integrator
from hapnet.plant.device import Hand, SimulatedDevice
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds import account, walls
from hapnet.plant.worlds.account import EnvironmentAccount
from hapnet.plant.worlds.walls import Contacts
from hapnet.records.record import Floats, Reals, Record, equation
from hapnet.records.vectors import copy
from hapnet.side import held_device
from hapnet.side.content import moment_ns
from hapnet.side.held_device import HeldDevice
from hapnet.side.world import Steps
from hapnet.wire.path import age_of_content_s, age_s

_NANO = 1e-9
_MOST_REACH_M = MOST_REACH_M


class DeviceSideRecord(HeldDevice):
    """The state of the device's side. within : the servo of a coupling that acts within the tick. last_ns : time of the
    last tick. dt : length of the current tick [s]."""

    last_ns: int
    ticks: int
    dt: float
    within: ContinuousServo
    model: ContactState


class WorldSideRecord(Record):
    """The state of the world's side.

    reach_m : planes within this distance are sent [m]. reach_mps : also planes that a device at this speed could reach.
    """

    stepped: Steps
    reach_m: float
    reach_mps: float
    mass: PassiveIntegrator
    contacts: Contacts
    coupling: SetPositionCoupling
    predicted: PredictedDevice
    environment: EnvironmentAccount


@equation
def measure(side: DeviceSideRecord, hand: Hand, now_ns: int) -> None:
    """Advance the device, read it, and count its work."""
    device = side.plant
    side.dt = max((now_ns - side.last_ns) * _NANO, device.period)
    if device.state.coupled:
        side.hand_work = devices.advance(device, hand)
        copy(device.dof, device.state.position, device.read_position)
    else:
        held_device.live(side, hand, 1)
        devices.read(device)
        held_device.count(side, side.dt)


@equation
def act(side: DeviceSideRecord, port: PortRecord, now_ns: int) -> MessageSlot:
    """Run the servo, within the tick or for a held force; returns the message, of kind `NOTHING` if none is due."""
    device, coupling, wire, message = side.plant, side.coupling, port.wire, links.spare(port.link, 0)
    x, within = device.read_position, side.within
    if device.state.coupled:
        kinetic = devices.kinetic_at(device, device.state.velocity)
        if continuous.runs(within, coupling, side.dt, x, side.hand_work, kinetic):
            continuous.run(within, coupling, side.model, x, _dissipated(device, within.elapsed), kinetic)
        sends = within.sender.sends
    else:
        servos.tick(side.servo, coupling, side.model, side.dt, x, device.read_velocity, servos.ITSELF)
        sends = side.servo.sender.sends
    if sends:
        copy(device.dof, x, message.position)
        message.planes, message.reach_m, message.level = 0, -1.0, level(coupling)
        finish(wire, message, now_ns, 0.0)
    else:
        message.kind = links.NOTHING
    return message


@equation
def hold(side: DeviceSideRecord) -> None:
    """Let the device hold the spring's set-position, or the servo's force."""
    if side.plant.state.coupled:
        copy(side.plant.dof, side.coupling.modulator.ybar, side.plant.state.set_position)
    else:
        held_device.apply(side)


@equation
def level(coupling: SetPositionCoupling) -> float:
    """The fill level of the coupling's reservoir, as `SetPositionCoupling.level`; below 0: it is not sent."""
    return coupling.modulator.level if coupling.shares else -1.0


@equation
def _dissipated(device: SimulatedDevice, interval: float) -> float:
    """The energy that the coupling's damper dissipated since the last call, or its bound (10), as after `passage`."""
    state, lost = device.state, 0.0
    bound = by_range(device.dof, device.model.b, state.low, state.high, interval, 0.0)
    for i in range(device.dof):
        lost += state.dissipated[i]
    limited = state.limited != 0
    devices.begin_passage(state, device.dof)
    return lost if limited else bound


@equation
def take_at_device(side: DeviceSideRecord, port: PortRecord, now_ns: int) -> None:
    """Pass the arrived samples and credits to the coupling, and to the local contact model."""
    wire, coupling, n = port.wire, side.coupling, side.plant.dof
    endpoint = wire.endpoint
    for k in range(endpoint.waiting):
        sample = note(wire, k)
        _give(coupling, sample, n)
        if side.model.in_use:
            _report(side, sample, n, age_of_content_s(endpoint.used, now_ns, sample.aimed_ns * _NANO))
    endpoint.first = endpoint.waiting = 0
    _credit(coupling, wire)


@equation
def note(wire: Wire, k: int) -> MessageSlot:
    """Return the sample at this place of the backlog, and note it as the newest in use."""
    endpoint = wire.endpoint
    at = (endpoint.first + k) % endpoint.backlog
    sample, used = wire.samples[at], endpoint.used
    used.sent_ns, used.came_ns, used.took_ns = sample.stamp_ns, wire.came_ns[at], wire.took_ns[at]
    return sample


@equation
def _give(coupling: SetPositionCoupling, sample: MessageSlot, n: int) -> None:
    """Pass the sample to the coupling."""
    couplings.receive(coupling, n, sample.position, sample.stamp_ns * _NANO)
    if coupling.shares:
        coupling.peer_level = sample.level


@equation
def _report(side: DeviceSideRecord, sample: MessageSlot, n: int, age_s: float) -> None:
    """Store the world's answer for the local contact model, as `ContactModel.receive` does."""
    reported = side.model.answer
    reported.pending = 1
    copy(n, sample.position, reported.position)
    copy(n, sample.force, reported.force)
    reported.sent_s, reported.age_s = side.coupling.sent_s, age_s
    reported.reach_m, reported.level = sample.reach_m, sample.level
    reported.count = sample.planes
    for k in range(sample.planes):
        one = reported.planes[k]
        copy(n, sample.normal[k], one.normal)
        one.offset, one.stiffness, one.velocity = sample.offset[k], sample.stiffness[k], sample.velocity[k]
        understand(one, n, side.model.compliance)
        understand_surface(one, n, sample, k)


@equation
def _credit(coupling: SetPositionCoupling, wire: Wire) -> None:
    """Pass the waiting credits to the coupling."""
    for k in range(wire.endpoint.credits):
        couplings.credit(coupling, wire.credits_nJ[k] * _NANO)
    wire.endpoint.credits = 0


@equation
def advance(side: WorldSideRecord, dt: float) -> None:
    """Move the mass through a step of `dt` seconds, as `SetPositionSteps.advance` does."""
    integrator.factored(side.mass, dt, integrator.OWN)
    move_among(side.mass, side.contacts, dt, side.coupling)


@equation
def answer(side: WorldSideRecord, port: PortRecord, now_ns: int, dt: float) -> MessageSlot:
    """Run the law at the onset of the next step, and return its message, as `WorldControl.answer` does."""
    mass, coupling, message = side.mass, side.coupling, links.spare(port.link, 0)
    copy(mass.n, mass.x, message.position)
    message.planes = message.aimed_ns = 0
    message.reach_m = -1.0
    if side.predicted.in_use and port.wire.endpoint.kind == PROXY:
        reach_m = side.reach_m + side.reach_mps * predicted_device.turn_s(side.predicted)
        _say(side, min(_MOST_REACH_M, reach_m), dt, message)
    counted(side, dt, mass.x, integrator.kinetic(mass), mass.work, mass.dissipated)
    message.level = level(coupling)
    finish(port.wire, message, now_ns, 0.0)
    return message


@equation
def settle(side: WorldSideRecord) -> None:
    """Count the step in the environment's account."""
    stored_J = walls.stored(side.contacts, side.mass.x)
    account.settle(side.environment, side.coupling.ledger.work, stored_J, side.contacts.supplied_J)


@equation
def move_among(mass: PassiveIntegrator, contacts: Contacts, dt: float, coupling: SetPositionCoupling) -> None:
    """Move the mass among the walls by a step, as `SetPositionSteps.advance` does; call `factored` before."""
    integrator.spring_among(mass, dt, coupling.modulator.ybar, contacts)
    if coupling.carries:
        carrying.carry(coupling, mass, contacts, mass.n, dt)
    mass.penetration = walls.penetration(contacts, mass.x)


@equation
def meet(mass: PassiveIntegrator, dt: float, contacts: Contacts) -> None:
    """Solve a step of the mass in contact with walls: `PassiveIntegrator.respond`."""
    integrator.solve(mass, mass.c, mass.vhat)
    copy(mass.n, mass.vhat, mass.c)
    for i in range(mass.n):
        mass.force[i] = 0.0
    inverse: Any = mass  # as compiled code has it
    walls.push_back(contacts, inverse, dt, mass.x, mass.c, mass.force, mass.vhat)


@equation
def update(side: WorldSideRecord, dt: float, x: Floats, dissipated: float) -> bool:
    """Predict the device if that is in use, and update the coupling, as `SetPositionSteps.update` does."""
    coupling, n = side.coupling, side.coupling.modulator.spring.dof
    if side.predicted.in_use:
        predicted_device.look_ahead(side.predicted, n, dt)
        copy(n, side.predicted.y, coupling.y)
        if coupling.carries:
            carrying.plan(coupling, side.predicted, side.contacts, n, x)
    else:
        copy(n, coupling.received, coupling.y)
    couplings.update(coupling, dt, x, dissipated, 0.0)
    return True


@equation
def take_at_world(side: WorldSideRecord, port: PortRecord, now_ns: int) -> None:
    """Pass the arrived samples and credits to the coupling, and to the predictor of the device."""
    wire, coupling, n = port.wire, side.coupling, side.mass.n
    endpoint = wire.endpoint
    for k in range(endpoint.waiting):
        sample = note(wire, k)
        _give(coupling, sample, n)
        if side.predicted.in_use:
            predicted_device.receive(side.predicted, n, sample.position, coupling.sent_s, age_s(endpoint.used, now_ns))
    endpoint.first = endpoint.waiting = 0
    _credit(coupling, wire)


@equation
def _say(side: WorldSideRecord, reach_m: float, dt: float, message: MessageSlot) -> None:
    """Put the contact force and the nearby planes into the message, as `SetPositionSteps.update` does."""
    around, contacts, n = side.predicted.around, side.contacts, side.mass.n
    message.aimed_ns = moment_ns(predicted_device.stands_for(side.predicted, dt))
    copy(n, side.mass.force, message.force)
    see(contacts, side.mass.x, reach_m, around, message)
    message.planes = around.count
    message.reach_m = reach_m
    for k in range(around.count):
        copy(n, around.normal[k], message.normal[k])
        message.offset[k], message.stiffness[k] = around.offset[k], around.stiffness[k]
        message.velocity[k] = around.velocity[k]


@equation
def see(contacts: Contacts, position: Reals, reach_m: float, around: Around, message: MessageSlot) -> None:
    """Put the planes of the walls within reach into `around`, as `Contacts.planes` does. The version for solids also
    puts curvature and friction into the message."""
    around.count = walls.nearest(contacts, position, reach_m)
    for k in range(around.count):
        at = contacts.near[k]
        copy(contacts.dof, contacts.normals[at], around.normal[k])
        around.offset[k], around.stiffness[k], around.velocity[k] = contacts.offsets[at], contacts.stiffnesses[at], 0.0


@equation
def understand_surface(one: ContactPlane, n: int, sample: MessageSlot, k: int) -> None:
    """Do nothing: walls have no curvature and no friction. solids.py replaces this function."""
