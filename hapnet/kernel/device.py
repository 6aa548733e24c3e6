"""A simulated device with a held force, in its hand: `hapnet.plant.device`, `hapnet.plant.tick`.

Without a coupling within the tick no limit can act, so each axis is computed alone.
"""

from __future__ import annotations

from typing import Annotated

from hapnet.records.equation import equation
from hapnet.records.record import AXES, FloatRows, Floats, OfAxes, Record
from hapnet.records.vectors import copy, dot, length

TICKS = 1024
"""So many ticks of the hand's path are known at once."""


class Device(Record):
    """`SimulatedDevice` with its `TickModel` and `DeviceState`.

    before, ticks : how many were made before, and since then. read_position, read_velocity : what the servo has read.
    """

    n: int
    before: int
    ticks: int
    period: float
    h: float
    substeps: int
    mass: float
    hand_stiffness: float
    rate_drive: float
    rate_step: float
    inertia: float
    hand_mass: float
    response: float
    inverse: float
    resolution: float
    force_limit: float
    time: float
    position: OfAxes
    velocity: OfAxes
    hand_force: OfAxes
    actuator_force: OfAxes
    torque: OfAxes
    read_time: float
    read_position: OfAxes
    read_velocity: OfAxes


class Hand(Record):
    """The hand's reference: where it is, and at the end of each of the next ticks [m]. at : where on the path it is;
    known : how many ticks the path has."""

    at: int
    known: int
    path: Annotated[FloatRows, (TICKS + 1, AXES)]


@equation
def advance(device: Device, going: Hand) -> float:
    """One tick, while the hand goes to the next point of its path; `TickModel.held`. Returns the hand's work [J]."""
    h, kh, inverse = device.h, device.hand_stiffness, device.inverse
    inertia, hand_mass, response = device.inertia, device.hand_mass, device.response
    total = 0.0
    for axis in range(device.n):
        x, v, torque = device.position[axis], device.velocity[axis], device.torque[axis]
        begin = going.path[going.at][axis]
        rate = (going.path[going.at + 1][axis] - begin) / device.period
        hand = kh * begin + device.rate_drive * rate
        hand_step = device.rate_step * rate
        work = f = 0.0
        for _ in range(device.substeps):
            hand += hand_step
            middle = (inertia * v + torque + hand - kh * x) * inverse
            f = hand - kh * x + hand_mass * v - response * middle
            work += f * middle
            v = middle + middle - v
            x += h * middle
        device.position[axis], device.velocity[axis] = x, v
        device.hand_force[axis], device.actuator_force[axis] = f, torque
        total += work * h
    going.at += 1
    device.ticks += 1
    device.time = (device.before + device.ticks) * device.period
    return total


@equation
def read(device: Device) -> None:
    """`SimulatedDevice.read`."""
    r, x, v = device.resolution, device.read_position, device.read_velocity
    if r == 0.0:
        copy(device.n, device.position, x)
        copy(device.n, device.velocity, v)
        return
    span = device.time - device.read_time
    device.read_time = device.time
    for i in range(device.n):
        count = r * round(device.position[i] / r)
        v[i] = (count - x[i]) / span if span != 0.0 else 0.0
        x[i] = count


@equation
def apply(device: Device, force: Floats) -> None:
    """`SimulatedDevice.apply`: cuts the force to the actuators' limit, and holds it."""
    size = length(device.n, force)
    if size > device.force_limit:
        for i in range(device.n):
            force[i] = force[i] * device.force_limit / size
    copy(device.n, force, device.torque)


@equation
def kinetic(device: Device) -> float:
    """The kinetic energy of the device's own mass [J]."""
    return 0.5 * device.mass * dot(device.n, device.velocity, device.velocity)
