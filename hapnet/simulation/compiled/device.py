"""The device's side, to and from the kernel."""

from __future__ import annotations

import math

import numpy as np

from hapnet.checks import Vector
from hapnet.control.contact_model import ContactModel
from hapnet.control.continuous_servo import ContinuousServo
from hapnet.control.set_position_coupling import SetPositionCoupling
from hapnet.control.told_plane import ToldPlane
from hapnet.kernel import device as devices
from hapnet.kernel import sides
from hapnet.kernel.contact_model import Answer
from hapnet.kernel.memory import load, store
from hapnet.plant.device import SimulatedDevice
from hapnet.side.device import DeviceSide
from hapnet.simulation.compiled.mirror import put, read, replace, value, vector


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
