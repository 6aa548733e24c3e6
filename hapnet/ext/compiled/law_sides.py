"""A tick and a step of sides with a law as their end: `LawServo` and `LawSteps` between device, mass and wire."""

from __future__ import annotations

import math

from hapnet.control import law as laws
from hapnet.control.coupling import counted
from hapnet.control.law import DeviceEnd, HeldForce, LawAccount, WorldEnd
from hapnet.ext.compiled import link as links
from hapnet.ext.compiled.endpoint import PortRecord, finish
from hapnet.ext.compiled.link import MessageSlot
from hapnet.ext.compiled.samples import DeviceRow, WorldRow
from hapnet.ext.compiled.sides import note
from hapnet.plant import device as devices, integrator
from hapnet.plant.device import Hand
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds import walls as contact
from hapnet.plant.worlds.account import EnvironmentAccount
from hapnet.plant.worlds.walls import Contacts
from hapnet.records.record import Reals, Record, equation
from hapnet.records.vectors import copy
from hapnet.side import held_device
from hapnet.side.held_device import HeldDevice
from hapnet.side.world import Steps
from hapnet.wire.path import age_s

_NANO = 1e-9


class LawDevice(HeldDevice):
    """The state of the device's side. last_ns : time of the last tick. dt : length of the current tick [s]."""

    last_ns: int
    ticks: int
    dt: float
    servo: HeldForce  # type: ignore[assignment]  # a law's, in place of a set-position's
    coupling: LawAccount  # type: ignore[assignment]
    law: DeviceEnd


class LawWorld(Record):
    """The state of the world's side."""

    stepped: Steps
    mass: PassiveIntegrator
    contacts: Contacts
    coupling: LawAccount
    law: WorldEnd
    environment: EnvironmentAccount


@equation
def measure(side: LawDevice, hand: Hand, now_ns: int) -> None:
    """Advance the device, read it, and count its work."""
    side.dt = max((now_ns - side.last_ns) * _NANO, side.plant.period)
    held_device.live(side, hand, 1)
    devices.read(side.plant)
    held_device.count(side, side.dt)


@equation
def take_from_world(side: LawDevice, port: PortRecord, now_ns: int) -> None:
    """Pass the arrived samples to the device's law."""
    law, endpoint = side.law, port.wire.endpoint
    for k in range(endpoint.waiting):
        sample = note(port.wire, k)
        take_at_device(law, sample.position, sample.more, sample.amount * _NANO, sample.elapsed_ns * _NANO)
    endpoint.first = endpoint.waiting = endpoint.credits = 0


@equation
def act(side: LawDevice, port: PortRecord, now_ns: int) -> MessageSlot:
    """Run the law; returns the message with its sample, of kind `NOTHING` if none is due."""
    law, n, message = side.law, side.plant.dof, links.spare(port.link, 0)
    x, v = side.plant.read_position, side.plant.read_velocity
    if laws.tick(side.servo, side.coupling, law, side.dt, x, v):
        set_device_outgoing(law, x, v)
        copy(n, law.outgoing.value, message.position)
        copy(n, law.outgoing.more, message.more)
        message.planes, message.reach_m, message.level = 0, -1.0, -1.0
        finish(port.wire, message, now_ns, law.outgoing.amount)
    else:
        message.kind = links.NOTHING
    return message


@equation
def hold(side: LawDevice) -> None:
    """Let the device hold the law's force."""
    held_device.apply(side)


@equation
def advance(side: LawWorld, dt: float) -> None:
    """Move the mass through a step of `dt` seconds under the law's force, as `LawSteps.advance` does."""
    mass, law = side.mass, side.law
    pull = drag(law, dt)
    integrator.factored(mass, dt, pull)
    integrator.push_among(mass, dt, pull, law.push, side.contacts)
    mass.penetration = contact.penetration(side.contacts, mass.x)
    moved(law, dt, mass.vhat, mass.x, mass.v)


