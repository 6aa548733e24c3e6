"""The device's side, to and from the kernel."""

from __future__ import annotations

from hapnet.checks import Vector
from hapnet.control.contact_model import ContactModel
from hapnet.control.ledger import Ledger
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.control.set_position_servo import SampledServo
from hapnet.control.told_plane import ToldPlane
from hapnet.kernel import sides
from hapnet.kernel.contact_model import Answer
from hapnet.kernel.memory import fill, load, store
from hapnet.plant.device import SimulatedDevice
from hapnet.side.device import ContinuousDeviceSide, DeviceSide
from hapnet.side.sampled_device import SampledDeviceSide


def read_side(record: sides.DeviceSide, side: DeviceSide) -> None:
    device, coupling = side.device, coupling_of(side)
    assert isinstance(device, SimulatedDevice)
    store(record.plant, device)
    store(record.coupling, coupling)
    if isinstance(side, ContinuousDeviceSide):
        store(record.within, side.servo)
    else:
        sampled = _sampled(side)
        store(record.servo, _servo_of(sampled))
        store(record.true_ledger, _true_ledger_of(sampled))
        store(record.true_work, sampled.true_work)
        store(record.hand, sampled.hand_ledger)
    if isinstance(coupling.source, ContactModel):
        store(record.model, coupling.source)
        _told(record.told, coupling.source)


def coupling_of(side: DeviceSide) -> SetPositionCoupling:
    coupling = side.coupling
    assert isinstance(coupling, SetPositionCoupling)
    return coupling


def write_side(record: sides.DeviceSide, side: DeviceSide, reference: Vector) -> None:
    device, coupling = side.device, coupling_of(side)
    assert isinstance(device, SimulatedDevice)
    load(coupling, record.coupling)
    load(device, record.plant)
    device.references, device.position = [reference], tuple(device.state.position)
    if isinstance(side, ContinuousDeviceSide):
        load(side.servo, record.within)
        return
    sampled = _sampled(side)
    load(_servo_of(sampled), record.servo)
    load(_true_ledger_of(sampled), record.true_ledger)
    load(sampled.hand_ledger, record.hand)
    sampled.x = tuple(device.read_position)


def _sampled(side: DeviceSide) -> SampledDeviceSide:
    assert isinstance(side, SampledDeviceSide)
    return side


def _servo_of(side: SampledDeviceSide) -> SampledServo:
    assert isinstance(side.servo, SampledServo)
    return side.servo


def _true_ledger_of(side: SampledDeviceSide) -> Ledger:
    assert side.true_ledger is not None, "control has started"
    return side.true_ledger


def _told(record: Answer, model: ContactModel) -> None:
    """The answer that waits for the next step."""
    if model.pending is None:
        return
    proxy, record.sent_s, record.age_s = model.pending
    record.pending = 1
    fill(record.position, proxy.position)
    fill(record.force, proxy.force)
    record.reach_m = -1.0 if proxy.reach_m is None else proxy.reach_m
    record.level = -1.0 if proxy.level is None else proxy.level
    planes = [ToldPlane(plane, model.compliance, proxy.position) for plane in proxy.planes or ()]
    record.count = len(planes)
    for one, plane in zip(record.planes, planes, strict=False):
        store(one, plane)
