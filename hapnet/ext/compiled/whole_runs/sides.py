"""Copies both sides to and from the kernel."""

from __future__ import annotations

from typing import Any

from hapnet.checks import Vector
from hapnet.control.contact_model import ContactModel
from hapnet.control.coupling import LawServo, LawState
from hapnet.control.law import DeviceEnd, WorldEnd
from hapnet.control.predicted_device import PredictedDevice
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.ext.compiled.memory import load, store
from hapnet.ext.solids.rigid_contacts import RigidContacts
from hapnet.plant.device import SimulatedDevice
from hapnet.plant.integrator import PassiveIntegrator
from hapnet.plant.worlds.walls import Contacts
from hapnet.records.record import Record
from hapnet.side.continuous_device import ContinuousDeviceSide
from hapnet.side.device import DeviceSide
from hapnet.side.sampled_device import SampledDeviceSide
from hapnet.side.world import WorldSide


def read_device(record: Any, side: DeviceSide) -> None:
    for part, own in _device_parts(record, side):
        store(part, own)
    if isinstance(side.coupling, SetPositionCoupling) and isinstance(model := side.coupling.source, ContactModel):
        store(record.model, model)


def _device_parts(record: Any, side: DeviceSide) -> list[tuple[Record, Record]]:
    """The kernel's records of the device's side, each with the side's own record."""
    device, coupling = side.device, side.coupling
    assert isinstance(device, SimulatedDevice)
    if isinstance(side, ContinuousDeviceSide):
        assert isinstance(coupling, SetPositionCoupling)
        return [(record.plant, device), (record.coupling, coupling), (record.within, side.servo)]
    assert isinstance(side, SampledDeviceSide)
    assert side.held is not None, "control has started"
    parts: list[tuple[Record, Record]] = [(record, side.held)]
    if isinstance(side.servo, LawServo):
        assert isinstance(side.servo.law, DeviceEnd), "a law that is compiled"
        parts.append((record.law, side.servo.law))
    return parts


def write_device(record: Any, side: DeviceSide, reference: Vector) -> None:
    device = side.device
    assert isinstance(device, SimulatedDevice)
    for part, own in _device_parts(record, side):
        load(own, part)
    device.references, device.position = [reference], tuple(device.state.position)
    if isinstance(side, SampledDeviceSide):
        side.x = tuple(device.read_position)


def read_world(record: Any, side: WorldSide) -> None:
    coupling = side.coupling
    if isinstance(coupling, SetPositionCoupling) and isinstance(coupling.source, PredictedDevice):
        store(record.predicted, coupling.source)
    for part, own in _world_parts(record, side):
        store(part, own)


def _world_parts(record: Any, side: WorldSide) -> list[tuple[Record, Record]]:
    """The kernel's records of the world's side, each with the side's own record."""
    coupling = side.coupling
    assert isinstance(side.mass, PassiveIntegrator), "a scene of walls or solids"
    assert side.environment is not None, "control has started"
    assert isinstance(coupling, SetPositionCoupling | LawState)
    contacts = side.scene.contacts
    assert isinstance(contacts, Contacts | RigidContacts)
    parts: list[tuple[Record, Record]] = [
        (record.contacts, contacts), (record.mass, side.mass), (record.coupling, coupling),
        (record.environment, side.environment), (record.stepped, side.stepped),
    ]  # fmt: skip
    if isinstance(coupling, LawState):
        assert isinstance(coupling.law, WorldEnd), "a law that is compiled"
        parts.append((record.law, coupling.law))
    return parts


def write_world(record: Any, side: WorldSide) -> None:
    for part, own in _world_parts(record, side):
        load(own, part)
