"""The device's side, to and from the kernel."""

from __future__ import annotations

from typing import Any

from hapnet.checks import Vector
from hapnet.control.contact_model import ContactModel
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.control.set_position_servo import ContinuousServo, SampledServo
from hapnet.control.smoothing import FilteredVelocity
from hapnet.kernel import added_damping, contact_model, set_position_servo, sides
from hapnet.kernel.memory import load, store
from hapnet.mechanics.encoders import rounding
from hapnet.plant.device import SimulatedDevice
from hapnet.side.device import DeviceSide
from hapnet.simulation.compiled.couplings import (
    read_coupling,
    read_stages,
    write_coupling,
)
from hapnet.simulation.compiled.mirror import optional, put, read, replace, value, vector, write

_SERVO_STATE = "guarded speed_max potential elapsed torque_path boundary"
_SERVO_VECTORS = ("force", "commanded", "before", "velocity", "position")


def read_side(record: sides.DeviceSide, side: DeviceSide) -> None:
    device, servo, coupling = side.device, value(side, "servo"), coupling_of(side)
    assert isinstance(device, SimulatedDevice)
    store(record.plant, device)
    sender = value(servo, "sender")
    read(record.servo, sender, "", sending_due="due", sending_elapsed="elapsed")
    if isinstance(servo, ContinuousServo):
        record.servo.due, record.servo.elapsed = servo.due, servo.elapsed
    else:
        _servo(record.servo, servo)
        read(record.guard, value(servo, "guard"), "limit step reach speed inertia square linear constant has_account")
        store(record.true_ledger, value(side, "true_ledger"))
        store(record.hand, value(side, "hand"))
    read_coupling(record.coupling, coupling)
    store(record.spring, coupling.spring)
    store(record.ledger, coupling.ledger)
    read_stages(record.stages, coupling)
    if isinstance(coupling.source, ContactModel):
        _model(record, coupling.source)


def coupling_of(side: DeviceSide) -> SetPositionCoupling:
    coupling = side.coupling
    assert isinstance(coupling, SetPositionCoupling)
    return coupling


def write_side(record: sides.DeviceSide, side: DeviceSide, reference: Vector) -> None:
    device, servo, coupling = side.device, value(side, "servo"), coupling_of(side)
    assert isinstance(device, SimulatedDevice)
    n = device.dof
    write_coupling(record.coupling, coupling)
    load(coupling.ledger, record.ledger)
    load(device, record.plant)
    device.references = [reference]
    if isinstance(servo, ContinuousServo):
        servo.elapsed = float(record.servo.elapsed)
        return
    load(value(side, "true_ledger"), record.true_ledger)
    load(value(side, "hand"), record.hand)
    write(record.servo, servo, _SERVO_STATE)
    for name in _SERVO_VECTORS:
        replace(servo, name, vector(record.servo, name, n))
    replace(side, "x", vector(record.plant, "read_position", n))


def _servo(record: set_position_servo.SampledServo, servo: SampledServo) -> None:
    read(record, servo, f"{_SERVO_STATE} {' '.join(_SERVO_VECTORS)} due resolution damping")
    record.rounding = rounding(servo.resolution, len(servo.force))
    record.trusts = int(any(servo.trusted_damping))
    put(record, "trusted", servo.trusted_damping)
    record.work = value(servo, "measured").work


def _model(side: sides.DeviceSide, source: ContactModel) -> None:
    """The contact model, which is then in use."""
    record = side.model
    record.in_use = 1
    read(record, source, "fade_s shift_s shift fading age freedom compliance lead")
    read(record, source, "yields_below remembers kept kept_goal")
    optional(record, "wanted_shift", "has_wanted", value(source, "wanted_shift"))
    optional(record, "start", "starts", value(source, "start"))
    if (earlier := value(source, "earlier")) is not None:
        record.has_earlier, record.earlier_s = 1, earlier[1]
        put(record, "earlier", earlier[0])
    for field, made in zip(("x", "s", "fading", "before", "y"), value(source, "made"), strict=True):
        put(record, f"made_{field}", made)
    _planes(side.planes, value(source, "planes"))
    _pending(record, side.told, value(source, "pending"))
    _velocity(side.velocity, value(source, "velocity"))
    damping = value(source, "added")
    read(side.added, damping, "least most compliance")
    _velocity(side.added_velocity, value(damping, "velocity"))


def _planes(record: contact_model.Planes, planes: tuple[object, ...]) -> None:
    record.count = len(planes)
    for name in ("normal", "offset", "stiffness", "velocity", "response", "softness"):
        put(record, name, [value(plane, name) for plane in planes])


def _pending(record: contact_model.ContactModel, told: contact_model.Planes, pending: Any) -> None:
    if pending is None:
        return
    proxy, record.told_sent_s, record.told_age_s = pending
    record.pending = 1
    put(record, "told_position", proxy.position)
    put(record, "told_force", proxy.force)
    record.told_reach_m = -1.0 if proxy.reach_m is None else proxy.reach_m
    record.told_level = -1.0 if proxy.level is None else proxy.level
    told.count = len(proxy.planes)
    for k, plane in enumerate(proxy.planes):
        told.normal[k][: len(plane.normal)] = plane.normal
        told.offset[k], told.stiffness[k], told.velocity[k] = plane.offset_m, plane.stiffness, plane.velocity_mps


def _velocity(record: added_damping.FilteredVelocity, source: FilteredVelocity) -> None:
    record.time_constant = source.time_constant
    optional(record, "filtered", "known", value(source, "filtered"))
