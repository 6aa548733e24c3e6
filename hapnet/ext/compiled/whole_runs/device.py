"""Copies the device's side to and from the kernel."""

from __future__ import annotations

from typing import Any

from hapnet.checks import Vector
from hapnet.control.contact_model import ContactModel
from hapnet.control.coupling import LawServo
from hapnet.control.law import DeviceEnd
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.ext.compiled.memory import load, store
from hapnet.plant.device import SimulatedDevice
from hapnet.records.record import Record
from hapnet.side.continuous_device import ContinuousDeviceSide
from hapnet.side.device import DeviceSide
from hapnet.side.sampled_device import SampledDeviceSide


def read_side(record: Any, side: DeviceSide) -> None:
    for part, own in _parts(record, side):
        store(part, own)
    if isinstance(side.coupling, SetPositionCoupling) and isinstance(model := side.coupling.source, ContactModel):
        store(record.model, model)


def _parts(record: Any, side: DeviceSide) -> list[tuple[Record, Record]]:
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


def write_side(record: Any, side: DeviceSide, reference: Vector) -> None:
    device = side.device
    assert isinstance(device, SimulatedDevice)
    for part, own in _parts(record, side):
        load(own, part)
    device.references, device.position = [reference], tuple(device.state.position)
    if isinstance(side, SampledDeviceSide):
        side.x = tuple(device.read_position)
