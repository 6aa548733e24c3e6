"""The device's side, to and from the kernel."""

from __future__ import annotations

from hapnet.checks import Vector
from hapnet.control.contact_model import ContactModel
from hapnet.control.continuous_servo import ContinuousServo
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.control.told_plane import ToldPlane
from hapnet.kernel import sides
from hapnet.kernel.contact_model import Answer
from hapnet.kernel.memory import load, store
from hapnet.plant.device import SimulatedDevice
from hapnet.side.device import DeviceSide
from hapnet.simulation.compiled.mirror import put, replace, value, vector


def read_side(record: sides.DeviceSide, side: DeviceSide) -> None:
    device, servo, coupling = side.device, value(side, "servo"), coupling_of(side)
    assert isinstance(device, SimulatedDevice)
    store(record.plant, device)
    store(record.coupling, coupling)
    if isinstance(servo, ContinuousServo):
        store(record.within, servo)
    else:
        store(record.servo, servo)
        store(record.true_ledger, value(side, "true_ledger"))
        store(record.true_work, value(side, "true_work"))
        store(record.hand, value(side, "hand"))
    if isinstance(coupling.source, ContactModel):
        store(record.model, coupling.source)
        _told(record.told, coupling.source)


def coupling_of(side: DeviceSide) -> SetPositionCoupling:
    coupling = side.coupling
    assert isinstance(coupling, SetPositionCoupling)
    return coupling


def write_side(record: sides.DeviceSide, side: DeviceSide, reference: Vector) -> None:
    device, servo, coupling = side.device, value(side, "servo"), coupling_of(side)
    assert isinstance(device, SimulatedDevice)
    n = device.dof
    load(coupling, record.coupling)
    load(device, record.plant)
    device.references = [reference]
    if isinstance(servo, ContinuousServo):
        load(servo, record.within)
        return
    load(servo, record.servo)
    load(value(side, "true_ledger"), record.true_ledger)
    load(value(side, "hand"), record.hand)
    replace(side, "x", vector(record.plant, "read_position", n))


def _told(record: Answer, model: ContactModel) -> None:
    """The answer that waits for the next step."""
    if model.pending is None:
        return
    proxy, record.sent_s, record.age_s = model.pending
    record.pending = 1
    put(record, "position", proxy.position)
    put(record, "force", proxy.force)
    record.reach_m = -1.0 if proxy.reach_m is None else proxy.reach_m
    record.level = -1.0 if proxy.level is None else proxy.level
    planes = [ToldPlane(plane, model.compliance, proxy.position) for plane in proxy.planes or ()]
    record.count = len(planes)
    for one, plane in zip(record.planes, planes, strict=False):
        store(one, plane)
