"""What is recorded at a tick and at a step: `hapnet.recording.samples`, as rows of numbers."""

from __future__ import annotations

from typing import Annotated

from hapnet.control import set_position_coupling as couplings
from hapnet.control.ledger import Ledger
from hapnet.kernel.endpoint import Wire
from hapnet.kernel.sides import Counts, DeviceSide, WorldSide
from hapnet.mechanics import spring as springs
from hapnet.plant.device import Hand
from hapnet.records.equation import equation
from hapnet.records.record import AXES, FloatRows, Floats, Record, Wholes
from hapnet.wire.path import age_s, transit_s

DEVICE_VECTORS, DEVICE_SCALARS, WORLD_VECTORS, WORLD_SCALARS = 11, 14, 6, 14
"""The numbers of columns of a row: vectors first, then scalars."""


MOST = 2048
"""So many samples of each side may wait for the recorder."""


class Rows(Record):
    """The samples of both sides as rows, with their times [ns].

    every : ticks between two samples. device_rows, world_rows : how many there are.
    """

    every: int
    device_rows: int
    world_rows: int
    device_ns: Annotated[Wholes, (MOST,)]
    at_device: Annotated[FloatRows, (MOST, AXES * DEVICE_VECTORS + DEVICE_SCALARS)]
    world_ns: Annotated[Wholes, (MOST,)]
    at_world: Annotated[FloatRows, (MOST, AXES * WORLD_VECTORS + WORLD_SCALARS)]


@equation
def have_room(rows: Rows) -> bool:
    """Is there room for one more sample of each side?"""
    return rows.device_rows < MOST and rows.world_rows < MOST


@equation
def record_tick(rows: Rows, side: DeviceSide, wire: Wire, hand: Hand, now_ns: int) -> None:
    """A `DeviceSample`: its vectors in their order, then its scalars."""
    device, servo, coupling, n = side.plant, side.servo, side.coupling, side.plant.dof
    spring = coupling.modulator.spring
    x, at = device.read_position, rows.device_rows
    row, within = rows.at_device[at], device.state.coupled != 0
    rows.device_rows = at + 1
    rows.device_ns[at] = now_ns
    springs.force(spring, x, coupling.modulator.ybar, servo.pull)
    for i in range(n):
        row[i] = x[i]
        row[n + i] = coupling.modulator.ybar[i]
        row[2 * n + i] = coupling.aim[i]
        row[3 * n + i] = device.state.actuator_force[i] if within else servo.held[i]
        row[4 * n + i] = device.state.hand_force[i]
        row[5 * n + i] = hand.path[hand.at][i]
        row[6 * n + i] = servo.pull[i]
        row[7 * n + i] = row[3 * n + i] - row[6 * n + i] if within else -servo.damping[i] * servo.velocity[i]
        row[8 * n + i] = row[9 * n + i] = 0.0
        row[10 * n + i] = device.state.velocity[i] if within else device.read_velocity[i]
    if side.model.in_use:
        _part(row, side, n)
    _account(row, DEVICE_VECTORS * n, side, x)
    add_times(row, DEVICE_VECTORS * n + 7, wire, now_ns)
    add_energies(row, DEVICE_VECTORS * n + 9, coupling.ledger)
    row[DEVICE_VECTORS * n + 13] = coupling.ledger.work if within else side.hand.work


@equation
def _part(row: Floats, side: DeviceSide, n: int) -> None:
    """The parts of the spring's force that the model's planes and the added damping have made."""
    model, modulator = side.model, side.coupling.modulator
    K = modulator.spring.rows
    for i in range(n):
        modulator.offset[i] = side.plant.read_position[i] - modulator.ybar[i]
    scale = springs.saturation(modulator.spring, modulator.offset)
    for i in range(n):
        of_planes = added = 0.0
        for j in range(n):
            of_planes += K[i][j] * (model.made_s[j] - model.made_x[j] + model.made_fading[j])
            added += K[i][j] * (model.made_y[j] - model.made_before[j])
        row[8 * n + i] = scale * of_planes
        row[9 * n + i] = scale * added


@equation
def _account(row: Floats, at: int, side: DeviceSide, x: Floats) -> None:
    """Reservoir, deficit, potential, sent, credited, margin, slack."""
    coupling, ledger = side.coupling, side.coupling.ledger
    row[at] = coupling.modulator.energy
    row[at + 1] = coupling.modulator.deficit
    row[at + 2] = couplings.potential(coupling, x)
    row[at + 3] = ledger.sent
    row[at + 4] = ledger.credited
    row[at + 5] = ledger.margin
    row[at + 6] = ledger.slack


@equation
def add_times(row: Floats, at: int, wire: Wire, now_ns: int) -> None:
    """`ControlHalf.used`: age and transit of the newest sample in use."""
    row[at] = age_s(wire.endpoint.used, now_ns)
    row[at + 1] = transit_s(wire.endpoint.used)


@equation
def add_energies(row: Floats, at: int, ledger: Ledger) -> None:
    """Bound, work, stored and account."""
    row[at] = ledger.bound
    row[at + 1] = ledger.work
    row[at + 2] = ledger.stored
    row[at + 3] = ledger.reservoir


@equation
def record_step(rows: Rows, side: WorldSide, wire: Wire, counts: Counts, now_ns: int) -> None:
    """A `WorldSample`: its vectors in their order, then its scalars."""
    mass, coupling, ledger, n = side.mass, side.coupling, side.coupling.ledger, side.mass.n
    at = rows.world_rows
    row = rows.at_world[at]
    rows.world_rows = at + 1
    rows.world_ns[at] = now_ns
    for i in range(n):
        row[i] = mass.x[i]
        row[n + i] = mass.v[i]
        row[2 * n + i] = coupling.modulator.ybar[i]
        row[3 * n + i] = coupling.aim[i]
        row[4 * n + i] = mass.coupling_force[i]
        row[5 * n + i] = mass.force[i]
    first = WORLD_VECTORS * n
    row[first] = counts.step_s
    row[first + 1] = mass.penetration
    row[first + 2] = coupling.modulator.energy
    row[first + 3] = couplings.potential(coupling, mass.x)
    row[first + 4] = ledger.sent
    row[first + 5] = ledger.credited
    row[first + 6] = ledger.margin
    row[first + 7] = ledger.slack
    add_times(row, first + 8, wire, now_ns)
    add_energies(row, first + 10, ledger)