@equation
def take_from_device(side: LawWorld, port: PortRecord, now_ns: int) -> None:
    """Pass the arrived samples to the world's law."""
    law, endpoint = side.law, port.wire.endpoint
    for k in range(endpoint.waiting):
        sample = note(port.wire, k)
        stamped(law, sample.position, sample.stamp_ns * _NANO, age_s(endpoint.used, now_ns))
        take_at_world(law, sample.position, sample.more, sample.amount * _NANO, sample.elapsed_ns * _NANO)
    endpoint.first = endpoint.waiting = endpoint.credits = 0


@equation
def answer(side: LawWorld, port: PortRecord, now_ns: int, dt: float) -> MessageSlot:
    """Run the law at the onset of the next step, and return its message, as `WorldControl.answer` does."""
    mass, law, message = side.mass, side.law, links.spare(port.link, 0)
    counted(side, dt, mass.x, integrator.kinetic(mass), mass.work, 0.0)
    copy(mass.n, law.outgoing.value, message.position)
    copy(mass.n, law.outgoing.more, message.more)
    message.planes, message.reach_m, message.level = 0, -1.0, -1.0
    finish(port.wire, message, now_ns, law.outgoing.amount)
    return message


@equation
def of_device(row: DeviceRow, side: LawDevice, n: int) -> None:
    """Fill in a law's fields of a `DeviceSample`; the parts of the force are NaN."""
    copy(n, side.law.y, row.set_position_m)
    copy(n, side.law.y, row.target_m)
    for i in range(n):
        row.spring_force_N[i] = row.damper_force_N[i] = math.nan
        row.model_force_N[i] = row.added_damping_force_N[i] = math.nan
    row.reservoir_J, row.deficit_J, row.potential_J = side.coupling.account, 0.0, 0.0


@equation
def of_world(row: WorldRow, side: LawWorld, n: int) -> None:
    """Fill in a law's fields of a `WorldSample`."""
    copy(n, side.law.y, row.set_position_m)
    copy(n, side.law.y, row.target_m)
    row.reservoir_J, row.potential_J = side.coupling.account, 0.0


@equation
def update(side: LawWorld, dt: float, x: Reals, dissipated: float) -> bool:
    """Run the law at the onset of a step, as `LawSteps.update` does; its sample is then in `outgoing`."""
    begin(side.law)
    set_world_outgoing(side.law)
    return True


@equation
def no_potential(coupling: LawAccount, x: Reals) -> float:
    """Return 0: a law's account includes its own springs."""
    return 0.0


@equation
def no_energy(side: HeldDevice) -> float:
    """Return 0: a law's account includes its own springs."""
    return 0.0


@equation
def account_of(side: HeldDevice) -> float:
    """The law's share of d^2 [J], from its account."""
    return side.coupling.account


def take_at_device(law: DeviceEnd, value: Reals, more: Reals, amount: float, total_s: float) -> None:
    """Pass a sample to the device's law. kinds.py replaces this and the next functions by methods of a law's ends."""
    law.take(value, more, amount, total_s)


def set_device_outgoing(law: DeviceEnd, x: Reals, v: Reals) -> None:
    """Write the next sample of the device's law into `outgoing`."""
    law.set_outgoing(x, v)


def take_at_world(law: WorldEnd, value: Reals, more: Reals, amount: float, total_s: float) -> None:
    """Pass a sample to the world's law."""
    law.take(value, more, amount, total_s)


def stamped(law: WorldEnd, value: Reals, sent_s: float, age_s: float) -> None:
    """Pass the sending time and age of a sample's value to the world's law, before the sample itself."""
    law.stamp(value, sent_s, age_s)


def begin(law: WorldEnd) -> None:
    """Begin a step of the world's law, with the samples that have arrived by now."""
    law.begin()


def drag(law: WorldEnd, dt: float) -> float:
    """Return the drag of the world's law in a step [Ns/m], and put its push into `push`."""
    return law.drag(dt)


def moved(law: WorldEnd, dt: float, vhat: Reals, x: Reals, v: Reals) -> None:
    """Pass the mass's motion in a step to the world's law: mean velocity, then position and velocity at its end."""
    law.moved(dt, vhat, x, v)


def set_world_outgoing(law: WorldEnd) -> None:
    """Write the next sample of the world's law into `outgoing`."""
    law.set_outgoing()
