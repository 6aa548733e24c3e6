"""The device's side, to and from the kernel."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hapnet.checks import Vector
from hapnet.control.contact_model import ContactModel
from hapnet.control.continuous_servo import ContinuousServo
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.kernel import contact_model, sides
from hapnet.kernel import device as devices
from hapnet.kernel.memory import load, store
from hapnet.plant.device import SimulatedDevice
from hapnet.side.device import DeviceSide
from hapnet.simulation.compiled.mirror import optional, put, read, replace, value, vector


def read_side(record: sides.DeviceSide, side: DeviceSide) -> None:
    device, servo, coupling = side.device, value(side, "servo"), coupling_of(side)
    assert isinstance(device, SimulatedDevice)
    _device(record.plant, device)
    store(record.coupling, coupling)
    if isinstance(servo, ContinuousServo):
        _coupled(record, device)
        store(record.within, servo)
    else:
        store(record.servo, servo)
        store(record.true_ledger, value(side, "true_ledger"))
        store(record.true_work, value(side, "true_work"))
        store(record.hand, value(side, "hand"))
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
    load(coupling, record.coupling)
    _write_device(record.plant, device, reference)
    if isinstance(servo, ContinuousServo):
        load(servo, record.within)
        device.state.low, device.state.high = (vector(record.model_of_tick, name, n) for name in ("low", "high"))
        device.move_set_position(coupling.set_position)
        return
    load(servo, record.servo)
    load(value(side, "true_ledger"), record.true_ledger)
    load(value(side, "hand"), record.hand)
    replace(side, "x", vector(record.plant, "read_position", n))


def _write_device(record: devices.Device, device: SimulatedDevice, reference: Vector) -> None:
    n, state = device.dof, device.state
    device.ticks += int(record.ticks)
    device.time = device.ticks * device.period
    device.references = [reference]
    state.position, state.velocity = vector(record, "position", n), vector(record, "velocity", n)
    state.hand_force, state.actuator_force = vector(record, "hand_force", n), vector(record, "actuator_force", n)
    state.torque = vector(record, "torque", n)
    replace(device, "read", vector(record, "read_position", n))
    replace(device, "read_time", float(record.read_time))


def _device(record: devices.Device, device: SimulatedDevice) -> None:
    model, state = device.model, device.state
    read(record, device, "period mass resolution time", read_time="read_time", read_position="read")
    read(record, model, "h rate_drive rate_step inertia hand_mass response")
    record.n, record.before, record.substeps = device.dof, device.ticks, len(model.substeps)
    record.hand_stiffness = model.hand.stiffness
    if model.decoupled:
        record.inverse = model.decoupled[0][2]
    record.force_limit = math.inf if device.force_limit is None else device.force_limit
    read(record, state, "position velocity hand_force actuator_force torque")
    put(record, "read_velocity", state.velocity)


def _coupled(record: sides.DeviceSide, device: SimulatedDevice) -> None:
    """The coupling that acts within the ticks."""
    model, state, ticks, limited = device.model, device.state, record.model_of_tick, record.limited
    ticks.in_use, ticks.decoupled = 1, int(bool(model.decoupled))
    for axis, values in enumerate(model.decoupled):
        for name, one in zip(("k", "pull", "inverse", "b", "middle_gain"), values, strict=True):
            getattr(ticks, name)[axis] = one
    coupling = model.coupling
    read(limited, coupling, "resistance damping h knee force_limit")
    limited.n = device.dof
    put(limited, "K", coupling.rows)
    values, vectors = coupling.modes
    put(limited, "values", values)
    put(limited, "vectors", vectors)
    if not model.decoupled:
        put(ticks, "b", model.damping)
        damped = np.diag(limited.resistance + np.array(model.damping))
        put(ticks, "inverse_of_all", np.linalg.inv(damped + model.stiffness * (model.h / 2.0)).tolist())
    read(ticks, model, "largest knee_square force_limit")
    read(ticks, state, "low high dissipated")
    ticks.limited, ticks.at_limit = int(state.limited), int(state.at_limit)


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
    store(side.velocity, value(source, "velocity"))
    store(side.added, value(source, "added"))


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
